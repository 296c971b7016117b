"""Cities that repeat themselves in other ways than `cities` has them.

Estates are copied all over, some mirrored, and changed a little; a lattice of streets all alike has
trees at equal distances everywhere; an orchard fills every block with trees in rows. What tells one
place from another there is what chance left out or put elsewhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.localize.cities import City, make_city

Floats = NDArray[np.float64]

_ESTATES, _ESTATE_POLES, _STREET_M = 6, 600, 80.0  # plans; poles of one; width between estates
_MOVED_M, _CHANGED, _NEW_M = 0.2, 0.08, 6.0
_BLOCK_M, _CROSSING_M = 90.0, 12.0
_ROW_GAPS_M, _ROW_SIDE_M, _ROW_SD_M, _ROW_MISSING = (9.0, 10.0, 11.0), 5.0, 0.15, 0.07
_ORCHARD_M, _ORCHARD_SD_M, _ORCHARD_MISSING = 12.0, 0.2, 0.15
_SIDE_LEAST_M = 4.0  # from the middle of a street
_WIDTHS_M, _TREES_M = (0.08, 0.5), (0.2, 0.3)


def estates(poles: int, seed: int) -> City:
    """Some estates of six blocks a side, copied until there are about so many poles.

    Every other copy is mirrored; in each, poles were set to 0.2 m, some are lacking and others new.
    """
    rng = np.random.default_rng([seed, poles, 5])
    plans = [make_city(_ESTATE_POLES, 1000 * seed + number) for number in range(_ESTATES)]
    side = max(2, round(np.sqrt(poles / np.mean([len(plan) for plan in plans]))))
    across = plans[0].nodes_m.shape[0]
    pitch_m = max(float(np.ptp(plan.nodes_m, axis=(0, 1)).max()) for plan in plans) + _STREET_M
    points, widths = [], []
    nodes = np.empty((side * across, side * across, 2))
    for row, column in np.ndindex(side, side):
        plan = plans[rng.integers(_ESTATES)]
        low = plan.nodes_m.min(axis=(0, 1))
        places, crossings = plan.points_m - low, plan.nodes_m - low
        if rng.random() < 0.5:
            east_m = crossings[..., 0].max()
            places = np.array([east_m, 0.0]) + places * np.array([-1.0, 1.0])
            crossings = (np.array([east_m, 0.0]) + crossings * np.array([-1.0, 1.0]))[:, ::-1]
        corner = pitch_m * np.array([column, row])
        keep = rng.random(len(places)) >= _CHANGED
        new = places[rng.random(len(places)) < _CHANGED]
        new = new + rng.uniform(-_NEW_M, _NEW_M, new.shape)
        kept = places[keep] + _MOVED_M * rng.standard_normal((int(keep.sum()), 2))
        points.append(corner + np.concatenate([kept, new]))
        widths.append(np.concatenate([plan.width_m[keep], rng.uniform(*_WIDTHS_M, len(new))]))
        block = np.s_[row * across : (row + 1) * across, column * across : (column + 1) * across]
        nodes[block] = corner + crossings
    return City(np.concatenate(points), np.concatenate(widths), nodes)


def lattice(poles: int, seed: int) -> City:
    """Streets all 90 m apart, trees on both sides of each at one of three equal distances."""
    rng = np.random.default_rng([seed, poles, 6])
    nodes = _crossings(poles, 32.0)
    parts = []
    for begin, turned in ((nodes[:, :-1].reshape(-1, 2), False), (nodes[:-1].reshape(-1, 2), True)):
        gap = rng.choice(_ROW_GAPS_M, len(begin))
        for aside in (-_ROW_SIDE_M, _ROW_SIDE_M):
            count = np.floor((_BLOCK_M - 2.0 * _CROSSING_M) / gap).astype(np.int64) + 1
            edge = np.repeat(np.arange(len(begin)), count)
            slot = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
            place = np.column_stack([_CROSSING_M + slot * gap[edge], np.full(len(edge), aside)])
            place += _ROW_SD_M * rng.standard_normal(place.shape)
            keep = rng.random(len(edge)) >= _ROW_MISSING
            parts.append((begin[edge] + (place[:, ::-1] if turned else place))[keep])
    return _grown(parts, nodes, rng)


def orchard(poles: int, seed: int) -> City:
    """Blocks of 90 m, in each of them trees in rows 12 m apart, of which some are lacking."""
    rng = np.random.default_rng([seed, poles, 7])
    nodes = _crossings(poles, 0.85 * 49.0)
    row_m = np.arange(_SIDE_LEAST_M + 5.0, _BLOCK_M - _SIDE_LEAST_M, _ORCHARD_M)
    trees = np.stack(np.meshgrid(row_m, row_m), axis=-1).reshape(-1, 2)
    places = (nodes[:-1, :-1].reshape(-1, 1, 2) + trees).reshape(-1, 2)
    places += _ORCHARD_SD_M * rng.standard_normal(places.shape)
    return _grown([places[rng.random(len(places)) >= _ORCHARD_MISSING]], nodes, rng)


def _crossings(poles: int, poles_per_block: float) -> Floats:
    """Crossings `(rows, columns, 2)` of streets that are all alike."""
    side = max(2, round(np.sqrt(poles / poles_per_block)) + 1)
    return np.stack(np.meshgrid(*[_BLOCK_M * np.arange(side)] * 2), axis=-1)


def _grown(parts: list[Floats], nodes: Floats, rng: np.random.Generator) -> City:
    points = np.concatenate(parts)
    return City(points, rng.uniform(*_TREES_M, len(points)), nodes)
