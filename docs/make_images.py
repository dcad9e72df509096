"""Draws the pictures of the README and of docs/method.md from `data/samples`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.grid import OccupancyGrid, crop_to_known
from mapfusion.pairwise.poses import Poses, differ, moved
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.rough import Hypotheses
from mapfusion.pairwise.search import DISTINCT_DEGREES, Candidate, distinct_cells, examine, propose, refine_and_rank
from mapfusion.pairwise.voting import match
from mapfusion.pipeline import replay
from mapfusion.steps import Event, FusionStep, GridEvent
from mapfusion_io.mission import open_recording

ROOT = Path(__file__).resolve().parents[1]
COLOURS = ((200, 90, 30), (40, 130, 40), (50, 50, 210), (160, 60, 160))
"""BGR, by robot."""
Image = npt.NDArray[np.uint8]


def main() -> None:
    """Writes docs/images/*.png."""
    own, last = replayed(ROOT / "data" / "samples" / "three_robots.mcap")
    save("merged", merged_picture(own, last))
    for name, image in method_pictures(own["robot1"], own["robot2"]).items():
        save(name, image)


def save(name: str, image: Image) -> None:
    """Writes a picture with few colours, small."""
    cv2.imwrite(str(ROOT / "docs" / "images" / f"{name}.png"), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def merged_picture(own: Mapping[str, OccupancyGrid], last: FusionStep) -> Image:
    """The robots' own maps above, the merged map with their paths below."""
    merged = crop_to_known(last.maps[1], 4)
    fused = picture(merged, 2)
    for colour, path in zip(COLOURS, last.paths.values(), strict=False):
        points = pixels(merged, path.poses[:, :2], 2)
        cv2.polylines(fused, [points.reshape(-1, 1, 2)], False, colour, 2, cv2.LINE_AA, shift=3)
        cv2.circle(fused, (int(points[-1, 0]), int(points[-1, 1])), 5 << 3, colour, -1, cv2.LINE_AA, shift=3)
    row = beside(
        [titled(picture(crop_to_known(own[robot], 4), 1), robot, COLOURS[i]) for i, robot in enumerate(last.paths)]
    )
    return stacked([row, titled(fused, "merged, in frame world")])


def method_pictures(target_grid: OccupancyGrid, source_grid: OccupancyGrid) -> dict[str, Image]:
    """The stages of the default profile on one pair of maps."""
    resolution_m = max(target_grid.resolution_m, source_grid.resolution_m)
    target, source = prepare(target_grid, resolution_m), prepare(source_grid, resolution_m)
    matches = match(target.features, source.features)
    hypotheses = propose(target, source, matches)
    found = examine(target, source, hypotheses, matches)
    rims = [titled(rim_picture(one), name) for one, name in ((target, "robot1"), (source, "robot2"))]
    apart = is_apart(target, source, found.best.pose, hypotheses.poses)
    elsewhere = Hypotheses(hypotheses.poses[apart], hypotheses.scores[apart])
    others = refine_and_rank(target, source, elsewhere, matches)
    wrong = next(one for one in others if is_apart(target, source, found.best.pose, one.pose[None])[0])
    overlays = [
        titled(overlay(target, source, one.pose), f"{name}: evidence {one.figures['net']:.0f}, {walls(one)}")
        for name, one in (("best", found.best), ("elsewhere", wrong))
    ]
    votes = titled(
        hypotheses_picture(target, source, hypotheses.poses, found.best.pose), f"{len(hypotheses)} hypotheses"
    )
    return {"method_rim": beside(rims), "method_hypotheses": votes, "method_evidence": beside(overlays)}


def is_apart(target: PreparedMap, source: PreparedMap, best: Poses, others: Poses) -> npt.NDArray[np.bool_]:
    """Which poses are answers of their own."""
    return differ(best[None], others, source.centre, distinct_cells(target, source), DISTINCT_DEGREES)[0]


def walls(one: Candidate) -> str:
    """What the closer look found of a candidate, in short."""
    return (
        f"{one.figures['lines']:.0f} walls, {one.figures['crossing_cells']:.0f} cells across, "
        f"{one.figures['inliers_wide']:.0f} keypoints"
    )


def rim_picture(one: PreparedMap) -> Image:
    """A map with the rim of its walls, coloured by the side from which it was seen, and its keypoints."""
    image = picture(one.grid, 1)
    if one.field is not None:
        hue = (np.degrees(np.arctan2(one.field.surface.normals[:, 1], one.field.surface.normals[:, 0])) % 360) / 2
        hsv = np.stack([hue, np.full_like(hue, 255), np.full_like(hue, 220)], axis=-1).astype(np.uint8)[None]
        cols, rows = one.field.surface.points.astype(int).T
        image[one.grid.height - 1 - rows, cols] = cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0]
    for x, y in one.features.points:
        cv2.circle(image, (round(float(x)), one.grid.height - 1 - round(float(y))), 3, (0, 140, 255), 1, cv2.LINE_AA)
    return image


def hypotheses_picture(target: PreparedMap, source: PreparedMap, hypotheses: Poses, best: Poses) -> Image:
    """Where each hypothesis puts the middle of the source's walls and its heading; the best in red."""
    margin = 120
    image = cv2.copyMakeBorder(
        picture(target.grid, 1), margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=(205, 205, 205)
    )
    for pose, colour, width in [*((one, (180, 120, 60), 1) for one in hypotheses), (best, (40, 40, 220), 3)]:
        ends = moved(pose[None], np.stack([source.centre, source.centre + np.array([25.0, 0.0])]).astype(np.float32))[
            0
        ].T
        (x0, y0), (x1, y1) = (
            (round(float(x)) + margin, target.grid.height - round(float(y)) + margin) for x, y in ends
        )
        cv2.arrowedLine(image, (x0, y0), (x1, y1), colour, width, cv2.LINE_AA, tipLength=0.3)
    return image  # type: ignore[return-value]


def overlay(target: PreparedMap, source: PreparedMap, pose: Poses) -> Image:
    """The target's walls in black and the source's, moved by a pose, in red."""
    assert target.field is not None
    assert source.field is not None
    there = moved(pose[None], source.field.surface.points)[0].T
    both = np.concatenate([target.field.surface.points, there])
    low = np.floor(both.min(axis=0)) - 4
    width, height = (int(v) for v in np.ceil(both.max(axis=0) - low) + 4)
    image = np.full((height, width, 3), 255, np.uint8)
    for points, colour in ((target.field.surface.points, (0, 0, 0)), (there, (40, 40, 220))):
        cols, rows = (points - low).astype(int).T
        image[height - 1 - rows, cols] = colour
    return image


def replayed(path: Path) -> tuple[dict[str, OccupancyGrid], FusionStep]:
    """Each robot's newest map and the last step of a mission."""
    mission, own = open_recording([path]), {}

    def noted() -> Iterator[Event]:
        for event in mission.events():
            if isinstance(event, GridEvent):
                own[event.robot] = event.grid
            yield event

    *_, last = replay(noted())
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
