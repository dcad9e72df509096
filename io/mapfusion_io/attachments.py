"""Maps and summaries as files: what map_server reads, and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mapfusion.grid import OccupancyGrid

_OCCUPIED_GREY, _FREE_GREY, _UNKNOWN_GREY = 0, 254, 205


def trinary_pgm(grid: OccupancyGrid) -> bytes:
    """The map as binary PGM, row 0 at the top: walls 0, free cells 254, unknown and undecided ones 205.

    Source: map_saver of ROS's map_server.
    """
    image = np.full(grid.cells.shape, _UNKNOWN_GREY, dtype=np.uint8)
    image[grid.free] = _FREE_GREY
    image[grid.walls] = _OCCUPIED_GREY
    return b"P5\n%d %d\n255\n" % (grid.width, grid.height) + image[::-1].tobytes()


def map_yaml(grid: OccupancyGrid, image_name: str) -> bytes:
    """The description map_server wants beside the image of `trinary_pgm`.

    `free_thresh` is 0.196 and no more: grey 205 is an occupancy of 0.19608 and has to stay unknown.
    """
    corner = grid.T_frame_grid
    origin = ", ".join(_decimal(value) for value in (corner.x_m, corner.y_m, corner.yaw_rad))
    return (
        f"image: {image_name}\nmode: trinary\nresolution: {_decimal(grid.resolution_m)}\norigin: [{origin}]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    ).encode()


def summary_json(summary: Mapping[str, object]) -> bytes:
    """Indented JSON with sorted keys; a number that is not finite is null.

    Raises:
        TypeError: A value that JSON does not know.
    """
    text = json.dumps(_plain(summary), indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"
    return text.encode(errors="backslashreplace")  # a file name that is no UTF-8 becomes JSON escapes


def _decimal(value: float) -> str:
    """Without exponent: YAML 1.1 takes 1e-07 for a text."""
    return np.format_float_positional(value + 0.0, precision=9, trim="0")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
