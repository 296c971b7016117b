"""The picture of a found place: the map's poles around it, those seen, and the way driven."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.errors import InputError
from polemap.drivelog.results.signature import CREATOR
from polemap.extras import need
from polemap.localize.place.along import Found
from polemap.map.pattern_index.index import PatternIndex
from polemap.vehicle.pose import transform_points

_AROUND_M = 40.0
_WIDTH_IN = 9.0
# the car, its tip ahead, in its own frame
_ARROW_M = np.array([[4.5, 0.0], [-1.5, 1.8], [0.0, 0.0], [-1.5, -1.8]])


def draw_place(index: PatternIndex, found: Found, path: Path) -> None:
    """Draw the first place of a search, claimed or not.

    Raises:
        InputError: there is none to draw.
    """
    search = found.search
    if search is None or not len(search.poses):
        raise InputError(f"{path}: no place to draw, too few poles were seen twice")
    figure_module = need("matplotlib.figure")
    pose, local = search.poses[0], search.local
    seen = transform_points(pose, local.points_m)
    way = transform_points(pose, local.looks[:, :2])
    low = np.minimum(seen.min(axis=0), way.min(axis=0)) - _AROUND_M
    high = np.maximum(seen.max(axis=0), way.max(axis=0)) + _AROUND_M
    rows = index.within(0.5 * (low + high), 0.5 * float(np.hypot(*(high - low))))
    matched = search.rows[0] >= 0
    size = (high - low) / (high - low).max() * _WIDTH_IN
    figure = figure_module.Figure(figsize=(size[0] + 1.0, size[1] + 1.0), layout="constrained")
    axes = figure.add_subplot()
    axes.plot(*index.points_m[rows].T, ".", color="0.6", markersize=4, label="map")
    axes.plot(*way.T, "-", color="tab:green", label="way driven")
    axes.plot(*seen[matched].T, "o", color="tab:blue", mfc="none", label="seen, on the map's")
    axes.plot(*seen[~matched].T, "x", color="tab:red", label="seen, not in the map")
    axes.fill(*transform_points(pose, _ARROW_M).T, color="black", label="car")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="east, m", ylabel="north, m")
    axes.set_aspect("equal")
    axes.legend(loc="best")
    bound = f", wrong with p < {search.wrong_at_most:.2g}" if found.claimed else ""
    said = "found" if found.claimed else "not claimed"
    axes.set_title(f"{said} after {found.after_m:.0f} m{bound}")
    with atomic_file(path) as part:
        figure.savefig(part, dpi=110, metadata={"Creator": CREATOR})
