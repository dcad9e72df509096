"""Damage to recordings, and what may come of reading them: all there, salvaged with a word, or one clean error."""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mapfusion.errors import LogReadError
from mapfusion_io.sniff import open_one

SLOWEST_S = 5.0
EVERY_OFFSET_BYTES = 20_000
Message = tuple[str, str, int, bytes]


def cuts(content: bytes, borders: Sequence[int], seed: int, num_random: int = 2000) -> Iterator[bytes]:
    """Every shorter beginning of a small recording; of a larger one those near its borders, and random ones."""
    if len(content) <= EVERY_OFFSET_BYTES:
        yield from (content[:offset] for offset in range(len(content)))
        return
    near = {border + step for border in borders for step in range(-3, 4)}
    chosen = near | set(random.Random(seed).sample(range(len(content)), num_random))
    yield from (content[:offset] for offset in sorted(chosen) if 0 <= offset < len(content))


def flips(content: bytes, count: int, seed: int) -> Iterator[bytes]:
    """The recording with one bit turned, anywhere."""
    chosen = random.Random(seed)
    for _ in range(count):
        damaged = bytearray(content)
        bit = chosen.randrange(8 * len(content))
        damaged[bit // 8] ^= 1 << bit % 8
        yield bytes(damaged)


def smears(content: bytes, count: int, seed: int) -> Iterator[bytes]:
    """The recording with a stretch overwritten, left out or doubled: a bad sector, a lost or repeated block."""
    chosen = random.Random(seed)
    for _ in range(count):
        start = chosen.randrange(len(content))
        end = min(start + chosen.choice((1, 8, 64, 512, 4096)), len(content))
        stretch = chosen.choice((b"", bytes(end - start), chosen.randbytes(end - start), 2 * content[start:end]))
        yield content[:start] + stretch + content[end:]


@dataclass
class Outcomes:
    """What came of a sweep.

    Attributes:
        counted: Cases by outcome.
        failures: What must not be, in words.
        slowest_s: The longest that a case took, CPU time.
    """

    counted: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    slowest_s: float = 0.0

    def __str__(self) -> str:
        counts = ", ".join(f"{count} {outcome}" for outcome, count in sorted(self.counted.items()))
        return f"{self.counted.total()} cases: {counts}; slowest {self.slowest_s:.3f} s; {len(self.failures)} failures"


def sweep(cases: Iterator[bytes], path: Path, messages: list[Message], *, is_signed: bool) -> Outcomes:
    """Reads every case as the file at `path`.

    Args:
        cases: Contents of the file.
        path: Where to put them.
        messages: What the undamaged recording holds.
        is_signed: Whether checksums stand over all of it, so that what is delivered must be right and nothing may be
            missing without a word. Otherwise a case that is damaged unnoticed counts as `unnoticed`.
    """
    outcomes = Outcomes()
    for number, content in enumerate(cases):
        path.write_bytes(content)
        started_s = time.process_time()
        try:
            outcome = _outcome(path, messages, is_signed=is_signed)
        except Exception as error:
            outcome = "failed"
            outcomes.failures.append(f"case {number}: {error!r}")
        elapsed_s = time.process_time() - started_s
        outcomes.slowest_s = max(outcomes.slowest_s, elapsed_s)
        if elapsed_s > SLOWEST_S:
            outcomes.failures.append(f"case {number}: took {elapsed_s:.1f} s")
        outcomes.counted[outcome] += 1
    return outcomes


def _outcome(path: Path, messages: list[Message], *, is_signed: bool) -> str:
    try:
        recording = open_one(path)
        found = [
            (raw.channel.topic, raw.channel.schema_name, raw.log_time_ns, bytes(raw.data))
            for raw in recording.messages(lambda channel: True)
        ]
    except LogReadError as error:
        if not 1 <= len(str(error).splitlines()) <= 2:
            raise AssertionError(f"an error of several lines: {error}") from error
        return "clean error"
    is_signed = is_signed and recording.integrity_verifiable
    if recording.losses:
        is_said = any(loss.kind == "data crc" for loss in recording.losses)
        if is_signed and not is_said and not _is_part_of(found, messages):
            raise AssertionError("wrong messages were delivered")
        return "salvaged"
    if found == messages:
        return "all there"
    if is_signed:
        raise AssertionError(f"{len(found)} of {len(messages)} messages, or wrong ones, without a word")
    return "unnoticed, integrity not verifiable"


def _is_part_of(found: list[Message], messages: list[Message]) -> bool:
    left = Counter(messages)
    left.subtract(found)
    return min(left.values()) >= 0
