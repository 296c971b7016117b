"""A drive without a world: a driven path, and what odometry, GNSS and a pose source say of it.

For statistics over many seeds, where rendering images would take hours. The path has the
accelerations of a car in a city: speed and yaw rate wander smoothly within limits, with stops.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from polemap.drivelog.samples import GnssFix, OdometrySample
from polemap.vehicle.motion import move_along_arc
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

_TRUTH_HZ = 500


@dataclass(frozen=True, slots=True)
class PointNoise:
    """Errors of the sensors; sd unless it says otherwise.

    The defaults are those of the drives that lack odometry and GNSS (speed 1 % and 0.05 m/s, yaw
    rate 0.002 rad/s with a bias of 0.001, GNSS 2.5 m over 60 s), and a pose source of 0.06 m.
    `pose_correlation_s` above 0 makes successive poses share their error.
    """

    speed_mps: float = 0.05
    speed_scale: float = 0.01
    yaw_rate_radps: float = 0.002
    yaw_rate_bias_radps: float = 0.001
    pose_along_m: float = 0.08
    pose_across_m: float = 0.06
    pose_yaw_rad: float = 0.005
    pose_correlation_s: float = 0.0
    gnss_m: float = 2.5
    gnss_correlation_s: float = 60.0


@dataclass(frozen=True, slots=True)
class PointPose:
    """A pose `(3,)` of the rear axle with covariance `(3, 3)`, as a particle filter gives it."""

    stamp_s: float
    arrival_s: float
    pose: Floats
    covariance: Floats


@dataclass(frozen=True, slots=True)
class PointDrive:
    """Truth `(n, 5)` (east, north, yaw, speed, yaw rate) at `stamps_s`, and the samples of it."""

    stamps_s: Floats
    states: Floats
    odometry: tuple[OdometrySample, ...]
    gnss: tuple[GnssFix, ...]
    poses: tuple[PointPose, ...]
    noise: PointNoise = field(default_factory=PointNoise)

    def truth(self, stamps_s: Floats) -> Floats:
        """True states `(m, 5)` at the stamps `(m,)`, interpolated along arcs."""
        stamps = np.atleast_1d(stamps_s)
        row = np.clip(np.searchsorted(self.stamps_s, stamps, side="right") - 1, 0, None)
        start, rest = self.states[row], stamps - self.stamps_s[row]
        poses = move_along_arc(start[:, :3], start[:, 3] * rest, start[:, 4] * rest)
        return np.concatenate([poses, start[:, 3:]], axis=1)


def point_drive(
    rng: np.random.Generator,
    *,
    duration_s: float = 60.0,
    noise: PointNoise | None = None,
    odometry_hz: float = 50.0,
    pose_hz: float = 22.0,
    latency_s: float = 0.11,
    latency_jitter_s: float = 0.0,
    gnss_hz: float = 1.0,
    speed_mps: float = 10.0,
    densities: tuple[float, float] | None = None,
    slip_rad_per_mps2: float = 0.0,
) -> PointDrive:
    """Drive for a while and sample it.

    Args:
        rng: all randomness.
        latency_s: from a pose's stamp to its arrival, plus `latency_jitter_s` (exponential).
        speed_mps: about which the speed wanders, or from which it starts.
        densities: of white accelerations along (m^2/s^3) and about the vertical (rad^2/s^3); with
            them the truth is drawn from the CTRV model instead of a city's manners.
        slip_rad_per_mps2: outward slip of the rear axle per lateral acceleration.
    """
    noise = noise or PointNoise()
    stamps = np.arange(round(duration_s * _TRUTH_HZ) + 1) / _TRUTH_HZ
    speed, rate = (
        _city(rng, len(stamps), speed_mps)
        if densities is None
        else _white(rng, len(stamps), speed_mps, *densities)
    )
    states = _path(rng, speed, rate, slip_rad_per_mps2)
    bare = PointDrive(stamps, states, (), (), (), noise)
    return PointDrive(
        stamps,
        states,
        _odometry(rng, bare, np.arange(0.0, duration_s, 1.0 / odometry_hz)),
        _gnss(rng, bare, np.arange(0.05, duration_s, 1.0 / gnss_hz)),
        _poses(rng, bare, np.arange(0.013, duration_s, 1.0 / pose_hz), latency_s, latency_jitter_s),
        noise,
    )


def _wander(rng: np.random.Generator, count: int, time_s: float, sd: float) -> Floats:
    """A smooth stationary signal: white noise through two equal first-order lags, scaled to sd."""
    a = np.exp(-1.0 / (_TRUTH_HZ * time_s))
    settle = int(8 * time_s * _TRUTH_HZ)
    white = rng.normal(size=count + settle)
    # the variance of a double lag with pole a driven by unit white noise
    gain = np.sqrt((1 + a * a) / (1 - a * a) ** 3)
    smooth = lfilter([1.0], [1.0, -2 * a, a * a], white) / gain
    return np.asarray(sd * smooth[settle:])


def _city(rng: np.random.Generator, count: int, speed_mps: float) -> tuple[Floats, Floats]:
    """Speed and yaw rate `(n,)` that wander smoothly."""
    speed = np.maximum(speed_mps + _wander(rng, count, 4.0, 0.35 * speed_mps), 0.0)
    # turns of a few seconds, with at most 3 m/s^2 sideways
    rate = _wander(rng, count, 1.0, 0.15)
    limit = np.minimum(3.0 / np.maximum(speed, 0.1), speed / 5.0)
    return speed, limit * np.tanh(rate / np.maximum(limit, 1e-9))


def _white(
    rng: np.random.Generator, count: int, speed_mps: float, along: float, about: float
) -> tuple[Floats, Floats]:
    """Speed and yaw rate `(n,)` as random walks."""
    walks = rng.normal(size=(2, count)) * np.sqrt(np.array([[along], [about]]) / _TRUTH_HZ)
    speed, rate = np.cumsum(walks, axis=1)
    return speed_mps + speed, rate


def _path(rng: np.random.Generator, speed: Floats, rate: Floats, slip: float) -> Floats:
    n, dt = len(speed), 1.0 / _TRUTH_HZ
    turn = rate * dt
    yaw = rng.uniform(-np.pi, np.pi) + np.concatenate([[0.0], np.cumsum(turn[:-1])])
    course = yaw - slip * speed * rate
    steps = move_along_arc(np.stack([np.zeros(n), np.zeros(n), course], axis=1), speed * dt, turn)
    way = np.concatenate([np.zeros((1, 2)), np.cumsum(steps[:-1, :2], axis=0)])
    return np.column_stack([way, wrap_angle(yaw), speed, rate])


def _odometry(
    rng: np.random.Generator, drive: PointDrive, stamps: Floats
) -> tuple[OdometrySample, ...]:
    noise, true = drive.noise, drive.truth(stamps)
    scale = 1.0 + rng.normal(0.0, noise.speed_scale)
    bias = noise.yaw_rate_bias_radps * rng.choice([-1.0, 1.0])
    speed = np.where(
        true[:, 3] > 0, scale * true[:, 3] + rng.normal(0.0, noise.speed_mps, len(stamps)), 0.0
    )
    rate = true[:, 4] + bias + rng.normal(0.0, noise.yaw_rate_radps, len(stamps))
    return tuple(
        OdometrySample(float(t), float(t), float(v), float(w))
        for t, v, w in zip(stamps, speed, rate, strict=True)
    )


def _correlated(
    rng: np.random.Generator, stamps: Floats, sd: Floats | float, time_s: float, columns: int
) -> Floats:
    """First-order Gauss-Markov errors `(n, columns)`; white for a time of 0."""
    white = rng.normal(size=(len(stamps), columns))
    if time_s <= 0.0:
        return np.asarray(white * sd)
    values = np.empty_like(white)
    values[0] = white[0]
    for i in range(1, len(stamps)):
        keep = np.exp(-(stamps[i] - stamps[i - 1]) / time_s)
        values[i] = keep * values[i - 1] + np.sqrt(1.0 - keep * keep) * white[i]
    return np.asarray(values * sd)


def _gnss(rng: np.random.Generator, drive: PointDrive, stamps: Floats) -> tuple[GnssFix, ...]:
    noise, true = drive.noise, drive.truth(stamps)
    error = _correlated(rng, stamps, noise.gnss_m, noise.gnss_correlation_s, 2)
    return tuple(
        GnssFix(float(t), float(t), float(x), float(y), 1.0)
        for t, (x, y) in zip(stamps, true[:, :2] + error, strict=True)
    )


def _poses(
    rng: np.random.Generator, drive: PointDrive, stamps: Floats, latency_s: float, jitter_s: float
) -> tuple[PointPose, ...]:
    noise, true = drive.noise, drive.truth(stamps)
    sd = np.array([noise.pose_along_m, noise.pose_across_m, noise.pose_yaw_rad])
    error = _correlated(rng, stamps, sd, noise.pose_correlation_s, 3)
    late = latency_s + (rng.exponential(jitter_s, len(stamps)) if jitter_s > 0 else 0.0)
    arrivals = stamps + late
    poses = []
    for t, arrival, state, e in zip(stamps, arrivals, true, error, strict=True):
        c, s = np.cos(state[2]), np.sin(state[2])
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        pose = state[:3] + turn @ e
        pose[2] = wrap_angle(pose[2])
        poses.append(PointPose(float(t), float(arrival), pose, turn @ np.diag(sd**2) @ turn.T))
    return tuple(poses)
