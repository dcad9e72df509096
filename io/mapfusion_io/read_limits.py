"""Bounds on what a recording may make its reader do."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """What a recording may ask for. What is over a limit is passed over and named as a loss.

    Attributes:
        record_bytes: Largest record, and largest chunk once decompressed.
        map_cells: Largest map.
        all_cells: Most cells of all robots' maps together, of each robot its largest.
        messages: Most maps, transforms and poses that are taken of a recording; a message with several transforms
            counts as several.
        robots: Most robots of a mission.
        sample_bytes: Largest message with transforms or a pose.
        updated_cells: Most cells of maps that patches are laid over, counted for every patch: each makes a map anew.
        held_cells: Most cells of maps that wait for an earlier map which stands later in the file.
        definitions: Most channels, counting each redefinition.
        definition_bytes: Total size of all definitions of channels and types.
        name_characters: Longest name of a topic or type.
        frames: Most frames that one topic may name.
        chunked_records: Most records in all chunks of a recording; the chunk that reaches it is read to its end.
        idle_records: Most records in a row that hold no message.
        losses: Most losses that are noted one by one, and most reasons for which a topic's messages are refused.

    Raises:
        ValueError: A limit below 1.
    """

    record_bytes: int = 256 * 2**20
    map_cells: int = 32 * 2**20
    all_cells: int = 128 * 2**20
    messages: int = 10_000_000
    robots: int = 100
    sample_bytes: int = 2**20
    updated_cells: int = 2**36
    held_cells: int = 2**30
    definitions: int = 65_536
    definition_bytes: int = 64 * 2**20
    name_characters: int = 1_024
    frames: int = 10_000
    chunked_records: int = 50_000_000
    idle_records: int = 100_000
    losses: int = 1_000

    def __post_init__(self) -> None:
        for field in fields(self):
            if getattr(self, field.name) < 1:
                raise ValueError(f"the limit {field.name} must be at least 1, not {getattr(self, field.name)}")
