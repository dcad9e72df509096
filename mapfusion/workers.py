"""Processes that look at pairs of maps: in threads the interpreter's lock would change hands at every small step.

A worker is sent each map once and keeps what it worked out about it. Messages are pickled, over its standard input and
output: a worker whose parent is gone, however it ended, reads the end of its input and ends as well.
"""

from __future__ import annotations

import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from threading import Condition
from typing import IO, Protocol, TypeVar

import cv2

from mapfusion.config import FusionConfig
from mapfusion.errors import MapfusionError
from mapfusion.fusion import PairFuser
from mapfusion.grid import OccupancyGrid
from mapfusion.result import PairFusion
from mapfusion.transform import SE2

ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")

_READY = b"\0mapfusion is ready\0"
"""Precedes a worker's answers: whatever the interpreter printed while it started stands before."""


class Fuser(Protocol):
    """Looks at pairs of maps: a PairFuser, or the processes that have one each."""

    def fuse(self, target: OccupancyGrid, source: OccupancyGrid, is_thorough: bool = True) -> PairFusion:
        """As PairFuser.fuse."""

    def verify(self, target: OccupancyGrid, source: OccupancyGrid, T_target_source: SE2) -> PairFusion:
        """As PairFuser.verify."""

    def forget_all_but(self, grids: Iterable[OccupancyGrid]) -> None:
        """As PairFuser.forget_all_but."""


class Map(Protocol):
    """Applies a function to every item, in order, as `map` does; maybe to several at once."""

    def __call__(self, function: Callable[[ItemT], ResultT], items: Iterable[ItemT], /) -> Iterable[ResultT]: ...


@dataclass(frozen=True, slots=True)
class Request:
    """What a worker is asked.

    Attributes:
        kept: Numbers of the maps that are still in use.
        new: Maps that the worker does not have yet, by number.
        target: Number of the target.
        source: Number of the source.
        T_target_source: Transform to be verified; None where one is searched.
        is_thorough: Whether a search is thorough.
    """

    kept: frozenset[int]
    new: Mapping[int, OccupancyGrid]
    target: int
    source: int
    T_target_source: SE2 | None
    is_thorough: bool


class Workers:
    """Processes that fuse pairs. Gives the same as a PairFuser, and may be used from several threads.

    Args:
        config: How pairs are fused.
        max_workers: Most processes, >= 1. One is started at once, each other one when all are busy.
    """

    def __init__(self, config: FusionConfig, max_workers: int) -> None:
        self._config, self._max_workers = config, max_workers
        self._workers = [_Worker(config)]
        self._idle, self._changed, self._is_closed = list(self._workers), Condition(), False
        self._threads = ThreadPoolExecutor(max_workers)

    def fuse(self, target: OccupancyGrid, source: OccupancyGrid, is_thorough: bool = True) -> PairFusion:
        """As PairFuser.fuse; waits for a worker.

        Raises:
            MapfusionError: A worker ended, which only happens from outside: for want of memory, by a signal.
        """
        return self._ask(target, source, None, is_thorough)

    def verify(self, target: OccupancyGrid, source: OccupancyGrid, T_target_source: SE2) -> PairFusion:
        """As PairFuser.verify; waits for a worker, and raises as `fuse` does."""
        return self._ask(target, source, T_target_source, False)

    def forget_all_but(self, grids: Iterable[OccupancyGrid]) -> None:
        """Drops maps that are no longer in use."""
        kept = frozenset(grids)
        for worker in self._workers:
            worker.forget_all_but(kept)

    def each(self, function: Callable[[ItemT], ResultT], items: Iterable[ItemT]) -> Iterable[ResultT]:
        """Applies a function that asks the workers to every item, in order, as `map` does; as many at once."""
        return self._threads.map(function, items)

    def close(self) -> None:
        """Ends the workers, whatever they are at."""
        with self._changed:
            self._is_closed = True
        for worker in self._workers:
            worker.end()
        self._threads.shutdown(cancel_futures=True)

    def _ask(
        self, target: OccupancyGrid, source: OccupancyGrid, T_target_source: SE2 | None, is_thorough: bool
    ) -> PairFusion:
        worker = self._take(target, source)
        try:
            return worker.ask(target, source, T_target_source, is_thorough)
        finally:
            with self._changed:
                self._idle.append(worker)
                self._changed.notify()

    def _take(self, target: OccupancyGrid, source: OccupancyGrid) -> _Worker:
        """An idle worker, the one that has most of the maps."""
        with self._changed:
            if self._is_closed:
                raise MapfusionError("the processes that fuse maps were ended")
            if not self._idle and len(self._workers) < self._max_workers:
                self._workers.append(_Worker(self._config))
                return self._workers[-1]
            self._changed.wait_for(lambda: self._idle)
            worker = max(self._idle, key=lambda one: one.num_known(target, source))
            self._idle.remove(worker)
            return worker


class _Worker:
    """One process, and which maps it has."""

    def __init__(self, config: FusionConfig) -> None:
        # Not by `multiprocessing`: it would run the caller's script once more. A session of its own keeps a terminal's
        # Ctrl-C from it: its parent ends it.
        folders = [__file__.rpartition("mapfusion")[0], *(folder for folder in sys.path if isinstance(folder, str))]
        code = f"import sys; sys.path[:] = {folders!r}; from mapfusion.workers import serve_parent; serve_parent()"
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
            )
        except OSError as error:
            raise MapfusionError(
                f"no process can be started to fuse maps ({error}); with one job none is needed"
            ) from error
        self._numbers: dict[OccupancyGrid, int] = {}
        self._next_number = count()
        self._config = config
        self._is_new = True

    def num_known(self, *grids: OccupancyGrid) -> int:
        """How many of the maps it has."""
        return sum(grid in self._numbers for grid in grids)

    def forget_all_but(self, grids: frozenset[OccupancyGrid]) -> None:
        """Drops all other maps, with the next request."""
        self._numbers = {grid: number for grid, number in self._numbers.items() if grid in grids}

    def ask(
        self, target: OccupancyGrid, source: OccupancyGrid, T_target_source: SE2 | None, is_thorough: bool
    ) -> PairFusion:
        """Waits for the answer to one request."""
        new = {}
        for grid in (target, source):
            if grid not in self._numbers:
                number = self._numbers[grid] = next(self._next_number)
                new[number] = grid
        request = Request(
            kept=frozenset(self._numbers.values()),
            new=new,
            target=self._numbers[target],
            source=self._numbers[source],
            T_target_source=T_target_source,
            is_thorough=is_thorough,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            if self._is_new:
                _send(self._config, self._process.stdin)
                _skip_to(_READY, self._process.stdout)
                self._is_new = False
            _send(request, self._process.stdin)
            reply = pickle.load(self._process.stdout)
        except (OSError, EOFError, ValueError, pickle.UnpicklingError) as error:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(1.0)
            code = self._process.returncode
            raise MapfusionError(
                f"a process that fuses maps ended (exit code {code}); with one job none is needed"
            ) from error
        if isinstance(reply, BaseException):
            raise reply
        assert isinstance(reply, PairFusion)
        return reply

    def end(self) -> None:
        """Ends the process."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(OSError):  # of a request that was not sent to its end
                pipe.close()


def serve_parent() -> None:
    """Runs in a worker: answers its parent until it is gone."""
    cv2.setNumThreads(1)
    if hasattr(signal, "SIGPIPE"):  # not on Windows
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # an answer that nobody waits for any more ends the worker
    replies, sys.stdout = sys.stdout.buffer, sys.stderr  # nothing that is printed must get between the answers
    serve(sys.stdin.buffer, replies)


def serve(requests: IO[bytes], replies: IO[bytes]) -> None:
    """Answers requests until they end; before the first one comes the configuration."""
    try:
        fuser = PairFuser(pickle.load(requests))
        replies.write(_READY)
        replies.flush()
        grids: dict[int, OccupancyGrid] = {}
        while True:
            request: Request = pickle.load(requests)
            grids = {number: grid for number, grid in {**grids, **request.new}.items() if number in request.kept}
            fuser.forget_all_but(grids.values())
            _send(_answer(fuser, grids[request.target], grids[request.source], request), replies)
    except (EOFError, pickle.UnpicklingError):  # the parent is gone, maybe in the middle of a request
        return


def _answer(fuser: PairFuser, target: OccupancyGrid, source: OccupancyGrid, request: Request) -> PairFusion | Exception:
    try:
        if request.T_target_source is None:
            return fuser.fuse(target, source, request.is_thorough)
        return fuser.verify(target, source, request.T_target_source)
    except Exception as error:  # the parent raises it
        return error


def _skip_to(marker: bytes, stream: IO[bytes]) -> None:
    read = b""
    while not read.endswith(marker):
        byte = stream.read(1)
        if not byte:
            raise EOFError
        read = (read + byte)[-len(marker) :]


def _send(message: object, stream: IO[bytes]) -> None:
    pickle.dump(message, stream, protocol=pickle.HIGHEST_PROTOCOL)
    stream.flush()
