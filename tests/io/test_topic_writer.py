"""Messages on topics."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader

from mapfusion_io import encode
from mapfusion_io.atomic import AtomicFile
from mapfusion_io.encode import Encoder
from mapfusion_io.topic_writer import LATCHED, STREAMED, OutgoingMessage, TopicWriter


def test_messages_of_a_topic_share_a_channel_and_are_counted(tmp_path: Path) -> None:
    encoder = Encoder()
    kind = encoder.message_type(encode.TF_MESSAGE)
    data = encoder.transforms([], 0)
    with AtomicFile(tmp_path / "out.mcap") as file:
        out = TopicWriter(file)
        for k in range(3):
            out.write(OutgoingMessage("/tf", kind, STREAMED, data, 10 + k, 5 + k))
        out.write(OutgoingMessage("/other/tf", kind, LATCHED, memoryview(data), 20, 20))
        out.finish()
    with (tmp_path / "out.mcap").open("rb") as stream:
        reader = make_reader(stream)
        written = [(c.id, c.topic, m.sequence, m.log_time, m.publish_time) for _, c, m in reader.iter_messages()]
        summary = reader.get_summary()
    assert written == [(1, "/tf", 0, 10, 5), (1, "/tf", 1, 11, 6), (1, "/tf", 2, 12, 7), (2, "/other/tf", 0, 20, 20)]
    assert summary is not None
    assert len(summary.schemas) == 1


def test_a_topic_keeps_its_type(tmp_path: Path) -> None:
    encoder = Encoder()
    with AtomicFile(tmp_path / "out.mcap") as file:
        out = TopicWriter(file)
        out.write(OutgoingMessage("/tf", encoder.message_type(encode.TF_MESSAGE), STREAMED, b"", 0, 0))
        with pytest.raises(ValueError, match="/tf carries tf2_msgs/msg/TFMessage, not nav_msgs/msg/Path"):
            out.write(OutgoingMessage("/tf", encoder.message_type(encode.PATH), STREAMED, b"", 0, 0))
