"""Odometry between keyframes: dead reckoning with its calibration, Jacobians and noise.

The model of an odometry sample of speed v and yaw rate w, held between stamps,

    ds   = (1 + s) v dt
    dyaw = (1 + q) w dt + b dt + k ds
    way  = yaw + dyaw / 2 + d - (g + h) v w

with the calibration c = (s, q, b, k, d, h): scales of speed and yaw rate, offsets of a gyro (rad/s)
and of a steering angle (as curvature, rad/m), and the direction in which the car goes seen from
its detector; g + h is what the rear axle slips outward, g that of any car. A standing car (v = 0)
does not turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.streams import OdometryStream
from polemap.vehicle.motion import arc_displacement
from polemap.vehicle.pose import pose_rotation, relative, wrap_angle

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

CALIBRATION = (
    "speed_scale", "yaw_rate_scale", "yaw_rate_offset_radps", "curvature_offset_radpm",
    "sideslip_rad", "slip_rad_per_mps2",
)  # fmt: skip
_STEP = np.array([1e-4, 1e-4, 1e-6, 1e-6, 1e-5, 1e-5])
SLIP = 0.006  # outward slip of any rear axle, rad per m/s^2
_GAP_S = 0.5  # odometry that is silent for longer leaves the motion unknown
_GAP_SPEED_MPS, _GAP_RATE_RADPS = 2.0, 0.3


@dataclass(frozen=True, slots=True)
class MotionNoise:
    """Densities of the noise of odometry, per square root of a second or of a metre.

    Attributes:
        along_m_per_sqrt_s, along_share_sqrt_s: of the distance, constant and in proportion to
            the speed.
        yaw_rad_per_sqrt_s: of the turn.
        turn_share_sqrt_s, turn_most_rad_per_sqrt_s: of the turn in proportion to the yaw rate, and
            its bound.
        left_m_per_sqrt_m: aside of the heading.
    """

    along_m_per_sqrt_s: float = 0.2 * 0.02**0.5
    along_share_sqrt_s: float = 0.07 * 0.02**0.5
    yaw_rad_per_sqrt_s: float = 0.03 * 0.02**0.5
    turn_share_sqrt_s: float = 0.01 / 0.02**0.5
    turn_most_rad_per_sqrt_s: float = 0.003 / 0.02**0.5
    left_m_per_sqrt_m: float = 0.015


@dataclass(frozen=True, slots=True)
class Path:
    """Dead reckoning of one drive at its odometry stamps, with what its noise adds up to.

    Attributes:
        stamp_s: `(n,)`; poses: `(n, 3)`, yaw not wrapped; travelled_m: `(n,)`.
        variance: `(n, 3)` running sums of the variances along, aside and of the turn.
    """

    stamp_s: Floats
    poses: Floats
    travelled_m: Floats
    variance: Floats

    def at(self, stamps_s: Floats) -> Floats:
        """Poses `(m, 3)` at stamps, the first and last beyond the ends."""
        return np.column_stack(
            [np.interp(stamps_s, self.stamp_s, self.poses[:, axis]) for axis in range(3)]
        )

    def noise_at(self, stamps_s: Floats) -> Floats:
        """Running sums of the variances `(m, 3)` at stamps."""
        return np.column_stack(
            [np.interp(stamps_s, self.stamp_s, self.variance[:, axis]) for axis in range(3)]
        )


def dead_reckon(stream: OdometryStream, calibration: Floats, noise: MotionNoise) -> Path:
    """The way of a drive from the origin; calibration `(6,)`, or `(n, 6)` of its samples."""
    stamps = stream.stamp_s
    if len(stamps) < 2:
        n = len(stamps)
        return Path(stamps, np.zeros((n, 3)), np.zeros(n), np.zeros((n, 3)))
    dt = np.diff(stamps)
    speed = 0.5 * (stream.speed_mps[1:] + stream.speed_mps[:-1])
    rate = 0.5 * (stream.yaw_rate_radps[1:] + stream.yaw_rate_radps[:-1])
    c = np.broadcast_to(calibration, (len(stamps), len(CALIBRATION)))[:-1]
    distance = (1.0 + c[:, 0]) * speed * dt
    moving = speed != 0.0
    turn = np.where(moving, (1.0 + c[:, 1]) * rate * dt + c[:, 2] * dt + c[:, 3] * distance, 0.0)
    yaw = np.concatenate([[0.0], np.cumsum(turn)])
    step = arc_displacement(yaw[:-1], distance, turn, c[:, 4] - (SLIP + c[:, 5]) * speed * rate)
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
    gap = np.maximum(dt - _GAP_S, 0.0)
    along = moving * (noise.along_m_per_sqrt_s**2 + (noise.along_share_sqrt_s * speed) ** 2) * dt
    turned = np.minimum(noise.turn_share_sqrt_s * np.abs(rate), noise.turn_most_rad_per_sqrt_s)
    yawed = moving * (noise.yaw_rad_per_sqrt_s**2 + turned**2) * dt
    aside = noise.left_m_per_sqrt_m**2 * np.abs(distance)
    variance = np.column_stack(
        [
            along + (_GAP_SPEED_MPS * gap) ** 2,
            aside + (0.5 * _GAP_SPEED_MPS * gap) ** 2,
            yawed + (_GAP_RATE_RADPS * gap) ** 2,
        ]
    )
    return Path(
        stamps,
        np.column_stack([place, yaw]),
        np.concatenate([[0.0], np.cumsum(np.abs(distance))]),
        np.concatenate([np.zeros((1, 3)), np.cumsum(variance, axis=0)]),
    )


@dataclass(frozen=True, slots=True)
class Increments:
    """Motion between successive keyframes of one drive, row i from keyframe i to i + 1.

    Attributes:
        motion: `(n - 1, 3)` in the axes of the first, at the calibration of `at`.
        jacobian: `(n - 1, 3, 6)` of it by the calibration.
        covariance: `(n - 1, 3, 3)`.
    """

    motion: Floats
    jacobian: Floats
    covariance: Floats


def keyframe_stamps(path: Path, spacing_m: float) -> Floats:
    """Stamps of a pose every `spacing_m` of way, with the first and the last."""
    total = float(path.travelled_m[-1])
    ticks = spacing_m * np.arange(1, int(total / spacing_m) + 1)
    rows = np.searchsorted(path.travelled_m, ticks)
    stamps = np.concatenate(
        [path.stamp_s[:1], path.stamp_s[np.minimum(rows, len(path.stamp_s) - 1)], path.stamp_s[-1:]]
    )
    return np.unique(stamps)


def increments(
    stream: OdometryStream, calibration: Floats, noise: MotionNoise, stamps_s: Floats
) -> tuple[Path, Increments]:
    """Dead reckoning, and the increments between the keyframes at `stamps_s`."""
    path = dead_reckon(stream, calibration, noise)
    poses = path.at(stamps_s)
    motion = relative(poses[:-1], poses[1:])
    jacobian = np.empty((len(motion), 3, len(CALIBRATION)))
    about = np.broadcast_to(calibration, (len(stream), len(CALIBRATION)))
    for column, step in enumerate(_STEP):
        moved = about + step * np.eye(len(CALIBRATION))[column]
        other = dead_reckon(stream, moved, noise).at(stamps_s)
        change = relative(other[:-1], other[1:]) - motion
        change[:, 2] = wrap_angle(change[:, 2])
        jacobian[:, :, column] = change / step
    added = np.diff(path.noise_at(stamps_s), axis=0)
    return path, Increments(motion, jacobian, _covariance(motion, added))


def _covariance(motion: Floats, added: Floats) -> Floats:
    """Covariances `(n, 3, 3)` of increments from variances along, aside and of the turn.

    Turns made on the way displace the end by half of the way on average: with a random walk of the
    yaw its cross covariance is L/2, its own part L^2/3.
    """
    covariance = np.zeros((len(motion), 3, 3))
    length = np.hypot(motion[:, 0], motion[:, 1])
    covariance[:, 0, 0] = added[:, 0]
    covariance[:, 1, 1] = added[:, 1] + added[:, 2] * length**2 / 3.0
    covariance[:, 2, 2] = added[:, 2]
    covariance[:, 1, 2] = covariance[:, 2, 1] = added[:, 2] * length / 2.0
    turn = pose_rotation(np.arctan2(motion[:, 1], motion[:, 0]) * (length > 0))
    covariance = turn @ covariance @ turn.transpose(0, 2, 1)
    # a pose is never tied harder than a millimetre and a tenth of a milliradian
    return covariance + np.diag([1e-6, 1e-6, 1e-8])
