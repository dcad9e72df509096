from __future__ import annotations

import numpy as np
import pytest

from mapfusion_cli.plots import COLOURS, HEIGHT_PX, WIDTH_PX, Axis, Series, line_chart

X, Y = Axis("overlap", 0.0, 1.0), Axis("recall", 0.0, 1.0)


def painted(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """(N, 2) columns and rows of the plotting area that have the colour."""
    rows, cols = np.nonzero((image == colour).all(axis=2))
    inside = cols < 720
    return np.stack([cols[inside], rows[inside]], axis=-1)


def test_a_chart_shows_its_lines_where_they_belong() -> None:
    image = line_chart(
        "Recall", X, Y, [Series("rising", [(0.0, 0.0), (1.0, 1.0)]), Series("flat", [(0.0, 0.5), (1.0, 0.5)])]
    )
    assert image.shape == (HEIGHT_PX, WIDTH_PX, 3)
    rising, flat = painted(image, COLOURS[0]), painted(image, COLOURS[1])
    assert np.corrcoef(rising.T)[0, 1] < -0.99  # rows grow downwards
    assert np.ptp(flat[:, 1]) <= 10
    assert flat[:, 1].mean() == pytest.approx((rising[:, 1].min() + rising[:, 1].max()) / 2, abs=3)


def test_lines_are_cut_at_the_frame() -> None:
    image = line_chart("Recall", X, Y, [Series("far out", [(0.5, 0.5), (30.0, 0.5)])])
    assert painted(image, COLOURS[0])[:, 0].max() <= 710


def test_series_without_a_point_and_repeated_charts() -> None:
    charts = [line_chart("Recall", X, Y, [Series("nothing", []), Series("one", [(0.3, 0.7)])]) for _ in range(2)]
    assert np.array_equal(charts[0], charts[1])
    assert len(painted(charts[0], COLOURS[0])) == 0
    assert len(painted(charts[0], COLOURS[1])) > 10


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [(0.0, 1.0, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]), (0.0, 100.0, [0, 20, 40, 60, 80, 100]), (-3.0, 4.0, range(-3, 5))],
)
def test_ticks_are_round_numbers(low: float, high: float, ticks: list[float]) -> None:
    assert Axis("", low, high).ticks == pytest.approx(list(ticks))
