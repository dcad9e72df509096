import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mapfusion.config import FusionConfig
from mapfusion.errors import MapfusionError
from mapfusion.fusion import PairFuser
from mapfusion.grid import OccupancyGrid
from mapfusion.result import PairFusion
from mapfusion.transform import SE2
from mapfusion.workers import Workers
from tests.fakes import grid_of, rooms, seen_from

PLACE = rooms()
POSES = (SE2(1.0, 2.0, 0.2), SE2(4.0, 9.0, -0.6), SE2(3.0, 5.0, 1.9))
GRIDS = [seen_from(PLACE, pose, (200, 200)) for pose in POSES]
PAIRS = [(GRIDS[0], GRIDS[1]), (GRIDS[0], GRIDS[2]), (GRIDS[1], GRIDS[2])]


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    """The processes that were started."""
    processes: list[subprocess.Popen[bytes]] = []

    class Noted(subprocess.Popen[bytes]):
        def __init__(self, *args: object, **kwargs: object) -> None:
            super().__init__(*args, **kwargs)  # type: ignore[call-overload]
            processes.append(self)

    monkeypatch.setattr(subprocess, "Popen", Noted)
    return processes


@pytest.fixture
def workers(started: list[subprocess.Popen[bytes]]) -> Iterator[Workers]:
    pool = Workers(FusionConfig(), 2)
    yield pool
    pool.close()
    assert all(process.returncode is not None for process in started)


def same(one: PairFusion, other: PairFusion) -> bool:
    return (one.T_target_source, one.confidence, one.reason, dict(one.evidence)) == (
        other.T_target_source,
        other.confidence,
        other.reason,
        dict(other.evidence),
    )


def test_workers_give_what_one_fuser_gives(workers: Workers) -> None:
    alone = PairFuser(FusionConfig())
    found = list(workers.each(lambda pair: workers.fuse(*pair), PAIRS))
    assert all(same(one, alone.fuse(*pair)) for one, pair in zip(found, PAIRS, strict=True))
    T = found[0].T_target_source
    assert T is not None
    assert same(workers.verify(*PAIRS[0], T), alone.verify(*PAIRS[0], T))


def test_maps_that_are_forgotten_are_sent_again(workers: Workers) -> None:
    before = workers.fuse(*PAIRS[0])
    workers.forget_all_but([GRIDS[1], GRIDS[2]])
    assert same(workers.fuse(*PAIRS[0]), before)
    workers.forget_all_but([])
    assert same(workers.fuse(*PAIRS[0]), before)


def test_one_request_at_a_time_needs_one_process(workers: Workers, started: list[subprocess.Popen[bytes]]) -> None:
    for pair in PAIRS:
        workers.fuse(*pair)
    assert len(started) == 1


def test_an_error_in_a_worker_is_raised_here_and_the_worker_goes_on(workers: Workers) -> None:
    with pytest.raises(AttributeError):
        workers.fuse(GRIDS[0], None)  # type: ignore[arg-type]
    assert workers.fuse(*PAIRS[0]).accepted


def test_a_worker_that_was_killed_is_said(workers: Workers, started: list[subprocess.Popen[bytes]]) -> None:
    workers.fuse(*PAIRS[0])
    started[0].kill()
    started[0].wait()
    with pytest.raises(MapfusionError, match="a process that fuses maps ended"):
        workers.fuse(*PAIRS[1])


def test_a_worker_ends_with_its_parent(started: list[subprocess.Popen[bytes]]) -> None:
    pool = Workers(FusionConfig(), 1)
    blank = OccupancyGrid(np.full((5, 5), -1, np.int8), 0.05, SE2.identity())
    pool.fuse(blank, grid_of(blank.cells))
    (process,) = started
    assert process.stdin is not None
    process.stdin.close()  # as the system does when a parent is killed
    assert process.wait(60.0) == 0
    pool.close()


def test_nothing_is_started_after_the_end(started: list[subprocess.Popen[bytes]]) -> None:
    pool = Workers(FusionConfig(), 3)
    pool.close()
    with pytest.raises(MapfusionError, match="were ended"):
        pool.fuse(*PAIRS[0])
    assert len(started) == 1


def test_what_is_printed_at_start_up_does_not_get_between_the_answers(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "sitecustomize.py").write_text("print('hello')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    pool = Workers(FusionConfig(), 1)
    assert pool.fuse(*PAIRS[0]).accepted
    pool.close()
