"""A progress bar on stderr, where that is a terminal."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn


class StageProgress:
    """Shows which stage a job is in and how far it is."""

    def __init__(self, *, quiet: bool) -> None:
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            disable=quiet or sys.stderr is None or not sys.stderr.isatty(),
        )
        self._task: TaskID | None = None
        self._first_ns = 0

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def stage(self, name: str, first_ns: int = 0, last_ns: int | None = None) -> None:
        """Starts a stage; with a time range its progress is that of `reached`."""
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._first_ns = first_ns
        self._task = self._bar.add_task(name, total=None if last_ns is None else last_ns - first_ns)

    def reached(self, stamp_ns: int) -> None:
        """The stage has come to this time of the mission."""
        if self._task is not None:
            self._bar.update(self._task, completed=stamp_ns - self._first_ns)
