"""Path following by the Stanley law, on any pose that an estimator hands over."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.errors import VehicleError
from polemap.vehicle.packed import transform_point
from polemap.vehicle.pose import Pose2D, rotate_back, wrap_angle

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PathError:
    """Where a point stands beside a path: left of it is positive."""

    station_m: float
    lateral_m: float
    heading_rad: float
    curvature_radpm: float


class Path:
    """A smooth curve through points `(n, 2)`, at least three, open or closed.

    Raises:
        VehicleError: fewer than three points, repeated points or coordinates that are not finite.
    """

    def __init__(self, points_m: Floats, *, closed: bool = False) -> None:
        points = np.asarray(points_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
            raise VehicleError(f"a path needs at least 3 points (n, 2), got {points.shape}")
        if closed:
            points = np.vstack([points, points[:1]])
        steps = np.hypot(*np.diff(points, axis=0).T)
        if not (steps > 0).all():
            raise VehicleError("a path must not repeat a point nor hold one that is not finite")
        self.closed = closed
        self.points_m = points
        self.station_m = np.concatenate([[0.0], np.cumsum(steps)])
        self._yaw = self._headings()
        self._curvature = np.gradient(np.unwrap(self._yaw), self.station_m)

    @property
    def length_m(self) -> float:
        """Length of the polyline."""
        return float(self.station_m[-1])

    def curvature_radpm(self, station_m: Floats) -> Floats:
        """Curvature at stations `(n,)`, left turns positive."""
        return np.asarray(np.interp(station_m, self.station_m, self._curvature))

    def locate(
        self, x_m: float, y_m: float, yaw_rad: float, near_m: float | None = None
    ) -> PathError:
        """The nearest foot point; `near_m` keeps the search within 20 m of a known station."""
        start, end = self.points_m[:-1], self.points_m[1:]
        along = end - start
        offset = np.array([x_m, y_m]) - start
        length2 = (along**2).sum(axis=1)
        share = np.clip((offset * along).sum(axis=1) / length2, 0.0, 1.0)
        distance = np.hypot(*(offset - share[:, None] * along).T)
        if near_m is not None:
            gap = np.abs(self.station_m[:-1] - near_m)
            if self.closed:
                gap = np.minimum(gap, self.length_m - gap)
            distance = np.where(gap <= 20.0, distance, np.inf)
        i = int(np.argmin(distance))
        t = float(share[i])
        turn = float(wrap_angle(self._yaw[i + 1] - self._yaw[i]))
        heading = float(wrap_angle(self._yaw[i] + t * turn))
        aside = rotate_back(np.array([x_m, y_m]) - (start[i] + t * along[i]), heading)
        lateral = float(aside[1])
        return PathError(
            float(self.station_m[i] + t * np.sqrt(length2[i])),
            lateral,
            float(wrap_angle(yaw_rad - heading)),
            float((1 - t) * self._curvature[i] + t * self._curvature[i + 1]),
        )

    def _headings(self) -> Floats:
        """Heading at every point, from its two neighbours."""
        p = self.points_m
        ahead = np.vstack([p[1:], p[1:2] if self.closed else 2 * p[-1:] - p[-2:-1]])
        behind = np.vstack([p[-2:-1] if self.closed else 2 * p[:1] - p[1:2], p[:-1]])
        return np.asarray(np.arctan2(*(ahead - behind).T[::-1]))


@dataclass(frozen=True, slots=True)
class StanleySettings:
    """Gains of the law.

    Attributes:
        gain_per_s: k, of the cross-track error.
        softening_mps: k_soft, keeps the cross-track term mild when slow.
        yaw_damping_s: k_d, on the yaw rate beyond the path's.
        front_slip_rad_per_mps2: k_ag, slip of the front tyres per lateral acceleration,
            m lr / (2 Cf l); without it a bend is driven on its outer side.
        steer_limit_rad: of the road wheels.
    """

    gain_per_s: float = 1.5
    softening_mps: float = 1.0
    yaw_damping_s: float = 0.05
    front_slip_rad_per_mps2: float = 0.0
    steer_limit_rad: float = 0.5


def stanley_steer(
    path: Path,
    rear_pose: Pose2D,
    speed_mps: float,
    yaw_rate_radps: float,
    wheelbase_m: float,
    settings: StanleySettings,
    near_m: float | None = None,
) -> tuple[float, PathError]:
    """Road-wheel angle that leads the front axle onto the path, and the front axle's error.

    delta = -heading error - atan(k e / (k_soft + v)) + k_ag v^2 kappa - k_d (yaw rate - v kappa),
    all at the front axle.

    Source: Hoffmann, Tomlin, Montemerlo, Thrun, Autonomous automobile trajectory tracking for
    off-road driving, ACC 2007, (9)-(12).
    """
    front_x, front_y = transform_point(rear_pose, wheelbase_m, 0.0)
    error = path.locate(front_x, front_y, rear_pose.yaw_rad, near_m)
    # steering towards the path's heading at the front axle holds the curvature by itself: the
    # front wheel of a car on a circle stands along the circle's tangent there
    steer = -error.heading_rad
    steer -= atan2(settings.gain_per_s * error.lateral_m, settings.softening_mps + abs(speed_mps))
    steer += settings.front_slip_rad_per_mps2 * speed_mps**2 * error.curvature_radpm
    steer -= settings.yaw_damping_s * (yaw_rate_radps - speed_mps * error.curvature_radpm)
    limit = settings.steer_limit_rad
    return max(-limit, min(limit, steer)), error
