"""How a car moves when there is no world to drive in: speed and yaw rate drawn, and the path of it.

Each kind of motion is a small frozen class with `drawn(duration_s, rng)`; all of them share the
integration along arcs and the slip of the rear axle.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.vehicle.motion import move_along_arc
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

RATE_HZ = 500
_START_MPS2 = 1.5


@dataclass(frozen=True, slots=True)
class PointMotion:
    """The true motion of the rear axle.

    Attributes:
        stamp_s: `(n,)` growing.
        states: `(n, 5)` east, north (metres), yaw in [-pi, pi), speed (m/s), yaw rate (rad/s).
    """

    stamp_s: Floats
    states: Floats

    def states_at(self, stamps_s: Floats | float) -> Floats:
        """States `(m, 5)` at the stamps `(m,)`, moved along arcs from the instant before."""
        stamps = np.atleast_1d(np.asarray(stamps_s, dtype=np.float64))
        row = np.clip(np.searchsorted(self.stamp_s, stamps, side="right") - 1, 0, None)
        start, rest = self.states[row], stamps - self.stamp_s[row]
        poses = move_along_arc(start[:, :3], start[:, 3] * rest, start[:, 4] * rest)
        return np.concatenate([poses, start[:, 3:]], axis=1)

    def at(self, stamps_s: Floats | float) -> Floats:
        """Poses `(m, 3)` at the stamps."""
        return self.states_at(stamps_s)[:, :3]

    def value(self, name: str, stamps_s: Floats) -> Floats:
        """Speed, yaw rate or acceleration `(m,)` at the stamps, by name."""
        if name == "acceleration_mps2":
            change = np.gradient(self.states[:, 3], self.stamp_s)
            return np.asarray(np.interp(stamps_s, self.stamp_s, change))
        return self.states_at(stamps_s)[:, {"speed_mps": 3, "yaw_rate_radps": 4}[name]]

    def until(self, end_s: float) -> PointMotion:
        """The part up to a stamp, that one included."""
        rows = self.stamp_s <= end_s + 1e-9
        return PointMotion(self.stamp_s[rows], self.states[rows])

    def later(self, by_s: float) -> PointMotion:
        """The same motion at another time."""
        return PointMotion(self.stamp_s + by_s, self.states)


class MotionModel(Protocol):
    """A kind of motion."""

    def drawn(self, duration_s: float, rng: np.random.Generator) -> PointMotion:
        """A motion of at least this length; the same generator, the same motion."""
        ...


@dataclass(frozen=True, slots=True)
class Slip:
    """What the rear axle moves aside of its heading.

    Attributes:
        outward_rad_per_mps2, outward_sd_rad_per_mps2: per lateral acceleration; drawn once a drive.
        wander_rad: sd of an angle that wanders slowly beside it.
    """

    outward_rad_per_mps2: float = 0.0065
    outward_sd_rad_per_mps2: float = 0.001
    wander_rad: float = 0.002

    def angle(self, speed: Floats, yaw_rate: Floats, rng: np.random.Generator) -> Floats:
        """Course minus heading `(n,)`, radians."""
        wander = self.wander_rad * wandering(len(speed), 10.0, rng)
        softness = rng.normal(self.outward_rad_per_mps2, self.outward_sd_rad_per_mps2)
        return np.asarray(wander - softness * speed * yaw_rate)


NO_SLIP = Slip(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class WindingRoad:
    """A road whose curvature wanders, driven at a speed that wanders; first a while of standing."""

    speed_mps: float = 9.0
    standstill_s: float = 0.0
    slip: Slip = field(default_factory=Slip)

    def drawn(self, duration_s: float, rng: np.random.Generator) -> PointMotion:
        """See `MotionModel`."""
        count = round(duration_s * RATE_HZ) + 1
        speed = self.speed_mps * (1.0 + 0.25 * wandering(count, 8.0, rng))
        speed = np.asarray(np.clip(speed, 0.4 * self.speed_mps, 1.6 * self.speed_mps))
        if self.standstill_s > 0.0:
            driven_s = np.arange(count) / RATE_HZ - self.standstill_s
            speed = np.clip(_START_MPS2 * driven_s, 0.0, speed)
        # curvature wanders with the way, so a slow car drives the same streets
        curvature = np.clip(0.012 * wandering(count, 5.0, rng), -0.03, 0.03)
        return driven(speed, np.asarray(speed * curvature), self.slip, rng)


@dataclass(frozen=True, slots=True)
class CityTraffic:
    """The manners of a car in a city: speed and yaw rate wander smoothly within limits, stops."""

    speed_mps: float = 10.0
    slip: Slip = NO_SLIP

    def drawn(self, duration_s: float, rng: np.random.Generator) -> PointMotion:
        """See `MotionModel`."""
        count = round(duration_s * RATE_HZ) + 1
        speed = self.speed_mps + _smooth(count, 4.0, 0.35 * self.speed_mps, rng)
        speed = np.maximum(speed, 0.0)
        # turns of a few seconds, with at most 3 m/s^2 sideways
        rate = _smooth(count, 1.0, 0.15, rng)
        limit = np.minimum(3.0 / np.maximum(speed, 0.1), speed / 5.0)
        return driven(speed, limit * np.tanh(rate / np.maximum(limit, 1e-9)), self.slip, rng)


@dataclass(frozen=True, slots=True)
class WhiteAccelerations:
    """The CTRV model's own motion: speed and yaw rate are random walks.

    Attributes:
        along_m2ps3, about_rad2ps3: densities of the white accelerations along and about the
            vertical.
    """

    speed_mps: float
    along_m2ps3: float
    about_rad2ps3: float

    def drawn(self, duration_s: float, rng: np.random.Generator) -> PointMotion:
        """See `MotionModel`."""
        count = round(duration_s * RATE_HZ) + 1
        density = np.array([[self.along_m2ps3], [self.about_rad2ps3]])
        speed, rate = np.cumsum(rng.normal(size=(2, count)) * np.sqrt(density / RATE_HZ), axis=1)
        return driven(self.speed_mps + speed, rate, NO_SLIP, rng)


@dataclass(frozen=True)
class GivenPoses:
    """Along poses `(n, 3)` that are given, one every `step_s`."""

    poses: Floats
    step_s: float = 0.1

    def drawn(self, duration_s: float, rng: np.random.Generator) -> PointMotion:
        """See `MotionModel`; nothing is drawn, and poses that are missing are not made up."""
        poses = self.poses[: min(len(self.poses), round(duration_s / self.step_s) + 1)]
        offset = np.diff(poses[:, :2], axis=0)
        turn = wrap_angle(np.diff(poses[:, 2]))
        # the arc that begins along the heading and spans the chord
        bend = np.sinc(0.5 * turn / np.pi)
        motion = np.stack([np.hypot(*offset.T) / bend, turn], axis=1) / self.step_s
        motion = np.concatenate([motion, motion[-1:]])
        return PointMotion(
            np.asarray(np.arange(len(poses)) * self.step_s, dtype=np.float64),
            np.hstack([poses, motion]),
        )


def driven(speed: Floats, yaw_rate: Floats, slip: Slip, rng: np.random.Generator) -> PointMotion:
    """The path of speed (m/s) and yaw rate (rad/s), `(n,)` each, from a place near the origin."""
    count, dt = len(speed), 1.0 / RATE_HZ
    turn = yaw_rate * dt
    east, north = rng.uniform(-100.0, 100.0, 2)
    yaw = rng.uniform(-np.pi, np.pi) + np.concatenate([[0.0], np.cumsum(turn[:-1])])
    course = np.zeros((count, 3))
    course[:, 2] = yaw + slip.angle(speed, yaw_rate, rng)
    steps = move_along_arc(course, speed * dt, turn)[:-1, :2]
    way = np.concatenate([[[east, north]], steps]).cumsum(axis=0)
    states = np.column_stack([way, wrap_angle(yaw), speed, yaw_rate])
    return PointMotion(np.arange(count) / RATE_HZ, states)


def put_ahead(motion: PointMotion, at_s: float, ahead_m: float) -> PointMotion:
    """A motion that goes on `ahead_m` further along its own path from `at_s` on, and ends earlier.

    Raises:
        ValueError: the path is too short for it.
    """
    first = int(np.searchsorted(motion.stamp_s, at_s))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(motion.states[:, :2], axis=0).T))])
    if first >= len(way) or way[-1] < way[first] + ahead_m:
        raise ValueError(f"no {ahead_m} m of path are left at {at_s} s")
    jump = int(np.searchsorted(way, way[first] + ahead_m)) - first
    states = np.concatenate([motion.states[:first], motion.states[first + jump :]])
    return PointMotion(motion.stamp_s[: len(states)], states)


def wandering(count: int, time_s: float, rng: np.random.Generator) -> Floats:
    """Gauss-Markov noise `(count,)` at `RATE_HZ`: unit variance, correlation time `time_s`."""
    keep = np.exp(-1.0 / (RATE_HZ * time_s))
    kicks = rng.standard_normal(count) * np.sqrt(1.0 - keep**2)
    kicks[0] = rng.standard_normal()
    return np.asarray(scipy.signal.lfilter([1.0], [1.0, -keep], kicks))


def _smooth(count: int, time_s: float, sd: float, rng: np.random.Generator) -> Floats:
    """White noise through two equal first-order lags, scaled to `sd`: its derivative is finite."""
    keep = np.exp(-1.0 / (RATE_HZ * time_s))
    settle = int(8 * time_s * RATE_HZ)
    white = rng.normal(size=count + settle)
    # the variance of a double lag with this pole, driven by unit white noise
    gain = np.sqrt((1 + keep * keep) / (1 - keep * keep) ** 3)
    return np.asarray(
        sd * scipy.signal.lfilter([1.0], [1.0, -2 * keep, keep * keep], white)[settle:] / gain
    )
