"""Runs the command as a user does, in this process."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import pytest

from mapfusion_cli.main import run


class Ran(NamedTuple):
    """What a run of the command left."""

    code: int
    out: str
    err: str


Command = Callable[..., Ran]


@pytest.fixture
def mapfusion(capsys: pytest.CaptureFixture[str]) -> Command:
    """The command `mapfusion`."""

    def command(*arguments: object) -> Ran:
        with pytest.raises(SystemExit) as ended:
            run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        code = ended.value.code
        return Ran(0 if code is None else int(code), captured.out, captured.err)

    return command
