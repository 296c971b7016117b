"""Poses as a particle filter gives them, late and with a stated covariance, from stated errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.simulate.points.motion import PointMotion
from polemap.simulate.sensors import gauss_markov
from polemap.vehicle.pose import pose_rotation, wrap_angle

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PointPose:
    """A pose `(3,)` of the rear axle with covariance `(3, 3)` in east, north and yaw."""

    stamp_s: float
    arrival_s: float
    pose: Floats
    covariance: Floats

    def later(self, by_s: float) -> PointPose:
        """The same at another time."""
        return replace(self, stamp_s=self.stamp_s + by_s, arrival_s=self.arrival_s + by_s)


@dataclass(frozen=True, slots=True)
class PoseSource:
    """How often, how late and how well poses are given.

    Attributes:
        along_m, across_m, yaw_rad: sd in the vehicle's frame.
        correlation_s: above 0, successive poses share their error for so long.
        latency_s, jitter_s: from stamp to arrival, and the mean of an exponential part on top.
    """

    rate_hz: float = 22.0
    along_m: float = 0.08
    across_m: float = 0.06
    yaw_rad: float = 0.005
    correlation_s: float = 0.0
    latency_s: float = 0.11
    jitter_s: float = 0.0

    def poses(self, motion: PointMotion, rng: np.random.Generator) -> tuple[PointPose, ...]:
        """The poses of a motion, by stamp."""
        stamps = np.arange(motion.stamp_s[0] + 0.013, motion.stamp_s[-1], 1.0 / self.rate_hz)
        sd = np.array([self.along_m, self.across_m, self.yaw_rad])
        if self.correlation_s > 0.0:
            unit = gauss_markov(stamps, 1.0, self.correlation_s, rng, 3)
        else:
            unit = rng.standard_normal((len(stamps), 3))
        late = np.full(len(stamps), self.latency_s)
        if self.jitter_s > 0.0:
            late += rng.exponential(self.jitter_s, len(stamps))
        poses = []
        for t, arrival, true, e in zip(
            stamps, stamps + late, motion.at(stamps), unit * sd, strict=True
        ):
            turn = pose_rotation(true[2])
            pose = true + turn @ e
            pose[2] = wrap_angle(pose[2])
            poses.append(PointPose(float(t), float(arrival), pose, turn @ np.diag(sd**2) @ turn.T))
        return tuple(poses)
