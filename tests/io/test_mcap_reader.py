from __future__ import annotations

import json
import random
import struct
from collections import Counter
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType, Writer

from mapfusion.errors import LogReadError
from mapfusion_io.interfaces import Channel
from mapfusion_io.mcap_reader import McapRecording
from mapfusion_io.mcap_records import MAGIC
from mapfusion_io.read_limits import ReadLimits
from tests.ending import ends
from tests.io.making import SHARED, STAMP_NS, delivered, mcap_bytes, mission_messages, ros1_grid, small_cells

MESSAGES = mission_messages(40)
CONFORMANCE = sorted((SHARED / "conformance").glob("*.mcap"))


def recording_of(tmp_path: Path, content: bytes, **limits: int) -> McapRecording:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    return McapRecording(path, ReadLimits(**limits))


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def chunk(compression: bytes, data: bytes, size: int) -> bytes:
    return record(6, struct.pack("<QQQI", 0, 0, size, 0) + text(compression) + struct.pack("<Q", len(data)) + data)


HEADER = MAGIC + record(1, text(b"ros2") + text(b"by hand"))
CHANNEL = record(4, struct.pack("<HH", 1, 0) + text(b"/t") + text(b"cdr") + struct.pack("<I", 0))
END = record(15, bytes(4)) + record(2, bytes(20)) + MAGIC


def message(data: bytes, channel_id: int = 1, log_time_ns: int = 0) -> bytes:
    return record(5, struct.pack("<HIQQ", channel_id, 0, log_time_ns, log_time_ns) + data)


LAYOUTS: list[dict[str, Any]] = [
    {},
    {"compression": CompressionType.LZ4},
    {"compression": CompressionType.NONE},
    {"use_chunking": False},
    {"use_chunking": False, "enable_data_crcs": True},
    {"index_types": IndexType.NONE},
    {"index_types": IndexType.CHUNK},
    {"index_types": IndexType.NONE, "repeat_channels": False, "repeat_schemas": False, "use_statistics": False},
    {"use_summary_offsets": False, "repeat_channels": False, "repeat_schemas": False},
    {"enable_crcs": False},
]


@pytest.mark.parametrize("options", LAYOUTS)
@pytest.mark.parametrize("profile", ["ros2", ""])
def test_every_layout_gives_every_message(tmp_path: Path, options: dict[str, Any], profile: str) -> None:
    recording = recording_of(tmp_path, mcap_bytes(MESSAGES, profile, **options))
    assert delivered(recording) == MESSAGES
    assert recording.losses == ()
    has_checksums = options.get("enable_crcs", True) and options.get("use_chunking", True)
    assert recording.integrity_verifiable == (has_checksums or options.get("enable_data_crcs", False))


@pytest.mark.skipif(not CONFORMANCE, reason="no conformance files beside the repository")
def test_conformance_files_give_the_messages_of_their_lists(tmp_path: Path) -> None:
    assert len(CONFORMANCE) == 208
    for path in CONFORMANCE:
        records = [
            (item["type"], dict(item["fields"]))
            for item in json.loads(path.with_suffix(".json").read_text())["records"]
        ]
        channels = {fields["id"]: fields for kind, fields in records if kind == "Channel"}
        schemas = {fields["id"]: fields for kind, fields in records if kind == "Schema"}
        expected = [
            (
                channels[fields["channel_id"]]["topic"],
                schemas.get(channels[fields["channel_id"]]["schema_id"], {"name": ""})["name"],
                int(fields["log_time"]),
                bytes(int(value) for value in fields["data"]),
            )
            for kind, fields in records
            if kind == "Message"
        ]
        recording = McapRecording(path)
        assert delivered(recording) == expected, path.name
        assert recording.losses == (), path.name
        attached = [
            (fields["name"], bytes(map(int, fields["data"]))) for kind, fields in records if kind == "Attachment"
        ]
        assert [(item.name, item.data) for item in recording.attachments()] == attached, path.name
        noted = [(fields["name"], fields["metadata"]) for kind, fields in records if kind == "Metadata"]
        assert list(recording.metadata()) == noted, path.name


def test_keep_is_asked_once_per_channel_and_decides(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, mcap_bytes(MESSAGES))
    asked: list[Channel] = []

    def keep(channel: Channel) -> bool:
        asked.append(channel)
        return channel.topic == "/tf"

    topics = Counter(raw.channel.topic for raw in recording.messages(keep))
    assert topics == {"/tf": 10}
    assert [channel.topic for channel in asked] == ["/tf", "/robot1/map", "/robot2/map", "/robot3/map"]
    first = list(asked)
    list(recording.messages(keep))
    assert asked[4:] == first  # compared by identity: the same objects in the next pass
    assert recording.losses == ()


def test_ros1_profile_has_three_part_names(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start(profile="ros1")
        schema = writer.register_schema("nav_msgs/OccupancyGrid", "ros1msg", b"definition")
        channel = writer.register_channel("/map", "ros1", schema)
        other = writer.register_channel("/other", "json", writer.register_schema("my/Type", "jsonschema", b"{}"))
        writer.add_message(channel, 1, ros1_grid(small_cells()), 1)
        writer.add_message(other, 2, b"{}", 2)
        writer.finish()
    names = [raw.channel.schema_name for raw in McapRecording(path).messages(lambda channel: True)]
    assert names == ["nav_msgs/msg/OccupancyGrid", "my/Type"]


def test_truncation_gives_all_messages_before_it(tmp_path: Path) -> None:
    content = mcap_bytes(MESSAGES)
    whole = recording_of(tmp_path, content)
    assert delivered(whole) == MESSAGES
    data_end = content.rindex(record(15, b"")[:1] + struct.pack("<Q", 4))
    for cut in [*range(100, data_end, 97), len(content) - 20]:
        recording = recording_of(tmp_path, content[:cut])
        found = delivered(recording)
        assert found == MESSAGES[: len(found)]
        if cut <= data_end:
            assert [loss.kind for loss in recording.losses] == ["truncated"], cut
        else:
            assert (len(found), recording.losses) == (40, ())  # only the index behind the data is cut


def test_file_that_ends_after_its_magic_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(LogReadError, match="no whole MCAP file"):
        delivered(recording_of(tmp_path, MAGIC))


def test_flipped_bit_in_a_chunk_loses_that_chunk_and_says_what_was_in_it(tmp_path: Path) -> None:
    content = bytearray(mcap_bytes(MESSAGES, compression=CompressionType.NONE))
    content[content.index(MESSAGES[21].data) + 30] ^= 4
    recording = recording_of(tmp_path, bytes(content))
    found = delivered(recording)
    lost = [item for item in MESSAGES if item not in found]
    assert MESSAGES[21] in lost
    assert len(found) + len(lost) == 40
    assert Counter({loss.topic: loss.count or 0 for loss in recording.losses}) == Counter(item.topic for item in lost)
    assert {loss.kind for loss in recording.losses} == {"chunk crc"}


def test_lost_chunk_of_topics_that_nobody_wants_is_no_loss(tmp_path: Path) -> None:
    content = bytearray(mcap_bytes(MESSAGES, compression=CompressionType.NONE, chunk_size=1))
    content[content.index(MESSAGES[21].data) + 30] ^= 4
    recording = recording_of(tmp_path, bytes(content))
    assert len(list(recording.messages(lambda channel: channel.topic == "/tf"))) == 10
    assert recording.losses == ()


def test_definition_lost_with_its_chunk_comes_from_the_summary(tmp_path: Path) -> None:
    for repeated in (True, False):
        options: dict[str, Any] = {"repeat_channels": repeated, "repeat_schemas": repeated, "chunk_size": 1}
        content = bytearray(mcap_bytes(MESSAGES, compression=CompressionType.NONE, **options))
        content[content.index(MESSAGES[1].data) + 30] ^= 4  # the first message of /robot1/map, with its definition
        recording = recording_of(tmp_path, bytes(content))
        found = delivered(recording)
        lost = sum(loss.count or 0 for loss in recording.losses)
        assert len(found) == (39 if repeated else 30)
        assert len(found) + lost == 40


def test_damaged_record_length_is_overcome_at_the_next_indexed_chunk(tmp_path: Path) -> None:
    content = bytearray(mcap_bytes(MESSAGES, chunk_size=1))
    first_chunk = content.index(b"zstd") - 4 - 28 - 9
    content[first_chunk + 8] ^= 0x40  # the highest byte of its length
    recording = recording_of(tmp_path, bytes(content))
    found = delivered(recording)
    assert found == MESSAGES[1:]
    assert recording.losses[0].kind == "damaged record"
    assert sum(loss.count or 0 for loss in recording.losses) == 1


def test_damaged_summary_is_harmless(tmp_path: Path) -> None:
    content = mcap_bytes(MESSAGES)
    data_end = content.rindex(record(15, b"")[:1] + struct.pack("<Q", 4))
    for position in range(data_end + 13, len(content), 31):
        damaged = bytearray(content)
        damaged[position] ^= 0xFF
        recording = recording_of(tmp_path, bytes(damaged))
        assert delivered(recording) == MESSAGES
        assert recording.losses == ()


def test_fewer_messages_than_the_statistics_count(tmp_path: Path) -> None:
    content = bytearray(mcap_bytes(MESSAGES, use_chunking=False))
    position = content.index(MESSAGES[13].data) - 22 - 9
    content[position] = 0x80  # an opcode that readers skip
    recording = recording_of(tmp_path, bytes(content))
    assert len(delivered(recording)) == 39
    (loss,) = recording.losses
    assert (loss.kind, loss.topic, loss.count) == ("missing messages", "/robot1/map", 1)


def test_data_checksum_speaks_for_messages_outside_chunks(tmp_path: Path) -> None:
    content = bytearray(mcap_bytes(MESSAGES, use_chunking=False, enable_data_crcs=True))
    content[content.index(MESSAGES[13].data) + 30] ^= 4
    recording = recording_of(tmp_path, bytes(content))
    assert len(delivered(recording)) == 40
    assert [loss.kind for loss in recording.losses] == ["data crc"]


def test_channel_defined_anew_is_another_channel(tmp_path: Path) -> None:
    again = record(4, struct.pack("<HH", 1, 0) + text(b"/u") + text(b"cdr") + struct.pack("<I", 0))
    content = HEADER + CHANNEL + message(b"a") + CHANNEL + message(b"b") + again + message(b"c") + END
    recording = recording_of(tmp_path, content)
    assert [(topic, data) for topic, _, _, data in delivered(recording)] == [("/t", b"a"), ("/t", b"b"), ("/u", b"c")]
    assert recording.losses == ()


def test_message_without_definition_is_counted(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, HEADER + CHANNEL + message(b"a", 2) + message(b"b") + message(b"c", 2) + END)
    assert [data for *_, data in delivered(recording)] == [b"b"]
    assert [(loss.kind, loss.count) for loss in recording.losses] == [("definition lost", 2)]


def test_message_without_its_head(tmp_path: Path) -> None:
    inner = CHANNEL + record(5, b"short") + message(b"x")
    recording = recording_of(tmp_path, HEADER + chunk(b"", inner, len(inner)) + record(5, b"short") + END)
    assert [data for *_, data in delivered(recording)] == [b"x"]
    assert [loss.kind for loss in recording.losses] == ["malformed record"] * 2


def test_lost_chunk_with_a_damaged_message_index(tmp_path: Path) -> None:
    index = struct.pack("<BQHI", 7, 2**63, 1, 0)
    recording = recording_of(tmp_path, HEADER + CHANNEL + chunk(b"zstd", b"no zstd", 100) + index)
    assert delivered(recording) == []
    assert [loss.kind for loss in recording.losses] == ["damaged chunk", "truncated"]


ZEROES = zstandard.ZstdCompressor().compress(bytes(300 * 2**20))


def lying_lz4() -> bytes:
    """A frame that says 1000 bytes and holds 100 MiB."""
    blocks = lz4.frame.LZ4FrameCompressor()
    blocks.begin()
    honest = lz4.frame.LZ4FrameCompressor().begin(source_size=1000)
    return bytes(honest + b"".join(blocks.compress(bytes(2**20)) for _ in range(100)) + blocks.flush())


@pytest.mark.parametrize(
    ("bad", "kind"),
    [
        (chunk(b"zstd", ZEROES, 300 * 2**20), "over limit"),
        (chunk(b"zstd", ZEROES, 1000), "damaged chunk"),
        (chunk(b"zstd", ZEROES, 2**62), "over limit"),
        (chunk(b"zstd", zstandard.ZstdCompressor().compress(bytes(100 * 2**20)), 100 * 2**20), "damaged record"),
        (chunk(b"lz4", lying_lz4(), 1000), "damaged chunk"),
        (chunk(b"snappy", b"data", 4), "unknown compression"),
        (chunk(b"zstd", b"no zstd", 100), "damaged chunk"),
        (chunk(b"lz4", b"no lz4", 100), "damaged chunk"),
        (chunk(b"", record(0x80, b"") * 200_000, 9 * 200_000), "over limit"),
        (record(6, b"short"), "damaged record"),
        (record(4, struct.pack("<HHI", 1, 0, 2**31)), "damaged definition"),
    ],
)
def test_bombs_and_nonsense_are_refused_and_the_rest_is_read(tmp_path: Path, bad: bytes, kind: str) -> None:
    recording = recording_of(tmp_path, HEADER + CHANNEL + message(b"a") + bad + message(b"b") + END)
    with ends(1.0):
        assert [data for *_, data in delivered(recording)] == [b"a", b"b"]
    assert [loss.kind for loss in recording.losses] == [kind]


@pytest.mark.parametrize(
    ("tail", "kind"),
    [
        (struct.pack("<BQ", 5, 2**62) + b"abc", "truncated"),
        (bytes(10_000_000), "damaged record"),
        (record(0x80, b"") * 300_000, "over limit"),
    ],
)
def test_floods_end_the_reading(tmp_path: Path, tail: bytes, kind: str) -> None:
    recording = recording_of(tmp_path, HEADER + CHANNEL + message(b"a") + tail)
    with ends(2.0):
        assert len(delivered(recording)) == 1
    assert [loss.kind for loss in recording.losses] == [kind]


def test_limits_are_the_callers(tmp_path: Path) -> None:
    content = HEADER + CHANNEL + message(bytes(200)) + message(b"b") + END
    recording = recording_of(tmp_path, content, record_bytes=100)
    assert [data for *_, data in delivered(recording)] == [b"b"]
    assert [(loss.kind, loss.count) for loss in recording.losses] == [("over limit", 1)]
    recording = recording_of(tmp_path, HEADER + CHANNEL + record(5, b"short") * 9 + message(b"b") + END, losses=3)
    assert [data for *_, data in delivered(recording)] == [b"b"]
    assert [(loss.kind, loss.count) for loss in recording.losses] == [("malformed record", 1)] * 3 + [
        ("further losses", 6)
    ]
    definitions = b"".join(CHANNEL.replace(b"/t", b"/%c" % letter) for letter in b"abcdef")
    recording = recording_of(tmp_path, HEADER + definitions + message(b"a") + END, definitions=3)
    assert delivered(recording) == []
    assert [loss.kind for loss in recording.losses] == ["over limit", "definition lost"]


def test_attachments_and_metadata(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start(profile="ros2")
        writer.add_attachment(5, 6, "map.yaml", "text/yaml", b"image: map.pgm")
        writer.add_attachment(7, 8, "map.pgm", "image/x-portable-graymap", b"P5")
        writer.add_metadata("mapfusion", {"version": "1"})
        writer.finish()
    recording = McapRecording(path)
    assert [item.name for item in recording.attachments()] == ["map.yaml", "map.pgm"]
    assert next(recording.attachments()).create_time_ns == 5
    assert list(recording.metadata()) == [("mapfusion", {"version": "1"})]
    path.write_bytes(path.read_bytes().replace(b"image: map", b"image: mop"))
    assert [item.name for item in recording.attachments()] == ["map.pgm"]
    assert caplog.messages == ["run.mcap: 1 damaged attachments were left out"]
    path.write_bytes(HEADER + record(12, b"") * 1000 + END)
    assert list(recording.metadata()) == []
    assert caplog.messages[1:] == ["run.mcap: 1000 damaged metadata records were left out"]


@pytest.mark.parametrize("options", LAYOUTS[:3])
def test_no_flipped_bit_loses_a_message_silently(tmp_path: Path, options: dict[str, Any]) -> None:
    content = mcap_bytes(MESSAGES, **options)
    rng = random.Random(7)
    for _ in range(250):
        position = rng.randrange(len(content))
        damaged = bytearray(content)
        damaged[position] ^= 1 << rng.randrange(8)
        recording = recording_of(tmp_path, bytes(damaged))
        try:
            found = delivered(recording)
        except LogReadError:
            continue
        assert recording.losses or found == MESSAGES, position
        assert set(found) <= set(MESSAGES) or any(loss.kind == "extra messages" for loss in recording.losses), position


def test_messages_carry_both_times(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        channel = writer.register_channel("/t", "cdr", 0)
        writer.add_message(channel, STAMP_NS + 5, b"x", STAMP_NS)
        writer.finish()
    (raw,) = McapRecording(path).messages(lambda channel: True)
    assert (raw.log_time_ns, raw.publish_time_ns) == (STAMP_NS + 5, STAMP_NS)
    assert (raw.channel.schema_name, raw.channel.schema_data) == ("", b"")


def test_a_chunk_that_only_the_index_knows_is_named(tmp_path: Path) -> None:
    for options in ({"use_statistics": False}, {"use_statistics": False, "index_types": IndexType.CHUNK}):
        content = bytearray(mcap_bytes(MESSAGES, chunk_size=1, **options))
        second_chunk = content.index(b"zstd", content.index(b"zstd") + 4) - 4 - 28 - 9
        assert content[second_chunk] == 6
        content[second_chunk] = 0x86  # a record of a kind that readers pass over
        recording = recording_of(tmp_path, bytes(content))
        assert delivered(recording) == [MESSAGES[0], *MESSAGES[2:]]
        (loss,) = recording.losses
        assert (loss.kind, loss.where) == ("missing chunk", f"chunk at byte {second_chunk}")
        is_indexed = "index_types" not in options
        assert (loss.topic, loss.count) == ((MESSAGES[1].topic, 1) if is_indexed else ("", None))


def test_statistics_that_count_all_messages_and_no_channels(tmp_path: Path) -> None:
    def with_count(count: int) -> bytes:
        statistics = record(11, struct.pack("<QHIIIIQQI", count, 0, 1, 0, 0, 0, 0, 0, 0))
        data = HEADER + CHANNEL + message(b"x")
        start = len(data) + 13
        return data + record(15, bytes(4)) + statistics + record(2, struct.pack("<QQI", start, 0, 0)) + MAGIC

    whole = recording_of(tmp_path, with_count(1))
    assert (len(delivered(whole)), whole.losses) == (1, ())
    lacking = recording_of(tmp_path, with_count(3))
    assert len(delivered(lacking)) == 1
    assert [(loss.kind, loss.count) for loss in lacking.losses] == [("missing messages", 2)]
    assert list(lacking.messages(lambda channel: False)) == []
    assert lacking.losses == ()  # nobody wants what is missing


def test_a_flood_of_tiny_records_in_chunks_ends_by_name(tmp_path: Path) -> None:
    content = mcap_bytes(MESSAGES, chunk_size=1)
    recording = recording_of(tmp_path, content, chunked_records=20)
    found = delivered(recording)
    assert found == MESSAGES[: len(found)]
    assert 5 < len(found) < 20
    assert {loss.kind for loss in recording.losses} == {"over limit"}
    assert sum(loss.count or 0 for loss in recording.losses) == 40 - len(found)


def test_an_index_of_chunks_that_are_not_there(tmp_path: Path) -> None:
    def indexed(count: int, length: int) -> bytes:
        indexes = b"".join(
            record(8, struct.pack("<QQQQI", 0, 0, 100 + start, length, 0) + struct.pack("<QIQQ", 0, 0, 0, 0))
            for start in range(count)
        )
        data = HEADER + CHANNEL + message(b"x") + bytes(count + 200)
        return data + indexes + record(2, struct.pack("<QQI", len(data), 0, 0)) + MAGIC

    for content in (indexed(30_000, 50), indexed(3, 2**64 - 200)):
        recording = recording_of(tmp_path, content)
        with ends(3.0):
            assert len(delivered(recording)) == 1
        assert {loss.kind for loss in recording.losses} <= {"damaged record", "missing chunk", "further losses"}
        assert recording.losses
