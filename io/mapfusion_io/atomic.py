"""Files that appear under their name whole or not at all."""

from __future__ import annotations

import atexit
import contextlib
import logging
import os
import re
import secrets
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from mapfusion.errors import LogWriteError
from mapfusion_io.read_errors import printable

logger = logging.getLogger(__name__)


class AtomicFile:
    """A binary file that is written under another name and renamed when it is complete.

    It grows as `.NAME.mapfusion-PID-RANDOM.partial` beside its final name, so that the rename stays on one file system.
    Leaving the `with` block commits it; leaving by an exception, KeyboardInterrupt included, discards it, and so does
    the end of the interpreter. What only a killed process or a power cut leaves behind is told by its name: the next
    file of this name removes it, unless another process of that number runs. A symbolic link is followed: the file it
    names is replaced, not the link.

    Args:
        path: The final name.
        force: Replace a file that already has the name.

    Raises:
        LogWriteError: The name is taken, the folder is missing or cannot be written, or, later on, the medium fails.
            Nothing of this file is left then.
    """

    def __init__(self, path: Path, *, force: bool = False) -> None:
        self._name = path
        self._target = Path(os.path.realpath(path))
        # processes in different containers may have one number, and must not write into one file
        unique = f"{os.getpid()}-{secrets.token_hex(4)}"
        self._partial = self._target.with_name(f".{self._target.name}.mapfusion-{unique}.partial")
        self._force = force
        self._stream: BinaryIO | None = None
        refuse_target(self._name, force=self._force)

    def __enter__(self) -> Self:
        _remove_leftovers(self._target)
        # a signal may strike between the opening and the `with` block
        atexit.register(self._remove_partial)
        try:
            self._stream = self._partial.open("xb")
        except OSError as error:
            raise _failure(self._name, error) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.commit()
        else:
            self.discard()

    def write(self, data: bytes | memoryview) -> int:
        """Appends `data` and returns its length in bytes."""
        try:
            return self._open_stream().write(data)
        except OSError as error:
            raise _failure(self._name, error) from error

    def tell(self) -> int:
        """Number of bytes written so far."""
        return self._open_stream().tell()

    def commit(self) -> None:
        """Gives the file its name, once its bytes are safe; what went wrong before leaves nothing behind."""
        stream = self._open_stream()
        try:
            stream.flush()
            os.fsync(stream.fileno())
            stream.close()
            refuse_target(self._name, force=self._force)
            os.replace(self._partial, self._target)
        except OSError as error:
            raise _failure(self._name, error) from error
        finally:
            self.discard()
        _sync_folder(self._target.parent)

    def discard(self) -> None:
        """Removes what was written and not committed; harmless when there is nothing."""
        stream, self._stream = self._stream, None
        if stream is None:
            return
        with contextlib.suppress(OSError):  # closing flushes, which fails again on a full disk
            stream.close()
        self._remove_partial()
        atexit.unregister(self._remove_partial)

    def _remove_partial(self) -> None:
        with contextlib.suppress(OSError):
            self._partial.unlink(missing_ok=True)

    def _open_stream(self) -> BinaryIO:
        if self._stream is None:
            raise ValueError("the file is not open")
        return self._stream


def _remove_leftovers(target: Path) -> None:
    """Removes what processes that were killed left of a file of this name."""
    pattern = re.compile(re.escape(f".{target.name}.mapfusion-") + r"([0-9]{1,10})-[0-9a-f]{8}\.partial")
    with contextlib.suppress(OSError):
        for item in target.parent.iterdir():
            found = pattern.fullmatch(item.name)
            if found and item.is_file() and not item.is_symlink() and not _is_running(int(found[1])):
                item.unlink()
                logger.warning("%s: removed, left by a run that was killed", printable(str(item)))


def _is_running(process_id: int) -> bool:
    """Whether there is such a process, and another one; True where the system cannot tell without harm."""
    if process_id == os.getpid():  # after a restart of a container its processes have the numbers of those before
        return False
    if os.name != "posix":
        return True
    try:
        os.kill(process_id, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def refuse_target(path: Path, *, force: bool) -> None:
    """Refuses a name under which no file can or may be written.

    Raises:
        LogWriteError: The name is taken and not by force, or is no file's; or its folder is missing.
    """
    target = Path(os.path.realpath(path))
    try:
        if not target.parent.is_dir():
            raise LogWriteError(f"{path}: the folder {target.parent} does not exist; create it first")
        if target.is_dir():
            raise LogWriteError(f"{path}: is a folder; name a file")
        if target.exists() and not target.is_file():
            raise LogWriteError(f"{path}: is not a regular file; name another output")
        if target.exists() and not force:
            raise LogWriteError(f"{path}: already exists; give --force to replace it, or name another output")
    except OSError as error:
        raise _failure(path, error) from error


def _failure(path: Path, error: OSError) -> LogWriteError:
    return LogWriteError(f"{path}: cannot be written: {error.strerror or error}")


def _sync_folder(folder: Path) -> None:
    """Makes a rename in `folder` survive a power cut, where the system can do that for folders."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
