"""A file is there whole, or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from mapfusion.errors import LogWriteError
from mapfusion_io.atomic import AtomicFile


def write_and_raise(path: Path, data: bytes, error: type[BaseException], *, force: bool = False) -> None:
    with AtomicFile(path, force=force) as file:
        file.write(data)
        raise error


def write(path: Path, data: bytes) -> None:
    with AtomicFile(path) as file:
        file.write(data)


def test_appears_only_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "out.bin"
    with AtomicFile(path) as file:
        assert file.write(b"hello ") == 6
        file.write(memoryview(b"world"))
        assert file.tell() == 11
        assert not path.exists()
        (partial,) = tmp_path.iterdir()
        assert partial.match(f".out.bin.mapfusion-{os.getpid()}-*.partial")
    assert path.read_bytes() == b"hello world"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_an_exception_leaves_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    with pytest.raises(error):
        write_and_raise(tmp_path / "out.bin", b"x" * 100_000, error)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_stays_without_force(tmp_path: Path) -> None:
    path = tmp_path / "out.bin"
    path.write_bytes(b"old")
    with pytest.raises(LogWriteError, match=r"out\.bin: already exists"):
        AtomicFile(path)
    with pytest.raises(RuntimeError):
        write_and_raise(path, b"new", RuntimeError, force=True)
    assert path.read_bytes() == b"old"
    with AtomicFile(path, force=True) as file:
        file.write(b"new")
    assert path.read_bytes() == b"new"


def test_a_file_that_appeared_meanwhile_stays(tmp_path: Path) -> None:
    path = tmp_path / "out.bin"
    with pytest.raises(LogWriteError, match="already exists"), AtomicFile(path):
        path.write_bytes(b"someone else's")
    assert path.read_bytes() == b"someone else's"
    assert list(tmp_path.iterdir()) == [path]


def test_two_writers_of_one_number_do_not_write_into_one_file(tmp_path: Path) -> None:
    path = tmp_path / "out.bin"
    second = b"second" * 1000
    slow = AtomicFile(path, force=True)
    slow.__enter__()
    slow.write(b"first" * 100_000)
    with AtomicFile(path, force=True) as file:
        file.write(second)
    slow.write(b"first" * 100_000)
    assert path.read_bytes() == second
    with pytest.raises(LogWriteError, match="cannot be written"):
        slow.commit()
    assert path.read_bytes() == second
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_a_folder_and_a_device_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogWriteError, match="does not exist"):
        AtomicFile(tmp_path / "missing" / "out.bin")
    with pytest.raises(LogWriteError, match="is a folder"):
        AtomicFile(tmp_path, force=True)
    with pytest.raises(LogWriteError, match="not a regular file"):
        AtomicFile(Path(os.devnull), force=True)


def test_a_name_that_the_system_refuses(tmp_path: Path) -> None:
    with (
        pytest.raises(LogWriteError, match="cannot be written: File name too long"),
        AtomicFile(tmp_path / ("x" * 250)),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    link = tmp_path / "link.bin"
    link.symlink_to(tmp_path / "real" / "out.bin")
    with AtomicFile(link) as file:
        file.write(b"data")
    assert link.is_symlink()
    assert (tmp_path / "real" / "out.bin").read_bytes() == b"data"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = Path.open
    monkeypatch.setattr(Path, "open", lambda path, mode: opened(Path("/dev/full"), "wb") if mode == "xb" else None)
    for num_bytes in (10, 10_000_000):  # the first fits the buffer and fails at the end
        with pytest.raises(LogWriteError, match=r"out\.bin: cannot be written: No space left"):
            write(tmp_path / "out.bin", b"x" * num_bytes)
    assert list(tmp_path.iterdir()) == []


def test_bytes_that_cannot_be_made_safe_are_no_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(descriptor: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(LogWriteError, match="Input/output error"):
        write(tmp_path / "out.bin", b"data")
    assert list(tmp_path.iterdir()) == []


def test_needs_to_be_open(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not open"):
        AtomicFile(tmp_path / "out.bin").write(b"data")
