"""MCAP files of any profile, read in file order; what is damaged is passed over and named."""

from __future__ import annotations

import logging
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Metadata as MetadataRecord

from mapfusion_io.interfaces import Attachment, Loss, RawMessage
from mapfusion_io.mcap_channels import ChannelObjects, ChannelTable, Keep
from mapfusion_io.mcap_pass import McapPass
from mapfusion_io.mcap_records import MAGIC, DamagedError, Record, parse, records_from
from mapfusion_io.read_errors import os_error, printable
from mapfusion_io.read_limits import ReadLimits

logger = logging.getLogger(__name__)


class McapRecording:
    """A `Recording` in an MCAP file, chunked or not, indexed or not, with or without summary.

    Args:
        path: The file.
        limits: What the file may ask for.
    """

    container = "mcap"

    def __init__(self, path: Path, limits: ReadLimits | None = None) -> None:
        self._path = path
        self._limits = limits or ReadLimits()
        self._channels: ChannelObjects = {}
        self._latest: McapPass | None = None

    @property
    def path(self) -> Path:
        """Where it lies."""
        return self._path

    @property
    def integrity_verifiable(self) -> bool:
        """Whether a checksum stood over every message of the latest pass, and the file has its end."""
        return self._latest is None or self._latest.verified

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What the latest pass could not deliver."""
        return () if self._latest is None else tuple(self._latest.losses)

    def messages(self, keep: Keep) -> Iterator[RawMessage]:
        """The messages of the channels that `keep` wants, in file order.

        Raises:
            LogReadError: Nothing at all can be read.
        """
        table = ChannelTable(self._channels, self._limits, keep)
        self._latest = latest = McapPass(self._path, self._limits, table)
        try:
            with self._path.open("rb") as file:
                yield from latest.messages(file)
        except OSError as error:
            if not latest.num_records:
                raise os_error(self._path, error) from error
            latest.lose("read error", "after the last record read", detail=str(error))

    def attachments(self) -> Iterator[Attachment]:
        """The files inside, in file order; damaged ones are left out with a warning in the log."""
        num_damaged = 0
        for record in self._bodies(Opcode.ATTACHMENT):
            stored_crc = int.from_bytes(record.body[-4:], "little")
            try:
                if stored_crc and zlib.crc32(record.body[:-4]) != stored_crc:
                    raise DamagedError("attachment crc", "its checksum does not match")
                found = parse(AttachmentRecord.read, record.body)
            except DamagedError:
                num_damaged += 1
                continue
            yield Attachment(found.name, found.media_type, found.log_time, found.create_time, found.data)
        self._warn_of_damaged(num_damaged, "attachments")

    def metadata(self) -> Iterator[tuple[str, Mapping[str, str]]]:
        """The metadata records, in file order; damaged ones are left out with a warning in the log."""
        num_damaged = 0
        for record in self._bodies(Opcode.METADATA):
            try:
                found = parse(MetadataRecord.read, record.body)
            except DamagedError:
                num_damaged += 1
                continue
            yield found.name, found.metadata
        self._warn_of_damaged(num_damaged, "metadata records")

    def _warn_of_damaged(self, count: int, what: str) -> None:
        if count:
            logger.warning("%s: %d damaged %s were left out", printable(self._path.name), count, what)

    def _bodies(self, opcode: Opcode) -> Iterator[Record]:
        try:
            with self._path.open("rb") as file:
                size = file.seek(0, 2)
                try:
                    for record in records_from(file, len(MAGIC), size, self._limits, frozenset({opcode})):
                        if record.opcode == opcode and record.length <= self._limits.record_bytes:
                            yield record
                except DamagedError:
                    return  # the pass over the messages names it
        except OSError as error:
            raise os_error(self._path, error) from error
