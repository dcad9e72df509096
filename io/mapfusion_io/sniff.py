"""Which container a file is, told by its first bytes and never by its name."""

from __future__ import annotations

from pathlib import Path

from mapfusion_io.interfaces import Recording
from mapfusion_io.mcap_reader import McapRecording
from mapfusion_io.mcap_records import MAGIC as MCAP_MAGIC
from mapfusion_io.read_errors import os_error, read_error
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.rosbag1_reader import Rosbag1Recording
from mapfusion_io.rosbag2_folder import FolderRecording
from mapfusion_io.rosbag_reader import Sqlite3Recording

ROSBAG1_MAGIC = b"#ROSBAG V2.0"
SQLITE3_MAGIC = b"SQLite format 3\0"

_CONTAINERS = "MCAP (.mcap), ROS 1 bags (.bag), rosbag2 folders and .db3 files can be read."
_COMPRESSED = {
    b"\x28\xb5\x2f\xfd": ("zstd", "zstd -d"),
    b"\x04\x22\x4d\x18": ("lz4", "lz4 -d"),
    b"\x1f\x8b": ("gzip", "gunzip"),
    b"BZh": ("bzip2", "bunzip2"),
    b"\xfd7zXZ\0": ("xz", "unxz"),
    b"PK\x03\x04": ("zip", "unzip"),
}


def open_one(path: Path, limits: ReadLimits | None = None) -> Recording:
    """The recording in a file or rosbag2 folder.

    Args:
        path: The file or folder.
        limits: What the recording may ask for; the defaults where None.

    Raises:
        LogReadError: There is none: missing, empty, not a recording, compressed as a whole, still being written.
    """
    try:
        if path.is_dir():
            return FolderRecording(path, lambda file: open_file(file, limits), limits)
    except OSError as error:
        raise os_error(path, error) from error
    return open_file(path, limits)


def open_file(path: Path, limits: ReadLimits | None = None) -> Recording:
    """The recording in a single file.

    Raises:
        LogReadError: There is none.
    """
    first = _first_bytes(path)
    if first.startswith(MCAP_MAGIC):
        return McapRecording(path, limits)
    if first.startswith(SQLITE3_MAGIC):
        return Sqlite3Recording(path, limits)
    if first.startswith(ROSBAG1_MAGIC):
        return Rosbag1Recording(path, limits)
    if not first:
        raise read_error(path, "is empty", "The recorder wrote nothing: check the disk it was recorded to.")
    if first.startswith(b"#ROSBAG"):
        raise read_error(path, "is a bag of an old version", "Bring it to version 2.0 with `rosbag fix`.")
    for magic, (name, command) in _COMPRESSED.items():
        if first.startswith(magic):
            raise read_error(path, f"is compressed as a whole ({name})", f"Unpack it first: `{command} {path.name}`.")
    if path.suffix in (".mcap", ".bag", ".db3"):
        raise read_error(
            path, f"is no {path.suffix} file: its first bytes are wrong", "It was overwritten, or is another format."
        )
    raise read_error(path, "is not a recording", _CONTAINERS)


def _first_bytes(path: Path) -> bytes:
    """Enough of a file to tell what it is.

    Raises:
        LogReadError: It is missing, no ordinary file, or may not be read.
    """
    try:
        if not path.exists():
            raise read_error(path, "does not exist", "Check the path.")
        if not path.is_file():
            raise read_error(path, "is not an ordinary file", _CONTAINERS)
        with path.open("rb") as file:
            return file.read(16)
    except OSError as error:
        raise os_error(path, error) from error
    except ValueError as error:  # a path with a NUL in it
        raise read_error(path, "is no path", "Check the path.") from error
