"""Nothing that a recording says is executed, or trusted as a path, a format or markup."""

import json
import re
from pathlib import Path

import pytest
from mcap.reader import make_reader

from tests.io.making import Sent, mcap_bytes
from tests.reliability.missions import grid, mission, sent
from tests.reliability.running import command

FAST = ("--profile", "paper", "--final-only")
ODD = [
    "../../../etc",
    "a\nlost: nothing",
    "a\r\x1b[2Jb",
    "\x1b]0;title\x07",
    "<script>alert(1)</script>",
    "{0.__class__}%s%n",
    "$(touch pwned)`;",
    "\u202egnp.exe",
    "nul\0byte",
    "x" * 900,
    "7",
    " ",
    "map",
    "\u00e4\u6f22",
    "//",
]


def odd_mission(name: str) -> list[Sent]:
    """A robot of this name and its frames beside the two."""
    odd = [
        sent(f"/{name}/map", grid("a", frame_id=f"{name}/map"), 0.5),
        sent(f"/{name}/map", grid("a", frame_id=f"{name}/elsewhere"), 0.6),
        Sent(f"/{name}/noise", "std_msgs/msg/Empty", 1_700_000_000 * 10**9, b"\0\1\0\0\0"),
    ]
    return [*mission(1), *odd]


@pytest.mark.parametrize("name", ODD)
def test_names_steer_nothing(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    recording, output = tmp_path / "run.mcap", tmp_path / "out" / "fused.mcap"
    output.parent.mkdir()
    recording.write_bytes(mcap_bytes(odd_mission(name)))
    runs = [
        command("info", recording),
        command("replay", recording, output, "-v", *FAST),
        command("replay", recording, output, "--include-inputs", "--force", "--json", *FAST),
        command("replay", recording, output, "--force", "--drop", "nobody", *FAST),
        command("replay", recording, output, "--force", "--reference", "nobody", *FAST),
        command("replay", recording, output, "--force", "--robot", "q=/nowhere", *FAST),
        command("info", recording, "--json"),
    ]
    assert [ran.code for ran in runs] == [3, 3, 3, 2, 2, 2, 3]
    for ran in runs:
        text = ran.out + ran.err
        assert all(char.isprintable() or char == "\n" for char in text)
        assert not re.search("^lost: nothing", text, re.MULTILINE)
        assert max(map(len, text.splitlines())) <= 4_000
        assert len(ran.err.splitlines()) <= 2
    assert len(json.loads(runs[2].out)["robots"]) == 3
    with output.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    topics = {channel.topic for channel in summary.channels.values()}
    assert all(topic.isprintable() for topic in topics)
    assert all(re.fullmatch(r"/[A-Za-z0-9_/]+", topic) for topic in topics if topic.startswith("/fused"))
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == [
        "out",
        "out/fused.mcap",
        "run.mcap",
    ]


def test_names_of_ten_megabytes_are_refused(tmp_path: Path) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "fused.mcap"
    recording.write_bytes(mcap_bytes(odd_mission("n" * 10_000_000)))
    ran = command("replay", recording, output, *FAST)
    assert ran.code == 3
    assert "over limit" in ran.out
    assert len(ran.out) < 10_000
    assert output.stat().st_size < 1_000_000
