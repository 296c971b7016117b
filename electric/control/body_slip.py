"""Body-slip control with two degrees of freedom: DC-gain feed-forward and a PI by pole placement.

The only actuator is the yaw moment of the rear in-wheel motors (W14, V).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.errors import VehicleError
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import KINEMATIC_SPEED_MPS

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PiGains:
    """Proportional and integral gain from side-slip error to yaw moment."""

    proportional_nm_per_rad: float
    integral_nm_per_rads: float


def feed_forward_gain(a: Floats, b: Floats) -> float:
    """Yaw moment per steering angle that cancels the steady side-slip, N m / rad.

    `-G_delta(0) / G_N(0)`, from the model `(2, 2)` matrices; W14 (24) with the sign of errata.md.
    """
    gains = np.linalg.solve(-a, b)[0]
    return float(-gains[0] / gains[1])


class FeedForwardSchedule:
    """`feed_forward_gain` at any speed, in closed form.

    (4 lr l Cf Cr - 2 lf Cf m V^2) / (m V^2 + 2 (lf Cf - lr Cr)), C a tyre. Where the
    denominator vanishes the moment does not move the steady side-slip; below the kinematic limit
    that speed's gain holds.

    Source: W14 (24) with errata.md, Body-slip control.
    """

    def __init__(self, car: Car) -> None:
        self._car = car

    def __call__(self, speed_mps: float) -> float:
        c, v = self._car, max(abs(speed_mps), KINEMATIC_SPEED_MPS)
        lf, lr = c.cg_to_front_m, c.cg_to_rear_m
        cf, cr, inertia = c.front_stiffness_nprad, c.rear_stiffness_nprad, c.mass_kg * v * v
        above = 4.0 * lr * (lf + lr) * cf * cr - 2.0 * lf * cf * inertia
        below = inertia + 2.0 * (lf * cf - lr * cr)
        return above / below if below else 0.0


def place_pi(a: Floats, b: Floats, pole_radps: float) -> PiGains:
    """PI that puts two closed-loop poles at -pole_radps.

    From the yaw moment the side-slip is n0 / (s^2 + a1 s + a0) with n0 = a12 b22. With a PI the
    closed loop is s^3 + a1 s^2 + (a0 + n0 kp) s + n0 ki: the sum of the poles is fixed at -a1, so
    two may be chosen and the third falls at -(a1 - 2 p).

    Raises:
        VehicleError: the third pole would be unstable (p >= a1 / 2). The three poles at -2 Hz of
            W14's Table II are such a case above 14.5 km/h.
    """
    a1, a0 = float(-np.trace(a)), float(np.linalg.det(a))
    n0 = float(a[0, 1] * b[1, 1])
    third = a1 - 2.0 * pole_radps
    if pole_radps <= 0 or third <= 0:
        raise VehicleError(
            f"two poles at -{pole_radps:.3g} rad/s leave the third at {-third:.3g}; choose less "
            f"than {a1 / 2:.3g} rad/s"
        )
    kp = (pole_radps**2 + 2.0 * pole_radps * third - a0) / n0
    ki = pole_radps**2 * third / n0
    return PiGains(kp, ki)


class BodySlipController:
    """Yaw moment that keeps the side-slip at its reference; anti-windup by back-calculation."""

    def __init__(
        self, feed_forward: float | FeedForwardSchedule, gains: PiGains, limit_nm: float
    ) -> None:
        if limit_nm <= 0:
            raise VehicleError(f"yaw moment limit is {limit_nm} N m, it must be positive")
        self._feed_forward = feed_forward
        self._gains = gains
        self._limit_nm = limit_nm
        self._integral_nm = 0.0

    def step(
        self, steer_rad: float, error_rad: float, dt_s: float, speed_mps: float | None = None
    ) -> float:
        """Yaw moment in N m for the side-slip error (reference minus estimate).

        A feed-forward that is scheduled needs the speed of now.

        Raises:
            VehicleError: it is not given.
        """
        g, forward = self._gains, self._feed_forward
        if isinstance(forward, FeedForwardSchedule):
            if speed_mps is None:
                raise VehicleError("a scheduled feed-forward needs the speed of each step")
            forward = forward(speed_mps)
        direct = forward * steer_rad + g.proportional_nm_per_rad * error_rad
        self._integral_nm += g.integral_nm_per_rads * error_rad * dt_s
        wanted = direct + self._integral_nm
        moment = max(-self._limit_nm, min(self._limit_nm, wanted))
        if moment != wanted:
            # the integral gives back what the motors cannot deliver, but never changes sign by it
            held = self._integral_nm + (moment - wanted)
            self._integral_nm = held if held * self._integral_nm > 0 else 0.0
        return moment


def distribute_torque(
    yaw_moment_nm: float,
    acceleration_mps2: float,
    *,
    mass_kg: float,
    radius_m: float,
    rear_track_m: float,
    torque_limit_nm: float,
) -> tuple[float, float]:
    """Left and right rear motor torque; the yaw moment goes before the acceleration.

    T = m r a / 2 -+ r N / d; the largest moment is d T / r (W14 (3) with the sign of errata.md).
    """
    turn = radius_m * yaw_moment_nm / rear_track_m
    turn = max(-torque_limit_nm, min(torque_limit_nm, turn))
    room = torque_limit_nm - abs(turn)
    drive = max(-room, min(room, mass_kg * radius_m * acceleration_mps2 / 2.0))
    return drive - turn, drive + turn
