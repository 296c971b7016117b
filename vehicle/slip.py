"""Velocity and side-slip of one point of a rigid body from those of another.

Axes ISO 8855: x forward, y left, yaw rate counter-clockwise. What a car's tyres slip in a bend is
`Car.rear_slip_rad_per_mps2`; how it bends an arc, `motion.arc_displacement`.

Source: v_p = v + omega x r in the plane.
"""

from __future__ import annotations

from typing import Any


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
