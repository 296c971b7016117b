"""Cities of poles, drawn in seconds, and what a car sees of them: for search and maps of any size.

    python -m benchmarks.localize.cities POLES MAP [SEED] [--drive DRIVE] [--start NUMBER]

writes a city's map, and the drive of a car through 150 m of its streets some years later. A city is
a lattice of bent streets. Beside them stand poles with irregular gaps and lamps, or the trees of an
avenue at equal distances; at crossings signals; in some blocks parks, or the lamps of a car park in
a grid. A few quarters were planned: there every street repeats the same pattern, every other one
mirrored, and only what chance made of it differs. Not timed, so `python -m benchmarks` leaves it
out.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.frames import EarthFrame
from polemap.map.io import write_map
from polemap.map.pole_map import PoleMap
from polemap.simulate.points.motion import PointMotion
from polemap.simulate.points.poles import Poles

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

FRAME = EarthFrame("local", name="city")

_BLOCK_M = (60.0, 120.0)  # least and greatest distance of neighbouring streets
_NODE_SD_M = 4.0  # of crossings around the lattice, but in planned quarters
_RUN, _QUARTER = 6, 6  # edges that are built alike in a row; blocks of a quarter, each way
_AVENUES, _PLANNED, _PARKS, _CAR_PARKS = 0.25, 0.03, 0.05, 0.03  # shares
_POLES_PER_EDGE = 14.7  # as measured
_CROSSING_M = 12.0  # free of poles on both sides of a crossing's middle
_GAP_M, _SIDE_M = 14.0, (3.5, 9.0)
_LAMP_GAP_M, _LAMP_SIDE_M, _LAMP_SD_M = 30.0, 4.0, 0.3
_TREE_GAPS_M, _TREE_SIDES_M, _TREE_SD_M, _TREES_MISSING = (
    (8.0, 9.0, 10.0, 12.0),
    (4.5, 7.0),
    0.15,
    0.05,
)
_TEMPLATE_SD_M, _TEMPLATE_MISSING = 0.2, 0.05
_SIGNALS, _SIGNAL_M, _SIGNAL_SD_M = 0.5, 6.5, 1.0
_TREES_PER_M2, _INSIDE_M = 0.006, 11.0
_PARKING_M = (8.0, 16.0)
_WIDTHS_M = (0.08, 0.5)
_LANE_M = 1.5  # right of the middle of the street
_STEP_M = 0.5
_CORNER_M = 12.0


@dataclass(frozen=True, slots=True)
class City:
    """Poles and the streets between them.

    Attributes:
        points_m: `(n, 2)`.
        width_m: `(n,)`.
        nodes_m: `(rows, columns, 2)` the crossings; streets lead to the four neighbours.
    """

    points_m: Floats
    width_m: Floats
    nodes_m: Floats

    def __len__(self) -> int:
        return len(self.points_m)

    def surveyed(self, sd_m: float, seed: int, frame: EarthFrame = FRAME) -> PoleMap:
        """The map that a survey with independent errors of `sd_m` in each axis makes of it."""
        n = len(self)
        error = sd_m * np.random.default_rng([seed, 1]).standard_normal((n, 2))
        return PoleMap(
            frame=frame,
            ids=np.arange(n),
            points_m=self.points_m + error,
            covariance_m2=np.tile(np.eye(2) * sd_m**2, (n, 1, 1)),
            width_m=self.width_m,
            height_m=np.full(n, np.nan),
            observations=np.full(n, 20),
            drives=np.ones(n, dtype=np.int64),
            existence=np.ones(n),
        )


def make_city(
    poles: int,
    seed: int,
    *,
    avenues: float = _AVENUES,
    planned: float = _PLANNED,
    car_parks: float = _CAR_PARKS,
) -> City:
    """A city of about so many poles (within some percent); the same seed, the same city.

    Args:
        avenues: share of stretches of streets that are lined by trees at equal distances.
        planned: share of quarters whose streets all repeat one pattern.
        car_parks: share of blocks that are car parks with lamps in a grid.
    """
    rng = np.random.default_rng([seed, poles])
    side = max(2, round(np.sqrt(poles / (2.0 * _POLES_PER_EDGE))) + 1)
    quarters = -(-side // _QUARTER)
    repeats = rng.random((quarters, quarters)) < planned
    row, column = np.mgrid[:side, :side]
    node_planned = repeats[row // _QUARTER, column // _QUARTER]
    north = np.cumsum(rng.uniform(*_BLOCK_M, side))
    east = np.cumsum(rng.uniform(*_BLOCK_M, side))
    nodes = np.stack([east[column], north[row]], axis=-1)
    nodes += np.where(node_planned[..., None], 0.0, _NODE_SD_M) * rng.standard_normal(nodes.shape)
    parts = [
        _streets(
            nodes[:, :-1], nodes[:, 1:], row[:, :-1], column[:, :-1], node_planned, avenues, rng
        ),
        _streets(nodes[:-1], nodes[1:], column[:-1], row[:-1], node_planned.T, avenues, rng),
        _signals(nodes.reshape(-1, 2), rng),
        *_blocks(nodes, car_parks, rng),
    ]
    points = np.concatenate(parts)
    width = rng.uniform(*_WIDTHS_M, len(points))
    order = np.lexsort((points[:, 0], points[:, 1]))  # as maps are: from south to north
    return City(points[order], width[order], nodes)


def _streets(
    begin: Floats, end: Floats, line: Whole, place: Whole, planned: NDArray[np.bool_],
    avenues: float, rng: np.random.Generator,
) -> Floats:  # fmt: skip
    """Poles `(n, 2)` beside edges from `begin` to `end` `(..., 2)`.

    Args:
        line, place: of each edge: number of its street, and its own along the street.
        planned: `(lines, places)`, of the crossings.
        avenues: share of their runs.
    """
    begin, end = begin.reshape(-1, 2), end.reshape(-1, 2)
    line, place = line.reshape(-1), place.reshape(-1)
    lines, runs = int(line.max()) + 1, int(place.max()) // _RUN + 1
    run = (line, place // _RUN)
    repeats = planned[line, place]
    avenue = (rng.random((lines, runs)) < avenues)[run] & ~repeats
    tree_gap = rng.choice(_TREE_GAPS_M, (lines, runs))[run]
    tree_side = rng.uniform(*_TREE_SIDES_M, (lines, runs))[run]
    length = np.hypot(*(end - begin).T)
    gap = np.where(avenue, tree_gap, _GAP_M)
    usable = length - 2.0 * _CROSSING_M
    slots = int(usable.max() / min(_TREE_GAPS_M)) + 1
    template = rng.uniform(0.0, 1.0, (2, slots, 2))
    parts = []
    for sign in (-1, 1):
        count = np.maximum(np.floor(usable / gap).astype(np.int64) + 1, 0)
        edge = np.repeat(np.arange(len(count)), count)
        slot = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
        draw = rng.uniform(0.0, 1.0, (len(edge), 2))
        # every other planned street is the mirror image
        side = np.where(place[edge] % 2 == 1, sign, -sign) > 0
        same = repeats[edge]
        draw[same] = template[side[same].astype(np.int64), slot[same]]
        tree = avenue[edge]
        station = _CROSSING_M + slot * gap[edge]
        station += np.where(tree, 0.0, (draw[:, 0] - 0.5) * _GAP_M)
        aside = np.where(tree, tree_side[edge], _SIDE_M[0] + draw[:, 1] * (_SIDE_M[1] - _SIDE_M[0]))
        sd = np.where(tree, _TREE_SD_M, np.where(same, _TEMPLATE_SD_M, 0.0))
        station += sd * rng.standard_normal(len(edge))
        aside += sd * rng.standard_normal(len(edge))
        missing = np.where(tree, _TREES_MISSING, np.where(same, _TEMPLATE_MISSING, 0.0))
        keep = rng.random(len(edge)) >= missing
        parts.append(_beside(begin, end, edge[keep], station[keep], sign * aside[keep]))
    # lamps, in turn on both sides; an avenue has its own between the trees' crowns, not counted
    count = np.where(avenue, 0, np.maximum(np.floor(usable / _LAMP_GAP_M).astype(np.int64), 0))
    edge = np.repeat(np.arange(len(count)), count)
    slot = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    station = _CROSSING_M + (slot + 0.5) * _LAMP_GAP_M
    aside = np.where(slot % 2 == 0, _LAMP_SIDE_M, -_LAMP_SIDE_M)
    error = _LAMP_SD_M * rng.standard_normal((len(edge), 2))
    parts.append(_beside(begin, end, edge, station + error[:, 0], aside + error[:, 1]))
    return np.concatenate(parts)


def _beside(begin: Floats, end: Floats, edge: Whole, station: Floats, aside: Floats) -> Floats:
    """Points `(n, 2)` at a way along their edge and aside of it, left positive."""
    along = end - begin
    along /= np.hypot(*along.T)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return begin[edge] + station[:, None] * along[edge] + aside[:, None] * across[edge]


def _signals(nodes: Floats, rng: np.random.Generator) -> Floats:
    """Poles at the corners of crossings."""
    corner = _SIGNAL_M * np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    points = nodes[:, None] + corner + _SIGNAL_SD_M * rng.standard_normal((len(nodes), 4, 2))
    return np.asarray(points[rng.random((len(nodes), 4)) < _SIGNALS])


def _blocks(nodes: Floats, car_parks: float, rng: np.random.Generator) -> list[Floats]:
    """Trees of parks, and lamps of car parks, inside blocks."""
    south_west = np.maximum(nodes[:-1, :-1], np.stack(
        [nodes[1:, :-1, 0], nodes[:-1, 1:, 1]], axis=-1)) + _INSIDE_M  # fmt: skip
    north_east = np.minimum(nodes[1:, 1:], np.stack(
        [nodes[:-1, 1:, 0], nodes[1:, :-1, 1]], axis=-1)) - _INSIDE_M  # fmt: skip
    low, size = south_west.reshape(-1, 2), (north_east - south_west).reshape(-1, 2)
    what = rng.random(len(low))
    what[(size <= 0.0).any(axis=1)] = 1.0
    park = np.flatnonzero(what < _PARKS)
    count = rng.poisson(_TREES_PER_M2 * np.prod(size[park], axis=1))
    block = np.repeat(park, count)
    trees = low[block] + size[block] * rng.random((len(block), 2))
    parking = np.flatnonzero((what >= _PARKS) & (what < _PARKS + car_parks))
    columns, rows = (np.floor(size[parking] / _PARKING_M).astype(np.int64) + 1).T
    block = np.repeat(np.arange(len(parking)), columns * rows)
    number = np.arange(len(block)) - np.repeat(
        np.cumsum(columns * rows) - columns * rows, columns * rows
    )
    place = np.stack([number % columns[block], number // columns[block]], axis=1)
    lamps = low[parking[block]] + place * np.array(_PARKING_M)
    return [trees, lamps]


def changed(city: City, share: float, rng: np.random.Generator) -> Poles:
    """What stands there some years later: of `share` of the poles half are gone, and as many new.

    The new ones stand within some metres of old ones, beside the street.
    """
    n = len(city)
    gone = rng.random(n) < 0.5 * share
    new = city.points_m[rng.random(n) < 0.5 * share]
    new = new + rng.uniform(-6.0, 6.0, new.shape)
    width = np.concatenate([city.width_m[~gone], rng.uniform(*_WIDTHS_M, len(new))])
    points = np.concatenate([city.points_m[~gone], new])
    return Poles(points, width, np.ones(len(points)))


def route(city: City, length_m: float, rng: np.random.Generator) -> Floats:
    """Poses `(n, 3)` of a way through random streets from a random place, every half metre."""
    rows, columns, _ = city.nodes_m.shape
    at = np.array([rng.integers(rows), rng.integers(columns)])
    step = _turned(np.array([0, 1]), int(rng.integers(4)))
    path, way = [city.nodes_m[tuple(at)]], 0.0
    while way < length_m + 250.0:
        turns = rng.permutation(
            [0, 0, 1, 3]
        )  # straight on, left, right; back where nothing is left
        ahead = next(
            s for s in (*(_turned(step, int(turn)) for turn in turns), -step)
            if 0 <= at[0] + s[0] < rows and 0 <= at[1] + s[1] < columns
        )  # fmt: skip
        at, step = at + ahead, ahead
        way += float(np.hypot(*(city.nodes_m[tuple(at)] - path[-1])))
        path.append(city.nodes_m[tuple(at)])
    line = _resampled(np.array(path))
    width = round(_CORNER_M / _STEP_M) | 1
    kernel = np.ones(width) / width
    smooth = np.stack([np.convolve(line[:, i], kernel, "valid") for i in (0, 1)], axis=1)
    ahead_m = np.gradient(smooth, axis=0)
    right = np.stack([ahead_m[:, 1], -ahead_m[:, 0]], axis=1)
    right /= np.maximum(np.hypot(*right.T), 1e-9)[:, None]
    lane = _resampled(smooth + _LANE_M * right)
    yaw = np.arctan2(*np.gradient(lane, axis=0).T[::-1])
    begin = int(rng.integers(0, round(100.0 / _STEP_M)))
    count = round(length_m / _STEP_M) + 1
    return np.column_stack([lane, yaw])[begin : begin + count]


def _turned(step: Whole, quarters: int) -> Whole:
    for _ in range(quarters):
        step = np.array([-step[1], step[0]])
    return step


def _resampled(line: Floats) -> Floats:
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.arange(0.0, way[-1], _STEP_M)
    return np.stack([np.interp(at, way, line[:, i]) for i in (0, 1)], axis=1)


def motion_along(poses: Floats, speed_mps: float) -> PointMotion:
    """A drive at constant speed along poses `(n, 3)`."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    stamps = way / speed_mps
    yaw = np.unwrap(poses[:, 2])
    # up to the next place, as arcs are driven
    rate = np.append(np.diff(yaw) / np.diff(stamps), 0.0)
    states = np.column_stack([poses[:, :2], yaw, np.full(len(way), speed_mps), rate])
    return PointMotion(stamps, states)


def main() -> int:
    """Write a city's map, and a drive where one is asked for."""
    # imported here: they import this module
    from benchmarks.localize.places import MAP_SD_M, drive_of
    from polemap.drivelog.writers.folder import write_drive

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("poles", type=int)
    parser.add_argument("map", type=Path)
    parser.add_argument("seed", type=int, nargs="?", default=0)
    parser.add_argument("--drive", type=Path)
    parser.add_argument("--start", type=int, default=0)
    asked = parser.parse_args()
    made = make_city(asked.poles, asked.seed)
    write_map(made.surveyed(MAP_SD_M, asked.seed), asked.map)
    if asked.drive is not None:
        write_drive(drive_of(made, asked.start), asked.drive)
    return 0


if __name__ == "__main__":
    sys.exit(main())
