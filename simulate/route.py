"""The road's centre line and cross-section: where things are along a street."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.drivelog.errors import ConfigError
from polemap.vehicle.pose import move_reference_point, rotate

Floats = NDArray[np.float64]
_STEP_M = 0.25


@dataclass(frozen=True, slots=True)
class Route:
    """A smooth centre line, sampled every 0.25 m of arc length.

    Attributes:
        closed: the end leads back into the start.
        station_m: `(n,)`.
        points_m: `(n, 2)` east, north in the world's local metres.
        yaw_rad: `(n,)` unwrapped heading of the centre line.
        curvature_1pm: `(n,)`, positive to the left.
    """

    closed: bool
    station_m: Floats
    points_m: Floats
    yaw_rad: Floats
    curvature_1pm: Floats

    @property
    def length_m(self) -> float:
        """Length of a lap, or of the street from end to end."""
        return float(self.station_m[-1]) + (_STEP_M if self.closed else 0.0)

    def _wrapped(self, station_m: Floats) -> Floats:
        s = np.asarray(station_m, dtype=np.float64)
        return np.mod(s, self.length_m) if self.closed else np.clip(s, 0.0, self.length_m)

    def at(self, station_m: Floats, lateral_m: Floats | float = 0.0) -> Floats:
        """Poses `(..., 3)` (x, y, heading of the centre line) `lateral_m` to the left of it."""
        s = self._wrapped(station_m)
        station, points, yaw = self.station_m, self.points_m, self.yaw_rad
        if self.closed:
            station = np.append(station, self.length_m)
            points = np.vstack([points, points[:1]])
            turns = np.round((yaw[-1] - yaw[0]) / (2 * np.pi)) * 2 * np.pi
            yaw = np.append(yaw, yaw[0] + turns)
        x = np.interp(s, station, points[:, 0])
        y = np.interp(s, station, points[:, 1])
        heading = np.interp(s, station, yaw)
        middle = np.stack(np.broadcast_arrays(x, y, heading, lateral_m)[:3], axis=-1)
        return move_reference_point(middle, 0.0, lateral_m)

    def curvature_at(self, station_m: Floats) -> Floats:
        """Curvature of the centre line, 1/m."""
        s = self._wrapped(station_m)
        period = self.length_m if self.closed else None
        return np.asarray(np.interp(s, self.station_m, self.curvature_1pm, period=period))


def make_route(corners_m: list[tuple[float, float]], radius_m: float, closed: bool) -> Route:
    """Straight legs between corners, joined by arcs, with the curvature smoothed over some metres.

    Raises:
        ConfigError: legs too short for the arcs at their ends.
    """
    corners = np.asarray(corners_m, dtype=np.float64)
    count = len(corners)
    turning = range(count) if closed else range(1, count - 1)
    trims = np.zeros(count)
    for i in turning:
        a = corners[i] - corners[i - 1]
        b = corners[(i + 1) % count] - corners[i]
        turn = np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)
        trims[i] = radius_m * np.tan(abs(turn) / 2)
    pieces = [] if closed else [corners[:1]]
    for i in turning:
        before, after = corners[i - 1], corners[(i + 1) % count]
        for other, j in ((before, i - 1), (after, (i + 1) % count)):
            leg = float(np.hypot(*(corners[i] - other)))
            if trims[i] + trims[j] > leg:
                raise ConfigError(
                    f"route: the leg of {leg:.1f} m at corner {i} is too short for arcs of "
                    f"{radius_m:g} m; lengthen it or reduce corner_radius_m"
                )
        pieces.append(_arc(before, corners[i], after, radius_m, trims[i]))
    if not closed:
        pieces.append(corners[-1:])
    if closed:
        # begin in the middle of the first leg
        pieces = [(corners[:1] + corners[1:2]) / 2, *pieces[1:], pieces[0]]
    path = np.concatenate(pieces)
    return _resample(np.vstack([path, path[:1]]) if closed else path, closed)


def _arc(before: Floats, corner: Floats, after: Floats, radius_m: float, trim_m: float) -> Floats:
    a = (corner - before) / np.hypot(*(corner - before))
    b = (after - corner) / np.hypot(*(after - corner))
    turn = float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))
    start = corner - trim_m * a
    angles = np.linspace(0.0, turn, max(3, int(abs(turn) * radius_m / 0.2)))
    side = 1.0 if turn > 0 else -1.0
    left = np.array([-a[1], a[0]]) * side
    centre = start + radius_m * left
    return np.asarray(centre + rotate(-left * radius_m, angles))


def _resample(path: Floats, closed: bool) -> Route:
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    count = max(16, round(length[-1] / _STEP_M))
    station = np.linspace(0.0, length[-1], count, endpoint=not closed)
    raw = np.stack([np.interp(station, length, path[:, k]) for k in (0, 1)], axis=1)
    mode: Literal["wrap", "nearest"] = "wrap" if closed else "nearest"
    smooth = scipy.ndimage.gaussian_filter1d(raw, 2.5 / _STEP_M, axis=0, mode=mode)
    if not closed:
        smooth = _keep_ends(raw, smooth)
    # once more at equal steps: smoothing shortens the arcs
    ring = np.vstack([smooth, smooth[:1]]) if closed else smooth
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))])
    total = np.floor(length[-1] / _STEP_M)
    scale = length[-1] / (total * _STEP_M)
    station = np.arange(total + (0 if closed else 1)) * _STEP_M
    points = np.stack([np.interp(station * scale, length, ring[:, k]) for k in (0, 1)], axis=1)
    if closed:
        step = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    else:
        step = np.gradient(points, axis=0)
    yaw = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    if closed:
        change = np.roll(yaw, -1) - np.roll(yaw, 1)
        curvature = (change + np.pi) % (2 * np.pi) - np.pi
        curvature = curvature / (2 * _STEP_M)
    else:
        curvature = np.gradient(yaw, _STEP_M)
    return Route(closed, station, points, yaw, np.asarray(curvature))


def _keep_ends(raw: Floats, smooth: Floats) -> Floats:
    """Gaussian smoothing pulls the ends of an open line inwards; blend back to the line there."""
    n = len(raw)
    reach = min(n // 2, int(10 / _STEP_M))
    weight = np.ones(n)
    ramp = np.linspace(0.0, 1.0, reach)
    weight[:reach] = np.minimum(weight[:reach], ramp)
    weight[-reach:] = np.minimum(weight[-reach:], ramp[::-1])
    return np.asarray(raw + weight[:, None] * (smooth - raw))


@dataclass(frozen=True, slots=True)
class CrossSection:
    """Height over the lateral position, piecewise linear, symmetric parts already spelled out.

    `lateral_m` `(k,)` rising, `height_m` `(k,)`, `surface` names the tile of each of the k - 1
    strips, `repeats_per_m` and `albedo` go with it.
    """

    lateral_m: Floats
    height_m: Floats
    surface: tuple[str, ...]
    repeats_per_m: tuple[float, ...]
    albedo: tuple[float, ...]

    def height_at(self, lateral_m: Floats | float) -> Floats:
        """Ground height `lateral_m` to the left of the centre line."""
        return np.asarray(np.interp(lateral_m, self.lateral_m, self.height_m))

    def slope_at(self, lateral_m: float) -> float:
        """Sideways slope of the road there, rise over run to the left (crossfall)."""
        ahead, behind = self.height_at(lateral_m + 0.8), self.height_at(lateral_m - 0.8)
        return float((ahead - behind) / 1.6)
