"""Odometry, GNSS, reference systems and pole detectors, from the true motion with errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.streams import GnssStream, OdometryStream, ReferenceStream
from polemap.simulate.config import GnssConfig, OdometryConfig
from polemap.simulate.detector import PoleDetector
from polemap.simulate.skyline import Fronts, echoes
from polemap.vehicle.pose import rotate, wrap_angle

Floats = NDArray[np.float64]
# of a multipath error, how much lies along the front against across it
_ALONG_FRONT = 0.5
# of arrivals, beside the latency
_ODOMETRY_JITTER_S, _GNSS_JITTER_S, _CAMERA_JITTER_S = 0.002, 0.04, 0.008


@dataclass(frozen=True, slots=True)
class WheelErrors:
    """Small errors of wheel encoders and a gyro, of the size that production cars have.

    Attributes:
        tick_m: way of a count of the encoder.
        slip_per_mps2: share of the speed that a driven wheel turns too fast per acceleration.
        yaw_bias_drift_radps_sqrt_s: random walk of the gyro's bias.
        yaw_scale_sd: relative error of the yaw rate.
    """

    tick_m: float = 0.025
    slip_per_mps2: float = 0.002
    yaw_bias_drift_radps_sqrt_s: float = 0.00004
    yaw_scale_sd: float = 0.004


NO_WHEEL_ERRORS = WheelErrors(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ReceiverErrors:
    """Size and lasting of the errors of a cheap single-frequency receiver."""

    noise_sd_m: float = 0.35
    wander_time_s: float = 60.0
    multipath_sd_m: float = 2.5
    multipath_time_s: float = 6.0
    outage_s: float = 8.0


@dataclass(frozen=True, slots=True)
class ReferenceErrors:
    """Errors of reference poses: sd in each axis and of the yaw, correlated over `time_s`."""

    sd_m: float
    time_s: float
    yaw_sd_rad: float


REFERENCE_RATE_HZ = 50.0  # of a coupled INS
REFERENCES = {
    "good": ReferenceErrors(0.02, 40.0, 0.0008),
    "drifting": ReferenceErrors(0.8, 120.0, 0.004),
}


class Motion(Protocol):
    """The true motion of a rear axle, of a car in a world or of a point."""

    @property
    def stamp_s(self) -> Floats:
        """`(n,)` growing."""
        ...

    def at(self, stamps_s: Floats) -> Floats:
        """Poses `(m, 3)` at the stamps `(m,)`."""
        ...

    def value(self, name: str, stamps_s: Floats) -> Floats:
        """`speed_mps`, `yaw_rate_radps` or `acceleration_mps2`, `(m,)` at the stamps."""
        ...


def gauss_markov(
    stamps_s: Floats, sd: float, time_s: float, rng: np.random.Generator, columns: int = 1
) -> Floats:
    """Exponentially correlated noise `(n, columns)` of stationary sd `sd`."""
    if len(stamps_s) == 0:
        return np.zeros((0, columns))
    keep = np.exp(-np.diff(stamps_s, prepend=stamps_s[0]) / time_s)
    kick = (
        rng.standard_normal((len(stamps_s), columns))
        * (sd * np.sqrt(np.maximum(1 - keep**2, 0.0)))[:, None]
    )
    kick[0] = sd * rng.standard_normal(columns)
    out = np.empty_like(kick)
    state = np.zeros(columns)
    for i in range(len(stamps_s)):
        state = keep[i] * state + kick[i]
        out[i] = state
    return np.asarray(out)


def arrivals(
    stamps_s: Floats, latency_s: float, jitter_s: float, rng: np.random.Generator
) -> Floats:
    """Arrival times: a fixed latency plus jitter that is never negative; none without latency."""
    jitter = np.abs(rng.normal(0.0, 1.0, len(stamps_s))) * (jitter_s if latency_s > 0.0 else 0.0)
    return np.asarray(stamps_s + latency_s + jitter)


def odometry(
    motion: Motion,
    config: OdometryConfig,
    rng: np.random.Generator,
    wheels: WheelErrors | None = None,
) -> OdometryStream:
    """Encoder speed (scale, slip, ticks, noise) and gyro yaw rate (scale, drifting bias, noise)."""
    wheels = wheels or WheelErrors()
    stamps = np.arange(0.0, motion.stamp_s[-1], 1.0 / config.rate_hz)
    speed = motion.value("speed_mps", stamps)
    push = motion.value("acceleration_mps2", stamps)
    rate = motion.value("yaw_rate_radps", stamps)
    scale = 1 + config.speed_scale_sd * rng.standard_normal()
    noise = rng.standard_normal(len(stamps))
    moving = speed > 0.05
    rolled = speed * scale * (1 + wheels.slip_per_mps2 * push)
    rolled += np.where(moving, config.speed_noise_sd_mps * noise, 0.0)
    if wheels.tick_m > 0:
        # the encoder counts whole ticks; the last part of one waits for the next reading
        way = np.cumsum(np.maximum(rolled, 0.0)) / config.rate_hz
        fine = wheels.tick_m / 16
        counted = np.floor(way / fine) * fine
        rolled = np.diff(counted, prepend=0.0) * config.rate_hz
    bias = config.yaw_bias_sd_radps * rng.standard_normal()
    drift = np.cumsum(rng.standard_normal(len(stamps))) * (
        wheels.yaw_bias_drift_radps_sqrt_s / np.sqrt(config.rate_hz)
    )
    turned = rate * (1 + wheels.yaw_scale_sd * rng.standard_normal()) + bias + drift
    turned = turned + config.yaw_noise_sd_radps * rng.standard_normal(len(stamps))
    late = arrivals(stamps, config.latency_s, _ODOMETRY_JITTER_S, rng)
    return OdometryStream(stamps, late, rolled, turned)


def gnss(
    motion: Motion,
    origin_m: Floats,
    config: GnssConfig,
    rng: np.random.Generator,
    fronts: Fronts,
    receiver: ReceiverErrors | None = None,
) -> GnssStream:
    """Fixes of a cheap receiver; beside high fronts multipath comes as jumps that hold a while.

    A jump lasts some seconds and ends at the latest where the houses do; it goes mainly to or
    from the front that echoes.
    """
    receiver = receiver or ReceiverErrors()
    end = motion.stamp_s[-1]
    stamps = np.arange(rng.uniform(0, 1 / config.rate_hz), end, 1.0 / config.rate_hz)
    pose = motion.at(stamps)
    antenna = pose[:, :2] + rotate([config.antenna_x_m, config.antenna_y_m], pose[:, 2])
    error = gauss_markov(stamps, config.wander_sd_m, receiver.wander_time_s, rng, 2)
    error += receiver.noise_sd_m * rng.standard_normal((len(stamps), 2))
    hdop = 0.9 + 0.2 * np.abs(gauss_markov(stamps, 1.0, 30.0, rng)[:, 0])
    share, toward = echoes(antenna, fronts)
    for _ in range(int(rng.poisson(config.multipath_per_min * end / 60))):
        start, length = rng.uniform(0, end), rng.exponential(receiver.multipath_time_s)
        jump = receiver.multipath_sd_m * rng.standard_normal(2) * (1.0, _ALONG_FRONT)
        first = min(int(np.searchsorted(stamps, start)), len(stamps) - 1)
        if rng.uniform() >= share[first]:
            continue
        beyond = np.flatnonzero(share[first:] == 0.0)
        until = stamps[first + beyond[0]] if len(beyond) else np.inf
        during = (stamps >= start) & (stamps < min(start + length, until))
        x, y = toward[first]
        error[during] += (jump[0] * x - jump[1] * y, jump[0] * y + jump[1] * x)
        # the receiver notices only part of it
        hdop[during] += rng.uniform(0.2, 1.2) * np.hypot(*jump) / receiver.multipath_sd_m
    seen = np.ones(len(stamps), dtype=np.bool_)
    for _ in range(int(rng.poisson(config.outages_per_min * end / 60))):
        start = rng.uniform(10.0, max(10.0, end))
        seen &= ~((stamps >= start) & (stamps < start + rng.exponential(receiver.outage_s)))
    place = antenna + error + origin_m
    late = arrivals(stamps, config.latency_s, _GNSS_JITTER_S, rng)
    return GnssStream(stamps[seen], late[seen], place[seen, 0], place[seen, 1], hdop[seen])


def reference(
    motion: Motion,
    origin_m: Floats,
    errors: ReferenceErrors,
    rate_hz: float,
    rng: np.random.Generator,
) -> ReferenceStream:
    """Reference poses: correlated errors of centimetres, or a drift of a metre."""
    stamps = np.arange(0.0, motion.stamp_s[-1], 1.0 / rate_hz)
    pose = motion.at(stamps)
    pose[:, :2] += gauss_markov(stamps, errors.sd_m, errors.time_s, rng, 2) + origin_m
    turned = gauss_markov(stamps, errors.yaw_sd_rad, errors.time_s, rng)[:, 0]
    pose[:, 2] = wrap_angle(pose[:, 2] + turned)
    return ReferenceStream(stamps, pose, np.full(len(stamps), max(errors.sd_m, 1e-3)))


@dataclass(frozen=True, slots=True)
class CameraLatency:
    """When a picture reaches the computer after its exposure, and how many never do.

    Attributes:
        least_s, largest_s: limits of a drive's mean latency; exposure, transfer and rectification
            of industrial cameras.
        drop_share: of the pictures, those that never arrive.
    """

    least_s: float = 0.05
    largest_s: float = 0.15
    drop_share: float = 0.002


CAMERA_LATENCY = CameraLatency()


def frame_times(
    motion: Motion,
    rate_hz: float,
    rng: np.random.Generator,
    latency: CameraLatency = CAMERA_LATENCY,
) -> tuple[Floats, Floats]:
    """Exposure and arrival of every picture that arrives at all."""
    stamps = np.arange(0.05, motion.stamp_s[-1] - 0.05, 1.0 / rate_hz)
    base = rng.uniform(latency.least_s, latency.largest_s)
    late = arrivals(stamps, base, _CAMERA_JITTER_S, rng)
    late = np.minimum(late, stamps + latency.largest_s + 0.05)
    kept = rng.uniform(size=len(stamps)) >= latency.drop_share
    return stamps[kept], np.maximum.accumulate(late)[kept]


def pole_scans(detector: PoleDetector, motion: Motion, rate_hz: float) -> list[Detections]:
    """What a detector reports of poles along a drive; nothing hides them."""
    stamps = np.arange(motion.stamp_s[0], motion.stamp_s[-1], 1.0 / rate_hz)
    poses = motion.at(stamps)
    return [detector.scan(float(t), pose) for t, pose in zip(stamps, poses, strict=True)]
