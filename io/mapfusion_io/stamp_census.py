"""Which stamps of a recording can be believed: those that lie near the times at which it was recorded.

Clocks of robots need not agree with the recorder's, nor with each other: a robot without a clock of its own lives in
1970, a simulation starts at zero. So a stamp is not compared with the time of its recording, but with how far the
other stamps lie from theirs. All in whole days: that takes no memory to speak of, and a stamp a day off does no harm.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass

import numpy as np

from mapfusion.grid import Mask
from mapfusion.steps import StampArray

DAY_NS = 86_400_000_000_000
END_OF_TIME_NS = 2**31 * 1_000_000_000
"""From here on, 19 January 2038, ROS 2's messages cannot say the time."""
USUAL_SHARE = 0.1
"""What this part of a recording's messages say of their times is no accident."""
USUAL_MESSAGES = 10
"""A day or more apart from the rest, so many messages make a time of recording of its own."""
MAX_SPANS = 200
"""Most times of recording, with days on which nothing was recorded between them; those with the most messages count."""


@dataclass(frozen=True, slots=True)
class StampRanges:
    """Times that can be believed, half-open ranges [first, end) in nanoseconds.

    Attributes:
        ranges_ns: May overlap.
    """

    ranges_ns: tuple[tuple[int, int], ...] = ((0, END_OF_TIME_NS),)

    def hold(self, stamps_ns: StampArray) -> Mask:
        """(N,) whether each of the stamps (N,) can be believed."""
        held = np.zeros(stamps_ns.shape, np.bool_)
        for first_ns, end_ns in self.ranges_ns:
            held |= (stamps_ns >= first_ns) & (stamps_ns < end_ns)
        return held


class StampCensus:
    """Counts on how many days a recording was made, and how many days its topics' stamps lie from that."""

    def __init__(self) -> None:
        self._log_days: Counter[int] = Counter()
        self._lag_days: defaultdict[str, Counter[int]] = defaultdict(Counter)

    def add(self, topic: str, stamp_ns: int, log_time_ns: int) -> None:
        """Takes note of a message."""
        self._log_days[log_time_ns // DAY_NS] += 1
        self._lag_days[topic][(stamp_ns - log_time_ns) // DAY_NS] += 1

    def believable(self) -> dict[str, StampRanges]:
        """Where the stamps of each topic's messages may lie: as far from the recording's times as usual.

        Usual is what a tenth of the recording's messages have in common, or more than half of the topic's, and a day
        more or less.
        """
        total = self._log_days.total()
        all_lags: Counter[int] = Counter()
        for lags in self._lag_days.values():
            all_lags.update(lags)
        usual = {lag for lag, count in all_lags.items() if count >= USUAL_SHARE * total}
        spans = self._usual_days()
        return {
            topic: _ranges(spans, usual | {lag for lag, count in lags.items() if 2 * count > lags.total()})
            for topic, lags in self._lag_days.items()
        }

    def _usual_days(self) -> list[tuple[int, int]]:
        """First and last day of each time of recording; a day on which nothing was recorded parts them."""
        spans: list[tuple[int, int]] = []
        sizes: list[int] = []
        for day in sorted(self._log_days):
            if spans and day - spans[-1][1] <= 1:
                spans[-1] = (spans[-1][0], day)
                sizes[-1] += self._log_days[day]
            else:
                spans.append((day, day))
                sizes.append(self._log_days[day])
        enough = min(USUAL_SHARE * sum(sizes), max(sizes, default=0), USUAL_MESSAGES)
        largest = sorted((-size, span) for span, size in zip(spans, sizes, strict=True) if size >= enough)
        return sorted(span for _, span in largest[:MAX_SPANS])


def _ranges(spans: list[tuple[int, int]], lags: set[int]) -> StampRanges:
    return StampRanges(
        tuple(
            (max((first + lag - 1) * DAY_NS, 0), min((last + lag + 3) * DAY_NS, END_OF_TIME_NS))
            for first, last in spans
            for lag in sorted(lags)
        )
    )
