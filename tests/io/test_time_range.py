import pytest

from mapfusion.errors import ConfigError
from mapfusion_io.time_range import TimeRange

FIRST_NS = 1_700_000_000 * 10**9


@pytest.mark.parametrize(
    ("text", "expected_s"),
    [("12.5", 12.5), ("1700000007.25", 7.25), ("2023-11-14T22:13:30Z", 10.0), ("2023-11-14T23:13:30+01:00", 10.0)],
)
def test_times_as_people_write_them(text: str, expected_s: float) -> None:
    start_ns, end_ns = TimeRange(start=text).resolve(FIRST_NS)
    assert start_ns == FIRST_NS + round(expected_s * 1e9)
    assert end_ns is None


def test_a_duration_counts_from_the_start() -> None:
    assert TimeRange(start="5", duration_s=2.0).resolve(FIRST_NS) == (FIRST_NS + 5 * 10**9, FIRST_NS + 7 * 10**9)
    assert TimeRange(duration_s=2.0).resolve(FIRST_NS) == (None, FIRST_NS + 2 * 10**9)


@pytest.mark.parametrize(
    "bad",
    [
        TimeRange(start="noon"),
        TimeRange(start="-3"),
        TimeRange(start="inf"),
        TimeRange(start="1e300"),
        TimeRange(duration_s=1e300),
        TimeRange(start="5", end="5"),
        TimeRange(end="5", duration_s=1.0),
        TimeRange(duration_s=0.0),
    ],
)
def test_impossible_ranges(bad: TimeRange) -> None:
    with pytest.raises(ConfigError, match="--"):
        bad.resolve(FIRST_NS)
