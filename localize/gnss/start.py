"""A first pose from GNSS: the heading shows once the car has driven some way."""

from __future__ import annotations

from collections import deque
from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.output_filter.state import PoseUpper
from polemap.vehicle.packed import Pose, ctrv_step, transform_point, wrap
from polemap.vehicle.pose import rigid_fit, transform_points

Floats = NDArray[np.float64]

START_YAW_SD_RAD = 0.3
"""Heading known well enough to start: poses and fixes within it still fit a linear filter."""


class GnssStart:
    """Fits the dead-reckoned path to the fixes along it: position and heading, rigidly.

    Args:
        receiver: where the antenna is.
        yaw_sd_max_rad: how well the heading must be known.
        window: fixes that are kept; older ones have drifted.
    """

    def __init__(
        self, receiver: GnssReceiver, yaw_sd_max_rad: float = START_YAW_SD_RAD, window: int = 40
    ) -> None:
        self._antenna = receiver.antenna_m
        self._yaw_sd_max = yaw_sd_max_rad
        self._pairs: deque[tuple[float, float, float, float, float]] = deque(maxlen=window)
        self._odometry_pose = self._odometry_pose_at_fix = (0.0, 0.0, 0.0)
        self._last: tuple[float, float, float] | None = None

    def add_odometry(self, stamp_s: float, speed_mps: float, yaw_rate_radps: float) -> None:
        """Move the dead-reckoned pose on to the sample; late samples are left out."""
        if self._last is None or stamp_s > self._last[0]:
            self._move_to(stamp_s)
            self._last = (stamp_s, speed_mps, yaw_rate_radps)

    def _move_to(self, stamp_s: float) -> None:
        if self._last is None:
            return
        before, speed, rate = self._last
        dt = stamp_s - before
        if dt > 0.0:
            self._odometry_pose = ctrv_step(self._odometry_pose, speed, rate, dt)
            self._last = (stamp_s, speed, rate)

    def add_fix(self, stamp_s: float, east_m: float, north_m: float, sd_m: float) -> None:
        """Keep a fix and where the odometry was then."""
        if self._last is None:
            return
        self._move_to(stamp_s)
        place = transform_point(self._odometry_pose, *self._antenna)
        self._pairs.append((*place, east_m, north_m, sd_m))
        self._odometry_pose_at_fix = self._odometry_pose

    def pose_at_fix(self) -> tuple[Pose, PoseUpper] | None:
        """Pose and packed covariance at the last fix, once its heading is known."""
        if len(self._pairs) < 3:
            return None
        table = np.array(self._pairs)
        weight = 1.0 / table[:, 4] ** 2
        # a fix far from the others' common motion would turn the path: one pass of reweighting
        for _ in range(3):
            fit = rigid_fit(table[:, :2], table[:, 2:4], weight)
            local = table[:, :2] - weight @ table[:, :2] / weight.sum()
            misfit = np.hypot(*(table[:, 2:4] - transform_points(fit, table[:, :2])).T)
            misfit /= table[:, 4]
            weight = 1.0 / (table[:, 4] ** 2 * (1.0 + (misfit / 3.0) ** 2))
        total = weight.sum()
        lever = float((weight * (local**2).sum(axis=1)).sum())
        yaw_sd = 1.0 / sqrt(lever) if lever > 0.0 else float("inf")
        if yaw_sd > self._yaw_sd_max:
            return None
        centre_local = (weight[:, None] * table[:, :2]).sum(axis=0) / total
        centre_fixed = (weight[:, None] * table[:, 2:4]).sum(axis=0) / total
        x, y, yaw = self._odometry_pose_at_fix
        dx, dy = x - float(centre_local[0]), y - float(centre_local[1])
        turned = float(fit[2])
        centre = (float(centre_fixed[0]), float(centre_fixed[1]), turned)
        pose = (*transform_point(centre, dx, dy), wrap(yaw + turned))
        arm = hypot(dx, dy)
        # errors of neighbouring fixes are alike: the mean is no better than one of them
        position = float(np.median(table[:, 4])) ** 2 + (arm * yaw_sd) ** 2
        return pose, (position, 0.0, 0.0, position, 0.0, yaw_sd**2)
