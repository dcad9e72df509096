"""A rosbag2 folder: one recording in several files."""

from __future__ import annotations

import logging
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import zstandard
from ruamel.yaml import YAML

from mapfusion.errors import LogReadError
from mapfusion.steps import natural_key
from mapfusion_io.interfaces import Attachment, Channel, Loss, RawMessage, Recording
from mapfusion_io.read_errors import printable, read_error, words
from mapfusion_io.read_limits import ReadLimits

logger = logging.getLogger(__name__)

METADATA_NAME = "metadata.yaml"
_METADATA_BYTES = 16 * 2**20
_NEEDED = re.compile(r"^( *)(?:relative_file_paths|compression_mode):.*(?:\n\1(?: +|- ).*)*", re.MULTILINE)
"""What reading needs of it, in the block style of every writer: the parser takes ten seconds for a megabyte."""
_NEEDED_CHARACTERS = 2**18
_SUFFIXES = (".mcap", ".db3")


@dataclass(frozen=True, slots=True)
class FolderMetadata:
    """What metadata.yaml says, as far as reading needs it.

    Attributes:
        file_names: The files, in order; base names only, so that nothing outside the folder is read.
        compression_mode: `file`, `message` or empty.
    """

    file_names: tuple[str, ...]
    compression_mode: str = ""


class FolderRecording:
    """A `Recording` in a rosbag2 folder, its files read one after the other.

    Args:
        path: The folder.
        open_file: Opens a single file as a recording.
        limits: What a file may ask for.

    Raises:
        LogReadError: There is no recording in the folder.
    """

    def __init__(self, path: Path, open_file: Callable[[Path], Recording], limits: ReadLimits | None = None) -> None:
        self._path = path
        self._limits = limits or ReadLimits()
        self._own_losses: list[Loss] = []
        self._bad_messages: dict[str, int] = {}
        metadata = read_metadata(path)
        self._compressed = metadata is not None and metadata.compression_mode == "message"
        if metadata is None:
            names = sorted((item.name for item in path.iterdir() if item.suffix in _SUFFIXES), key=natural_key)
        else:
            names = list(metadata.file_names)
        if metadata is not None and metadata.compression_mode == "file":
            raise read_error(path, "its files are compressed as a whole", f"Unpack them first: `zstd -d {names[0]}`.")
        self._parts = self._opened(names, open_file)

    def _opened(self, names: list[str], open_file: Callable[[Path], Recording]) -> tuple[Recording, ...]:
        """The files that can be opened; the others are losses, unless nothing is left."""
        parts: list[Recording] = []
        first_error: LogReadError | None = None
        for name in names:
            file = self._path / name
            try:
                if not file.is_file():
                    raise read_error(file, "is missing", f"{METADATA_NAME} names it: copy the whole folder.")
                parts.append(open_file(file))
            except LogReadError as error:
                first_error = first_error or error
                self._own_losses.append(Loss(name, "missing file", name, detail=str(error).splitlines()[0]))
        if not parts:
            raise first_error or read_error(
                self._path, "a folder without a recording", "Give a rosbag2 folder, or the recordings themselves."
            )
        return tuple(parts)

    @property
    def path(self) -> Path:
        """Where it lies."""
        return self._path

    @property
    def container(self) -> str:
        """`rosbag2-mcap` or `rosbag2-sqlite3`."""
        return "rosbag2-mcap" if self._parts[0].container == "mcap" else "rosbag2-sqlite3"

    @property
    def integrity_verifiable(self) -> bool:
        """Whether all of its files carry checksums."""
        return all(part.integrity_verifiable for part in self._parts)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What the latest pass could not deliver."""
        bad = (
            Loss(self._path.name, "damaged message", "whole folder", topic, count, "it cannot be decompressed")
            for topic, count in self._bad_messages.items()
        )
        return (*self._own_losses, *(loss for part in self._parts for loss in part.losses), *bad)

    def messages(self, keep: Callable[[Channel], bool]) -> Iterator[RawMessage]:
        """The messages of the channels that `keep` wants, file by file; every file has channels of its own.

        A file of which nothing can be read is a loss, as long as another one can be read.

        Raises:
            LogReadError: Nothing at all can be read.
        """
        self._own_losses = [loss for loss in self._own_losses if loss.kind == "missing file"]
        self._bad_messages = {}
        errors: list[LogReadError] = []
        for part in self._parts:
            try:
                yield from self._unpacked(part.messages(keep)) if self._compressed else part.messages(keep)
            except LogReadError as error:
                errors.append(error)
                first_line = str(error).splitlines()[0]
                self._own_losses.append(Loss(part.path.name, "unreadable file", part.path.name, detail=first_line))
        if len(errors) == len(self._parts):
            raise errors[0]

    def attachments(self) -> Iterator[Attachment]:
        """The files inside its files."""
        for part in self._parts:
            yield from part.attachments()

    def metadata(self) -> Iterator[tuple[str, Mapping[str, str]]]:
        """The metadata records inside its files."""
        for part in self._parts:
            yield from part.metadata()

    def _unpacked(self, messages: Iterator[RawMessage]) -> Iterator[RawMessage]:
        """Messages that were compressed one by one."""
        for raw in messages:
            try:
                size = zstandard.frame_content_size(raw.data)
                if size > self._limits.record_bytes:
                    raise ValueError(f"a message of {size} bytes")
                data = zstandard.ZstdDecompressor().decompress(raw.data, max_output_size=self._limits.record_bytes)
            except (zstandard.ZstdError, ValueError, MemoryError):
                topic = raw.channel.topic
                self._bad_messages[topic] = self._bad_messages.get(topic, 0) + 1
                continue
            yield raw._replace(data=data)


def read_metadata(folder: Path) -> FolderMetadata | None:
    """What metadata.yaml says; None where there is none or it cannot be read: the files speak for themselves."""
    path = folder / METADATA_NAME
    if not path.is_file():
        return None
    try:
        with path.open("rb") as file:
            text = file.read(_METADATA_BYTES + 1)
        if len(text) > _METADATA_BYTES:
            raise ValueError("more than 16 MiB")
        needed = textwrap.dedent("\n".join(found[0] for found in _NEEDED.finditer(text.decode())))
        if len(needed) > _NEEDED_CHARACTERS:
            raise ValueError(f"more than {_NEEDED_CHARACTERS} characters of file names")
        content: Any = YAML(typ="safe", pure=True).load(needed)
        names = tuple(dict.fromkeys(PurePosixPath(_plain(name)).name for name in content["relative_file_paths"]))
        mode = _plain(content.get("compression_mode") or "").lower()
    except Exception as error:  # YAML errors are of many kinds
        logger.warning("%s: %s cannot be used (%s)", printable(folder.name), METADATA_NAME, words(error))
        return None
    if not names:
        return None
    return FolderMetadata(names, "" if mode == "none" else mode)


def _plain(value: object) -> str:
    """A text; what is nested may be without end when it is written out."""
    if not isinstance(value, str | int | float):
        raise TypeError("a file's name that is no text")
    return str(value)
