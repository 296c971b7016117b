"""Markings, kerbs and corners of a simulated world, as its ground and its houses are made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.simulate.ground import kerb_m, marking_lines
from polemap.simulate.street_lines import Corners, StreetLine, StreetTruth
from polemap.simulate.world import World
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

_STEP_M = 0.5
_PERIOD_M, _DASH_M = 9.0, 3.0  # of dashed markings, as `simulate.ground` paints them
_KERB_TOP_M = 0.02


def world_truth(world: World) -> StreetTruth:
    """Lines and corners in the world's local metres; kerbs leave the mouths of side streets."""
    spec, route = world.scenario.section, world.route
    station = np.arange(0.0, route.length_m, _STEP_M)
    everywhere = np.ones(len(station), dtype=np.bool_)
    lines = []
    for lateral in marking_lines(spec):
        edge = spec.edge_line and abs(lateral) > spec.road_half_width_m - 0.4
        solid = edge or (lateral == 0.0 and spec.centre_line == "solid")
        style = LineStyle.SOLID if solid else LineStyle.DASHED
        seen = everywhere if solid else np.mod(station, _PERIOD_M) <= _DASH_M
        points = route.at(station, lateral)[:, :2]
        lines.append(StreetLine(LandmarkKind.LANE_MARKING, style, points, seen))
    for side in (1.0, -1.0):
        if spec.kerb_height_m < 0.03:
            break
        seen = everywhere.copy()
        for street in world.scenario.side_streets:
            if (street.side == "left") == (side > 0):
                seen &= np.abs(station - street.at_m) > street.width_m / 2
        points = route.at(station, side * (kerb_m(spec) + _KERB_TOP_M))[:, :2]
        lines.append(StreetLine(LandmarkKind.KERB, LineStyle.UNKNOWN, points, seen))
    return StreetTruth(tuple(lines), _corners(world))


def _corners(world: World) -> Corners:
    fronts = world.fronts
    middle = np.stack([fronts.x_m, fronts.y_m], axis=1)
    along = np.stack([np.cos(fronts.yaw_rad), np.sin(fronts.yaw_rad)], axis=1)
    half = 0.5 * fronts.width_m[:, None] * along
    points = np.concatenate([middle - half, middle + half])
    facing = np.concatenate([fronts.yaw_rad + np.pi, fronts.yaw_rad])
    return Corners(points, np.asarray(wrap_angle(facing)))
