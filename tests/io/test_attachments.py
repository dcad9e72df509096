"""Maps as map_server has them, and JSON that is the same every time."""

from __future__ import annotations

import json
import math

import cv2
import numpy as np
import pytest

from mapfusion.grid import OccupancyGrid
from mapfusion.transform import SE2
from mapfusion_io.attachments import map_yaml, summary_json, trinary_pgm


def make_grid(cells: list[list[int]], resolution_m: float = 0.05, corner: SE2 | None = None) -> OccupancyGrid:
    return OccupancyGrid(np.array(cells, dtype=np.int8), resolution_m, corner or SE2.identity())


def test_pgm_has_row_0_at_the_bottom_and_three_greys() -> None:
    data = trinary_pgm(make_grid([[0, 25, 26], [64, 65, 100], [-1, -1, 0]]))
    assert data.startswith(b"P5\n3 3\n255\n")
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    np.testing.assert_array_equal(image, [[205, 205, 254], [205, 0, 0], [254, 254, 205]])


def test_map_server_reads_back_what_was_meant() -> None:
    yaml = dict(line.split(": ", 1) for line in map_yaml(make_grid([[0]]), "map.pgm").decode().splitlines())
    occupied, free = float(yaml["occupied_thresh"]), float(yaml["free_thresh"])
    occupancy = {grey: (255 - grey) / 255 for grey in (0, 205, 254)}  # negate: 0
    assert yaml["negate"] == "0"
    assert occupancy[0] > occupied
    assert free < occupancy[205] < occupied
    assert occupancy[254] < free


def test_yaml_names_image_cell_size_and_corner() -> None:
    yaml = map_yaml(make_grid([[0]], 0.05, SE2(-12.3456789, 1e-7, math.pi / 2)), "map.pgm").decode()
    assert "image: map.pgm\n" in yaml
    assert "mode: trinary\n" in yaml
    assert "resolution: 0.05\n" in yaml
    assert "origin: [-12.3456789, 0.0000001, 1.570796327]\n" in yaml


def test_yaml_has_no_minus_zero() -> None:
    assert "origin: [0.0, 0.0, 0.0]" in map_yaml(make_grid([[0]], 1.0, SE2(-0.0, 0.0, -0.0)), "map.pgm").decode()


def test_summary_is_sorted_plain_json() -> None:
    summary = {
        "b": math.nan,
        "a": [np.float64(0.5), np.int64(3), np.array([1.0, np.inf]), (True, None)],
        "Ü": {2: "x", "bad\udcff": 1},
    }
    text = summary_json(summary)
    assert text.endswith(b"\n")
    assert json.loads(text) == {"a": [0.5, 3, [1.0, None], [True, None]], "b": None, "Ü": {"2": "x", "bad\udcff": 1}}
    assert text.index(b'"a"') < text.index(b'"b"')
    assert text == summary_json(dict(reversed(summary.items())))


def test_summary_refuses_what_json_does_not_know() -> None:
    with pytest.raises(TypeError):
        summary_json({"grid": make_grid([[0]])})
