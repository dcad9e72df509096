"""Bounds on what a recording may make its reader do."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """What a recording may ask for. What is over a limit is passed over and named as a loss.

    Attributes:
        record_bytes: Largest record, and largest chunk once decompressed.
        definitions: Most channels, counting each redefinition.
        idle_records: Most records in a row that hold no message.
        losses: Most losses that are noted one by one.
    """

    record_bytes: int = 256 * 2**20
    definitions: int = 65_536
    idle_records: int = 100_000
    losses: int = 1_000
