"""How a car moves between two moments, arcs of odometry; how one point moves with another.

Arcs take arrays with leading dimensions, so one code serves a single pose `(3,)` and all particles
`(n, 3)`. Nothing divides by the yaw rate: the chord of an arc is its length times `sin(h) / h` with
half the turned angle h, which is smooth through zero. CTRV of single states is in `packed.py`. What
a car's tyres slip in a bend is `Car.rear_slip_rad_per_mps2`.

Axes ISO 8855: x forward, y left, yaw rate counter-clockwise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]


def sinc(angle_rad: ArrayLike) -> Floats:
    """`sin(angle) / angle`, 1 at zero; any shape."""
    return np.sinc(np.asarray(angle_rad, dtype=np.float64) / np.pi)


def arc_displacement(
    yaw_rad: ArrayLike,
    distance_m: ArrayLike,
    turn_rad: ArrayLike,
    sideslip_rad: Floats | float = 0.0,
    left_m: Floats | float = 0.0,
) -> Floats:
    """How far an arc leads east and north, `(..., 2)`.

    Args:
        yaw_rad: `(...)` where the arc begins.
        distance_m: `(...)` signed length of the arc.
        turn_rad: `(...)` angle turned on it, counter-clockwise positive.
        sideslip_rad: `(...)` direction of the motion less the yaw, left positive; the rear axle
            slips outward in a bend (`slip.axle_sideslip_rad`).
        left_m: `(...)` moved aside of that direction.

    Source: S16 (1)-(6), in the form without the division by the yaw rate (errata.md, Odometry).
    """
    half = 0.5 * np.asarray(turn_rad, dtype=np.float64)
    chord = np.asarray(distance_m, dtype=np.float64) * sinc(half)
    way = np.asarray(yaw_rad, dtype=np.float64) + half + sideslip_rad
    c, s = np.cos(way), np.sin(way)
    return np.stack([chord * c - left_m * s, chord * s + left_m * c], axis=-1)


def move_along_arc(
    poses: ArrayLike, distance_m: ArrayLike, turn_rad: ArrayLike, sideslip_rad: Floats | float = 0.0
) -> Floats:
    """Rear-axle poses moved along a circular arc.

    Args:
        poses: `(..., 3)` east, north, yaw of the rear axle.
        distance_m: `(...)` signed length of the arc.
        turn_rad: `(...)` angle turned on it, counter-clockwise positive.
        sideslip_rad: `(...)` as in `arc_displacement`.

    Returns:
        `(..., 3)`, yaw wrapped to [-pi, pi).
    """
    start = np.asarray(poses, dtype=np.float64)
    half = 0.5 * np.asarray(turn_rad, dtype=np.float64)
    place = start[..., :2] + arc_displacement(start[..., 2], distance_m, turn_rad, sideslip_rad)
    yaw = np.broadcast_to(wrap_angle(start[..., 2] + half + half), place.shape[:-1])
    return np.concatenate([place, yaw[..., np.newaxis]], axis=-1)


def velocity_at(
    vx_mps: float, vy_mps: float, yaw_rate_radps: float, ahead_m: float, left_m: float = 0.0
) -> tuple[float, float]:
    """Velocity of the point `ahead_m` before and `left_m` beside the one that has (vx, vy).

    Floats or arrays of one shape.
    """
    return vx_mps - yaw_rate_radps * left_m, vy_mps + yaw_rate_radps * ahead_m


def sideslip_at(sideslip_rad: Any, yaw_rate_radps: Any, speed_mps: Any, ahead_m: float) -> Any:
    """Side-slip of a point `ahead_m` before the one that has `sideslip_rad`, for small angles.

    `beta + x gamma / v`; floats or arrays, the speed not zero.
    """
    return sideslip_rad + ahead_m * yaw_rate_radps / speed_mps
