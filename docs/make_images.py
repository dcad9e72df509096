"""Draws the README's picture: the robots' own maps above, the merged map of `data/samples` with their paths below."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.config import ReplayConfig
from mapfusion.grid import OccupancyGrid, crop_to_known
from mapfusion.pipeline import replay
from mapfusion.steps import Event, FusionStep, GridEvent
from mapfusion_io.mission import open_recording

ROOT = Path(__file__).resolve().parents[1]
COLOURS = ((200, 90, 30), (40, 130, 40), (50, 50, 210), (160, 60, 160))
"""BGR, by robot."""
Image = npt.NDArray[np.uint8]


def main() -> None:
    """Writes docs/images/merged.png."""
    own, last = replayed(ROOT / "data" / "samples" / "three_robots.mcap")
    merged = crop_to_known(last.maps[1], 4)
    fused = picture(merged, 2)
    for colour, path in zip(COLOURS, last.paths.values(), strict=False):
        points = pixels(merged, path.poses[:, :2], 2)
        cv2.polylines(fused, [points.reshape(-1, 1, 2)], False, colour, 2, cv2.LINE_AA, shift=3)
        cv2.circle(fused, (int(points[-1, 0]), int(points[-1, 1])), 5 << 3, colour, -1, cv2.LINE_AA, shift=3)
    row = beside(
        [titled(picture(crop_to_known(own[robot], 4), 1), robot, COLOURS[i]) for i, robot in enumerate(last.paths)]
    )
    cv2.imwrite(str(ROOT / "docs" / "images" / "merged.png"), stacked([row, titled(fused, "merged, in frame world")]))


def replayed(path: Path) -> tuple[dict[str, OccupancyGrid], FusionStep]:
    """Each robot's newest map and the last step of a mission."""
    mission, own = open_recording([path]), {}

    def noted() -> Iterator[Event]:
        for event in mission.events():
            if isinstance(event, GridEvent):
                own[event.robot] = event.grid
            yield event

    (last,) = replay(noted(), ReplayConfig(final_only=True))
    return own, last


def picture(grid: OccupancyGrid, scale: int) -> Image:
    """BGR picture, row 0 of the grid at the bottom: free white, walls black, unknown grey."""
    grey = np.where(grid.known, 255 - grid.cells.astype(np.int16) * 255 // 100, 205).astype(np.uint8)[::-1]
    large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    return cv2.cvtColor(large, cv2.COLOR_GRAY2BGR)  # type: ignore[return-value]


def pixels(grid: OccupancyGrid, points_m: npt.NDArray[np.float64], scale: int) -> npt.NDArray[np.int32]:
    """Points (N, 2) of the grid's frame in the picture, with three fractional bits."""
    cells = grid.T_frame_grid.inverse().apply(points_m) / grid.resolution_m
    flipped = np.stack([cells[:, 0], grid.height - cells[:, 1]], axis=1) * scale
    return np.rint(flipped * 8).astype(np.int32)


def titled(image: Image, title: str, colour: tuple[int, int, int] = (0, 0, 0)) -> Image:
    """The picture under its title."""
    framed = cv2.copyMakeBorder(image, 34, 6, 6, 6, cv2.BORDER_CONSTANT, value=(255, 255, 255))
    cv2.putText(framed, title, (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7, colour, 2, cv2.LINE_AA)
    return framed  # type: ignore[return-value]


def beside(images: Sequence[Image]) -> Image:
    """Pictures in a row."""
    return np.hstack([padded(image, max(one.shape[0] for one in images), image.shape[1]) for image in images])


def stacked(images: Sequence[Image]) -> Image:
    """Pictures in a column."""
    return np.vstack([padded(image, image.shape[0], max(one.shape[1] for one in images)) for image in images])


def padded(image: Image, height: int, width: int) -> Image:
    """The picture with white to its right and below."""
    down, right = height - image.shape[0], width - image.shape[1]
    return cv2.copyMakeBorder(image, 0, down, 0, right, cv2.BORDER_CONSTANT, value=(255, 255, 255))  # type: ignore[return-value]


if __name__ == "__main__":
    main()
