"""Made-up places that repeat themselves: halls of racks, corridors of rooms that are all alike, and mazes.

Nothing of them is symmetric as a whole: racks and rooms stand nearer to one end, doors are anywhere. In a maze every
wall has its like, but no two parts of it are alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import numpy as np
from fit_verdict import RESOLUTION_M, Pair, views, with_noise

from mapfusion.grid import Cells, OccupancyGrid
from mapfusion.simulation.plan import PLAN_RESOLUTION_M, FloorPlan
from mapfusion.transform import SE2

EDGE_CELLS = 20
WALL_CELLS = 2
VIEWS_OF_PLACE = 3
MAX_THINGS, MAX_NEW_THINGS = 20, 8
CLEARANCE_M, NUM_PLACES = 0.5, 30


def repeating_views(kind: str, number: int, rng: np.random.Generator) -> Iterator[Pair]:
    """Views of `number` places, with and without overlap, as a robot sees them and another one later, with noise."""
    for k in range(number):
        place = PLACES[kind](rng)
        pair = Pair(kind, f"{kind} {k}", _grid(place), _grid(_with_things(place, MAX_NEW_THINGS, rng)), SE2.identity())
        for view in views(pair, [pair], VIEWS_OF_PLACE, rng):
            noisy = with_noise(view, rng)
            yield Pair(f"{kind}: {noisy.kind}", noisy.place, noisy.a, noisy.b, noisy.T_a_b)


def plan_of(kind: str, rng: np.random.Generator) -> FloorPlan:
    """A place as a floor plan for a mission, with some points in the open to drive to."""
    while True:
        occupied = PLACES[kind](rng) != 0
        free = np.logical_not(occupied).astype(np.uint8)
        clearance_m = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * np.float32(PLAN_RESOLUTION_M)
        rows, cols = np.nonzero(clearance_m > CLEARANCE_M)
        if len(rows) >= NUM_PLACES:  # not in every maze a robot can turn
            break
    chosen = rng.choice(len(rows), NUM_PLACES, replace=False)
    places_m = (np.stack([cols[chosen], rows[chosen]], axis=-1) + 0.5) * PLAN_RESOLUTION_M
    return FloorPlan(occupied, np.asarray(clearance_m, np.float32), places_m)


def hall_of_racks(rng: np.random.Generator) -> Cells:
    """A hall with rows of racks, solid or on posts, a few of them missing, and pallets between them."""
    num_x, num_y = int(rng.integers(3, 9)), int(rng.integers(2, 5))
    aisle, depth, length, cross = (_cells(rng.uniform(*metres)) for metres in ((1.5, 3.5), (0.8, 2.2), (4, 10), (2, 4)))
    before_x, after_x, before_y, after_y = (_cells(rng.uniform(1.0, 8.0)) for _ in range(4))
    hall = _room(
        before_y + num_y * (length + cross) - cross + after_y, before_x + num_x * (depth + aisle) - aisle + after_x
    )
    _open_doors(hall, int(rng.integers(2, 7)), rng)
    is_solid = rng.random() < 0.5
    for row in range(num_y):
        for column in range(num_x):
            if rng.random() < 0.06:
                continue
            top = EDGE_CELLS + before_y + row * (length + cross)
            left = EDGE_CELLS + before_x + column * (depth + aisle)
            rack = hall[top : top + length, left : left + depth]
            if is_solid:
                _box(rack)
            else:
                for post in range(0, length - 2, _cells(1.35)):
                    rack[post : post + 3, :3] = rack[post : post + 3, -3:] = 100
    return _with_things(hall, MAX_THINGS, rng)


def corridor_of_rooms(rng: np.random.Generator) -> Cells:
    """A corridor with rooms of one plan on one side or on both, and a thing or two in some of them."""
    number = int(rng.integers(4, 11))
    width, depth, corridor, door = (_cells(rng.uniform(*m)) for m in ((2.5, 5), (3, 7), (1.6, 3), (0.8, 1.2)))
    before, after = (_cells(rng.uniform(0.5, 6.0)) for _ in range(2))
    is_on_both = rng.random() < 0.6
    block = depth + WALL_CELLS
    house = _room(corridor + (2 if is_on_both else 1) * block, before + number * width + after)
    at_door = int(rng.integers(6, width - door - 6))
    inside = house[EDGE_CELLS:-EDGE_CELLS, EDGE_CELLS:-EDGE_CELLS]
    for row, side in ((depth, slice(0, depth)), (depth + corridor, slice(depth + corridor, None)))[: 1 + is_on_both]:
        inside[row : row + WALL_CELLS, :] = 100
        for k in range(number + 1):
            left = before + k * width
            inside[side, left : left + WALL_CELLS] = 100
            if k < number and rng.random() > 0.1:
                inside[row : row + WALL_CELLS, left + at_door : left + at_door + door] = 0
    _open_doors(house, int(rng.integers(1, 4)), rng)
    return _with_things(house, MAX_THINGS, rng)


def maze(rng: np.random.Generator) -> Cells:
    """A maze on a square lattice, with some more passages than it needs, and a few things."""
    num_y, num_x = (int(n) for n in rng.integers(5, 13, 2))
    pitch = _cells(rng.uniform(0.8, 2.5))
    whole = _room(num_y * pitch + WALL_CELLS, num_x * pitch + WALL_CELLS)
    inside = whole[EDGE_CELLS:-EDGE_CELLS, EDGE_CELLS:-EDGE_CELLS]
    for at in range(0, inside.shape[0], pitch):
        inside[at : at + WALL_CELLS] = 100
    for at in range(0, inside.shape[1], pitch):
        inside[:, at : at + WALL_CELLS] = 100

    def open_between(one: tuple[int, int], other: tuple[int, int]) -> None:
        (row, col), (_, other_col) = min(one, other), max(one, other)
        top, left = row * pitch + WALL_CELLS, col * pitch + WALL_CELLS
        if other_col > col:
            inside[top : top + pitch - WALL_CELLS, left : left + pitch] = 0
        else:
            inside[top : top + pitch, left : left + pitch - WALL_CELLS] = 0

    path, seen = [(0, 0)], {(0, 0)}
    while path:
        row, col = path[-1]
        beside = [(row + 1, col), (row - 1, col), (row, col + 1), (row, col - 1)]
        free = [at for at in beside if 0 <= at[0] < num_y and 0 <= at[1] < num_x and at not in seen]
        if not free:
            path.pop()
            continue
        ahead = free[int(rng.integers(len(free)))]
        open_between(path[-1], ahead)
        seen.add(ahead)
        path.append(ahead)
    for _ in range(int(num_y * num_x * rng.uniform(0.0, 0.25))):
        row, col = int(rng.integers(num_y - 1)), int(rng.integers(num_x - 1))
        open_between((row, col), (row, col + 1) if rng.random() < 0.5 else (row + 1, col))
    return _with_things(whole, MAX_NEW_THINGS, rng)


PLACES: dict[str, Callable[[np.random.Generator], Cells]] = {
    "racks": hall_of_racks,
    "rooms": corridor_of_rooms,
    "mazes": maze,
}


def _cells(metres: float) -> int:
    return round(metres / RESOLUTION_M)


def _grid(cells: Cells) -> OccupancyGrid:
    return OccupancyGrid(cells, RESOLUTION_M, SE2.identity(), "map", 0)


def _room(height: int, width: int) -> Cells:
    """An empty room with its walls, nothing known around it."""
    cells: Cells = np.full((height + 2 * EDGE_CELLS, width + 2 * EDGE_CELLS), -1, np.int8)
    _box(cells[EDGE_CELLS:-EDGE_CELLS, EDGE_CELLS:-EDGE_CELLS], inside=0)
    return cells


def _box(cells: Cells, inside: int = -1) -> None:
    cells[:] = 100
    cells[WALL_CELLS:-WALL_CELLS, WALL_CELLS:-WALL_CELLS] = inside


def _open_doors(cells: Cells, number: int, rng: np.random.Generator) -> None:
    """Doors in the outer walls."""
    for _ in range(number):
        turned = cells if rng.random() < 0.5 else cells.T
        size = _cells(rng.uniform(1.0, 3.0))
        at = int(rng.integers(EDGE_CELLS, turned.shape[1] - EDGE_CELLS - size))
        wall = (
            turned[EDGE_CELLS : EDGE_CELLS + WALL_CELLS]
            if rng.random() < 0.5
            else turned[-EDGE_CELLS - WALL_CELLS : -EDGE_CELLS]
        )
        wall[:, at : at + size] = 0


def _with_things(cells: Cells, most: int, rng: np.random.Generator) -> Cells:
    """Up to `most` boxes more, where it is free."""
    result = cells.copy()
    for _ in range(int(rng.integers(most + 1))):
        height, width = (int(n) for n in rng.integers(8, 28, 2))
        top, left = (int(rng.integers(EDGE_CELLS, n - EDGE_CELLS - 28)) for n in cells.shape)
        box = result[top : top + height, left : left + width]
        if (box == 0).all():
            _box(box)
    return result
