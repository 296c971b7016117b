"""Lateral forces of the two axles of a nonlinear single track, with their slopes.

Brush tyres whose limit falls with the force along (friction ellipse) and whose load moves with
the longitudinal acceleration. Axes ISO 8855, small slip angles.
"""

from __future__ import annotations

from math import sqrt

from polemap.vehicle.parameters import Car
from polemap.vehicle.tyre import brush_lateral

GRAVITY_MPS2 = 9.80665
# stiffness of an axle over its load relative to rest: C = C0 (1 + e (Fz / Fz0 - 1)); tyres grow
# stiffer less than in proportion to their load (Pacejka, Tyre and Vehicle Dynamics, 3rd ed., 4.3)
LOAD_GROWTH = 0.5
# least load of an axle over its load at rest, and least lateral share of the friction that braking
# or driving leaves: beyond these the split of forces is not known well enough
_LEAST_LOAD, _LEAST_LATERAL = 0.2, 0.3

AxleLimits = tuple[float, float, float, float]
AxleForces = tuple[float, float, float, float]


class Axles:
    """Front and rear axle of a car, two equal tyres each."""

    __slots__ = (
        "_car",
        "_front_load_n",
        "_front_nprad",
        "_height_share",
        "_rear_load_n",
        "_rear_nprad",
    )

    def __init__(self, car: Car) -> None:
        length, weight = car.wheelbase_m, car.mass_kg * GRAVITY_MPS2
        self._car = car
        self._front_load_n = weight * car.cg_to_rear_m / length
        self._rear_load_n = weight * car.cg_to_front_m / length
        self._front_nprad = 2.0 * (car.front_slip_stiffness_nprad or car.front_stiffness_nprad)
        self._rear_nprad = 2.0 * (car.rear_slip_stiffness_nprad or car.rear_stiffness_nprad)
        self._height_share = car.mass_kg * car.cg_height_m / length

    def limits(self, ax_mps2: float) -> AxleLimits:
        """Front stiffness and limit, rear stiffness and limit (N/rad, N) under an acceleration."""
        car = self._car
        shifted = self._height_share * ax_mps2
        front = max(1.0 - shifted / self._front_load_n, _LEAST_LOAD)
        rear = max(1.0 + shifted / self._rear_load_n, _LEAST_LOAD)
        along = car.mass_kg * ax_mps2
        front_along = along * (car.front_brake_share if along < 0.0 else car.front_drive_share)
        return (
            self._front_nprad * (1.0 + LOAD_GROWTH * (front - 1.0)),
            _across(car.front_friction * front * self._front_load_n, front_along),
            self._rear_nprad * (1.0 + LOAD_GROWTH * (rear - 1.0)),
            _across(car.rear_friction * rear * self._rear_load_n, along - front_along),
        )

    def forces(
        self,
        sideslip_rad: float,
        yaw_rate_radps: float,
        road_wheel_angle_rad: float,
        speed_mps: float,
        limits: AxleLimits,
    ) -> AxleForces:
        """Front force and slope, rear force and slope (N, N/rad), to the left; speed not zero."""
        car, (front_c, front_limit, rear_c, rear_limit) = self._car, limits
        front_slip = (
            sideslip_rad + car.cg_to_front_m * yaw_rate_radps / speed_mps - road_wheel_angle_rad
        )
        rear_slip = sideslip_rad - car.cg_to_rear_m * yaw_rate_radps / speed_mps
        return (
            *brush_lateral(front_slip, front_c, front_limit),
            *brush_lateral(rear_slip, rear_c, rear_limit),
        )


def _across(friction_n: float, along_n: float) -> float:
    left = friction_n * friction_n - along_n * along_n
    least = _LEAST_LATERAL * friction_n
    return sqrt(left) if left > least * least else least
