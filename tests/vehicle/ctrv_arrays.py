"""CTRV with Jacobian and noise in arrays: the oracle of `vehicle/packed.py`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polemap.vehicle.motion import move_along_arc, sinc
from polemap.vehicle.pose import rotation

Floats = NDArray[np.float64]

# below this the series of (h cos h - sin h) / h^2 is exact to the last bit, the quotient is not
_SERIES_BELOW_RAD = 0.05


def sinc_slope(angle_rad: ArrayLike) -> Floats:
    """Derivative of `sin(angle) / angle`, 0 at zero; any shape."""
    h = np.asarray(angle_rad, dtype=np.float64)
    small = np.abs(h) < _SERIES_BELOW_RAD
    safe = np.where(small, 1.0, h)
    h2 = h * h
    series = -h / 3.0 * (1.0 - h2 / 10.0 * (1.0 - h2 / 28.0 * (1.0 - h2 / 54.0)))
    return np.where(small, series, (safe * np.cos(safe) - np.sin(safe)) / (safe * safe))


def arc_jacobians(
    poses: ArrayLike, distance_m: ArrayLike, turn_rad: ArrayLike, sideslip_rad: Floats | float = 0.0
) -> tuple[Floats, Floats]:
    """Derivatives of `move_along_arc` by the pose `(..., 3, 3)` and by (distance, turn)
    `(..., 3, 2)`; by the side-slip the place changes as by the yaw.
    """
    start = np.asarray(poses, dtype=np.float64)
    distance, turn = np.asarray(distance_m, dtype=np.float64), np.asarray(turn_rad)
    half = 0.5 * turn
    way = start[..., 2] + half + sideslip_rad
    c, s = np.cos(way), np.sin(way)
    shape = np.broadcast_shapes(way.shape, distance.shape)
    chord, ratio, slope = distance * sinc(half), sinc(half), distance * sinc_slope(half)
    by_pose = np.zeros((*shape, 3, 3))
    by_pose[..., :, :] = np.eye(3)
    by_pose[..., 0, 2] = -chord * s
    by_pose[..., 1, 2] = chord * c
    by_input = np.zeros((*shape, 3, 2))
    by_input[..., 0, 0] = ratio * c
    by_input[..., 1, 0] = ratio * s
    by_input[..., 0, 1] = 0.5 * (slope * c - chord * s)
    by_input[..., 1, 1] = 0.5 * (slope * s + chord * c)
    by_input[..., 2, 1] = 1.0
    return by_pose, by_input


def ctrv_step(
    states: ArrayLike, dt_s: ArrayLike, slip_rad_per_mps2: Floats | float = 0.0
) -> Floats:
    """Constant turn rate and velocity over `dt_s`, which may be negative.

    Args:
        states: `(..., 5)` east, north, yaw, speed, yaw rate of the rear axle.
        dt_s: `(...)`.
        slip_rad_per_mps2: k: the axle goes in the direction yaw - k v w, outward in a bend.

    Source: S16, output Kalman filter (III-D); the slip see `Car.rear_slip_rad_per_mps2`.
    """
    start = np.asarray(states, dtype=np.float64)
    dt = np.asarray(dt_s, dtype=np.float64)
    moved = move_along_arc(start[..., :3], *_arc(start, dt, slip_rad_per_mps2))
    rest = np.broadcast_to(start[..., 3:], (*moved.shape[:-1], 2))
    return np.concatenate([moved, rest], axis=-1)


def _arc(start: Floats, dt: Floats, slip: Floats | float) -> tuple[Floats, Floats, Floats]:
    """Distance, turn and side-slip of a CTRV state over dt."""
    v, w = start[..., 3], start[..., 4]
    return v * dt, w * dt, -np.asarray(slip, dtype=np.float64) * v * w


def ctrv_jacobian(
    states: ArrayLike, dt_s: ArrayLike, slip_rad_per_mps2: Floats | float = 0.0
) -> Floats:
    """Derivative `(..., 5, 5)` of `ctrv_step` by the state."""
    start = np.asarray(states, dtype=np.float64)
    dt = np.asarray(dt_s, dtype=np.float64)
    slip = np.asarray(slip_rad_per_mps2, dtype=np.float64)
    by_pose, by_input = arc_jacobians(start[..., :3], *_arc(start, dt, slip))
    jacobian = np.zeros((*by_pose.shape[:-2], 5, 5))
    jacobian[..., :3, :3] = by_pose
    jacobian[..., :3, 3:] = by_input * dt[..., None, None]
    by_sideslip = by_pose[..., :2, 2]
    jacobian[..., :2, 3] -= by_sideslip * (slip * start[..., 4])[..., None]
    jacobian[..., :2, 4] -= by_sideslip * (slip * start[..., 3])[..., None]
    jacobian[..., 3, 3] = jacobian[..., 4, 4] = 1.0
    return jacobian


def ctrv_process_noise(
    states: ArrayLike,
    dt_s: ArrayLike,
    *,
    acceleration_m2ps3: float,
    yaw_acceleration_rad2ps3: float,
    lateral_m2ps: ArrayLike = 0.0,
    along_m2ps: ArrayLike = 0.0,
    yaw_rad2ps: ArrayLike = 0.0,
    slip_rad_per_mps2: Floats | float = 0.0,
) -> Floats:
    """Covariance `(..., 5, 5)` that white accelerations add over `dt_s`.

    The chains speed -> position along the path and yaw rate -> yaw -> position across it are
    integrated exactly, with the heading held at its middle: exact on a straight, and positive
    semi-definite always.

    Args:
        states: `(..., 5)` as in `ctrv_step`.
        dt_s: `(...)`, not negative.
        acceleration_m2ps3: spectral density of the longitudinal acceleration.
        yaw_acceleration_rad2ps3: spectral density of the yaw acceleration.
        lateral_m2ps: `(...)` spectral density of a sideways velocity (slip) that CTRV lacks.
        along_m2ps, yaw_rad2ps: `(...)` of errors in speed and yaw rate that CTRV does not carry.
    """
    start = np.asarray(states, dtype=np.float64)
    dt = np.asarray(dt_s, dtype=np.float64)
    v = start[..., 3]
    qa, qw = acceleration_m2ps3, yaw_acceleration_rad2ps3
    _, turned, sideslip = _arc(start, dt, slip_rad_per_mps2)
    heading = start[..., 2] + 0.5 * turned + sideslip
    local = np.zeros((*np.broadcast_shapes(heading.shape, dt.shape), 5, 5))
    dt2 = dt * dt
    dt3 = dt2 * dt
    local[..., 0, 0] = qa * dt3 / 3.0 + np.asarray(along_m2ps) * dt
    local[..., 0, 3] = local[..., 3, 0] = qa * dt2 / 2.0
    local[..., 3, 3] = qa * dt
    local[..., 1, 1] = qw * v * v * dt2 * dt3 / 20.0 + np.asarray(lateral_m2ps) * dt
    local[..., 1, 2] = local[..., 2, 1] = qw * v * dt2 * dt2 / 8.0
    local[..., 1, 4] = local[..., 4, 1] = qw * v * dt3 / 6.0
    local[..., 2, 2] = qw * dt3 / 3.0 + np.asarray(yaw_rad2ps) * dt
    local[..., 2, 4] = local[..., 4, 2] = qw * dt2 / 2.0
    local[..., 4, 4] = qw * dt
    turn = np.zeros_like(local)
    turn[..., :, :] = np.eye(5)
    turn[..., :2, :2] = rotation(heading)
    return np.asarray(turn @ local @ np.swapaxes(turn, -1, -2))
