"""Plain line charts, drawn with OpenCV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]

WIDTH_PX, HEIGHT_PX = 900, 560
COLOURS: tuple[Colour, ...] = ((178, 114, 0), (0, 94, 213), (115, 158, 0), (167, 121, 204))
"""Blue, green parts first as OpenCV wants them. Source: Okabe and Ito, Color Universal Design, 2008."""

_LEFT_PX, _RIGHT_PX, _TOP_PX, _BOTTOM_PX = 70, 190, 80, 60
_INK, _GREY, _PALE = (40, 40, 40), (130, 130, 130), (225, 225, 225)
_FONT, _FONT_SCALE, _TITLE_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.45, 0.6
_SUBPIXEL_BITS = 4
_MOST_TICKS = 8


@dataclass(frozen=True, slots=True)
class Series:
    """A line of a chart.

    Attributes:
        name: As the legend says it.
        points: (x, y) in the chart's units.
        markers: A dot at every point.
        reference: Drawn thin and grey: something to compare with.
    """

    name: str
    points: Sequence[tuple[float, float]]
    markers: bool = True
    reference: bool = False


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis: what it shows, and from where to where."""

    label: str
    low: float
    high: float

    @property
    def ticks(self) -> list[float]:
        """Round numbers in [low, high], a step of 1, 2, 2.5 or 5 times a power of ten apart."""
        least = (self.high - self.low) / _MOST_TICKS
        decade = 10.0 ** math.floor(math.log10(least))
        step = next(decade * k for k in (1.0, 2.0, 2.5, 5.0, 10.0) if decade * k >= least * (1.0 - 1e-9))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]


def line_chart(title: str, x: Axis, y: Axis, series: Sequence[Series]) -> Image:
    """(560, 900, 3) BGR image; lines are cut at the chart's frame. At most four series that are no reference."""
    image: Image = np.full((HEIGHT_PX, WIDTH_PX, 3), 255, np.uint8)
    plot_width, plot_height = WIDTH_PX - _LEFT_PX - _RIGHT_PX, HEIGHT_PX - _TOP_PX - _BOTTOM_PX

    def to_pixels(points: Sequence[tuple[float, float]]) -> npt.NDArray[np.float64]:
        values = np.array(points, float).reshape(-1, 2)
        along = (values - (x.low, y.low)) / (x.high - x.low, y.high - y.low)
        return np.stack([_LEFT_PX + along[:, 0] * plot_width, _TOP_PX + (1.0 - along[:, 1]) * plot_height], axis=-1)

    for tick in x.ticks:
        bottom, top = to_pixels([(tick, y.low), (tick, y.high)])
        _draw_line(image, np.array([bottom, top]), _PALE, 1)
        _write(image, f"{tick:g}", (bottom[0], bottom[1] + 20), _GREY, centred=True)
    for tick in y.ticks:
        left, right = to_pixels([(x.low, tick), (x.high, tick)])
        _draw_line(image, np.array([left, right]), _PALE, 1)
        _write(image, f"{tick:g}", (left[0] - 8 - _text_width(f"{tick:g}", _FONT_SCALE), left[1] + 5), _GREY)

    frame = image[_TOP_PX : _TOP_PX + plot_height + 1, _LEFT_PX : _LEFT_PX + plot_width + 1]
    colours = iter(COLOURS)
    for k, one in enumerate(series):
        colour = _GREY if one.reference else next(colours)
        _draw_line(frame, to_pixels(one.points) - (_LEFT_PX, _TOP_PX), colour, 1 if one.reference else 2)
        for (along, up), point in zip(one.points, to_pixels(one.points), strict=True):
            if one.markers and x.low <= along <= x.high and y.low <= up <= y.high:
                cv2.circle(image, _fixed(point), 4 << _SUBPIXEL_BITS, colour, cv2.FILLED, cv2.LINE_AA, _SUBPIXEL_BITS)
        legend_y = _TOP_PX + 12 + 24 * k
        legend_x = WIDTH_PX - _RIGHT_PX + 15
        _draw_line(image, np.array([[legend_x, legend_y], [legend_x + 22, legend_y]]), colour, 2)
        _write(image, one.name, (legend_x + 30, legend_y + 5), _INK)

    _write(image, title, (_LEFT_PX, 30), _INK, scale=_TITLE_SCALE)
    _write(image, y.label, (_LEFT_PX, _TOP_PX - 14), _INK)
    _write(image, x.label, (_LEFT_PX + plot_width / 2, HEIGHT_PX - 16), _INK, centred=True)
    return image


def _fixed(point: npt.NDArray[np.float64]) -> tuple[int, int]:
    """A point as OpenCV takes it with `_SUBPIXEL_BITS` of shift."""
    return round(float(point[0]) * (1 << _SUBPIXEL_BITS)), round(float(point[1]) * (1 << _SUBPIXEL_BITS))


def _draw_line(image: Image, path: npt.NDArray[np.float64], colour: Colour, thickness: int) -> None:
    fixed = np.round(path * (1 << _SUBPIXEL_BITS)).astype(np.int32)
    cv2.polylines(image, [fixed], False, colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)


def _write(
    image: Image,
    text: str,
    at: tuple[float, float],
    colour: Colour,
    centred: bool = False,
    scale: float = _FONT_SCALE,
) -> None:
    """Text whose baseline begins at (x, y), or has its middle there."""
    left = at[0] - _text_width(text, scale) / 2 if centred else at[0]
    cv2.putText(image, text, (round(left), round(at[1])), _FONT, scale, colour, 1, cv2.LINE_AA)


def _text_width(text: str, scale: float) -> int:
    return int(cv2.getTextSize(text, _FONT, scale, 1)[0][0])
