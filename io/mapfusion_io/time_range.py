"""The part of a mission to use, as a person writes it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from mapfusion.config import MAX_SPAN_S
from mapfusion.errors import ConfigError

UNIX_FROM_S = 1e8
"""Numbers from here on are unix times; smaller ones are seconds from the mission's start (1e8 s are three years)."""
LAST_S = 9e9
"""Unix times end soon after, as nanoseconds of 64 bits."""


@dataclass(frozen=True, slots=True)
class TimeRange:
    """Half-open, [start, end).

    Attributes:
        start: Seconds from the mission's start, unix seconds, or RFC 3339; None from the beginning.
        end: The same; None to the end.
        duration_s: Instead of `end`: seconds from the range's start.
    """

    start: str | None = None
    end: str | None = None
    duration_s: float | None = None

    def resolve(self, first_ns: int) -> tuple[int | None, int | None]:
        """Start and end in nanoseconds, None where open.

        Raises:
            ConfigError: Not a time, or an empty range.
        """
        if self.end is not None and self.duration_s is not None:
            raise ConfigError("--end and --duration exclude each other")
        start_ns = None if self.start is None else _parse("--start", self.start, first_ns)
        end_ns = None if self.end is None else _parse("--end", self.end, first_ns)
        if self.duration_s is not None:
            if not 0.0 < self.duration_s <= MAX_SPAN_S:
                raise ConfigError(f"--duration must be > 0 s and at most {MAX_SPAN_S:g} s, not {self.duration_s:g}")
            end_ns = (first_ns if start_ns is None else start_ns) + round(self.duration_s * 1e9)
        if start_ns is not None and end_ns is not None and end_ns <= start_ns:
            raise ConfigError("the time range is empty: --end lies before --start")
        return start_ns, end_ns


def _parse(option: str, text: str, first_ns: int) -> int:
    try:
        seconds = float(text)
    except ValueError:
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            raise ConfigError(
                f"{option} {text}: neither seconds from the start, unix seconds nor a time like 2026-01-31T12:00:00Z"
            ) from None
        moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        return round(moment.timestamp() * 1e9)
    if not 0.0 <= seconds <= LAST_S:
        raise ConfigError(f"{option} {text}: must be a number of seconds from 0 to {LAST_S:g}")
    whole, fraction = divmod(seconds, 1.0)
    return int(whole) * 1_000_000_000 + round(fraction * 1e9) + (0 if seconds >= UNIX_FROM_S else first_ns)
