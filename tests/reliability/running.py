"""The command in this process, and what it may leave."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import NamedTuple

from mcap.reader import make_reader

from mapfusion_cli.main import run


class Ran(NamedTuple):
    """What a run of the command left."""

    code: int
    out: str
    err: str


def command(*arguments: object) -> Ran:
    """Runs `mapfusion`."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            run([str(argument) for argument in arguments])
        except SystemExit as ended:
            code = ended.code
    return Ran(int(code or 0), out.getvalue(), err.getvalue())


def read_whole(path: Path) -> int:
    """Number of messages of an output, every one read with its checksums.

    Raises:
        Exception: It is not whole.
    """
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        count = sum(1 for _ in reader.iter_messages())
        assert count == summary.statistics.message_count
        assert [attachment.name for attachment in reader.iter_attachments()][-1:] == ["summary.json"]
    return count


def complaint_about(ran: Ran, output: Path) -> str:
    """What is wrong with how a run ended, empty where nothing is."""
    left = [item.name for item in output.parent.iterdir() if item.name.endswith(".partial")]
    if ran.code not in (0, 1, 3):
        return f"exit {ran.code}: {ran.err}"
    if "Traceback" in ran.err or "mapfusion itself" in ran.err:
        return ran.err
    if left:
        return f"left behind: {left}"
    if ran.code == 1 and (output.exists() or not 1 <= len(ran.err.splitlines()) <= 2):
        return f"exit 1 with an output or without a clean error: {ran.err}"
    if ran.code in (0, 3):
        read_whole(output)
    return ""
