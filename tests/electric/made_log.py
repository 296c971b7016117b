"""A signal log made of formulas: gentle bends, gas and brake, as a linear car drives them."""

from __future__ import annotations

import numpy as np

from polemap.electric.signals import SignalLog
from polemap.vehicle.parameters import Car


def made_log(car: Car, duration_s: float = 60.0) -> SignalLog:
    """100 Hz, all fast signals, GPS course and speed, side-slip and lateral speed."""
    t = 5.0 + 0.01 * np.arange(round(duration_s / 0.01))
    speed = 12.0 + 3.0 * np.sin(2 * np.pi * t / 19.0)
    rate = 0.15 * np.sin(2 * np.pi * t / 11.0)
    slip = rate * car.cg_to_rear_m / speed - 0.004 * rate * speed / 3.0
    wheel = car.wheelbase_m * rate / speed + 0.003 * rate * speed
    heading = np.cumsum(rate) * 0.01
    return SignalLog(
        t,
        {
            "road_wheel_angle_rad": wheel,
            "yaw_rate_radps": rate,
            "ax_mps2": np.gradient(speed, t),
            "ay_mps2": speed * rate,
            "vx_mps": speed,
            "speed_mps": speed,
            "course_rad": heading + slip,
            "sideslip_rad": slip,
            "vy_mps": speed * slip,
        },
    )
