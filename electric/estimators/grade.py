"""Grade of the road, from what the accelerometer feels beyond what the wheels gain."""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.axles import GRAVITY_MPS2

Floats = NDArray[np.float64]

# roads rise by 5 % one sigma, for some hundred metres
GRADE_SD_RAD, GRADE_TIME_S = 0.05, 20.0
# bias of the accelerometer with its mounting, 0.6 degrees: a grade that never changes is not told
# from it, and the grade's deviation stays as large
AX_BIAS_SD_MPS2, AX_BIAS_TIME_S = 0.1, 1000.0
# the body's pitch as a share of what it feels, and noise of the accelerometer integrated over 1 s
_PITCH_SHARE, _AX_WALK_MPS = 0.04, 0.05
# wheels: slip of driven wheels and a rolling radius that is not known, as a share of the speed
_WHEEL_SD_MPS, _WHEEL_SHARE = 0.05, 0.002
_LOOK_S = 0.1
_OUTLIER_SD = 4.0


class GradeKalman:
    """Kalman filter `[v, theta, b]` of speed, grade and bias of the longitudinal accelerometer.

    v' = a_x + gamma v_y - g theta - b, measured by the wheels ten times a second. Without an
    accelerometer (one that has never said other than 0) nothing is told and the deviation stays.
    """

    def __init__(self) -> None:
        self._x = np.zeros(3)
        self._p = np.diag([1.0, GRADE_SD_RAD**2, AX_BIAS_SD_MPS2**2])
        self._started = self._heard = False
        self._gained = self._felt = self._elapsed = 0.0
        self._g = np.eye(3)

    def step(self, t: float, ax_mps2: float, across_mps2: float, wheel_mps: float) -> None:
        """Over `t` seconds ax was felt, and yaw rate times lateral speed was `across_mps2`."""
        self._elapsed += t
        self._gained += t * (ax_mps2 + across_mps2)
        self._felt += t * abs(ax_mps2)
        if self._elapsed >= _LOOK_S:
            self._look(wheel_mps)

    def _look(self, wheel_mps: float) -> None:
        t, gained, felt = self._elapsed, self._gained, self._felt
        self._elapsed = self._gained = self._felt = 0.0
        self._heard = self._heard or felt > 0.0
        if not self._heard:
            return
        x, p, g = self._x, self._p, self._g
        if not self._started:
            self._started, x[0] = True, wheel_mps
        rise, bias = exp(-t / GRADE_TIME_S), exp(-t / AX_BIAS_TIME_S)
        g[0, 1], g[0, 2], g[1, 1], g[2, 2] = -GRAVITY_MPS2 * t, -t, rise, bias
        x = g @ x
        x[0] += gained
        p = g @ p @ g.T
        p[0, 0] += _AX_WALK_MPS**2 * t + (_PITCH_SHARE * felt) ** 2
        p[1, 1] += GRADE_SD_RAD**2 * (1.0 - rise * rise)
        p[2, 2] += AX_BIAS_SD_MPS2**2 * (1.0 - bias * bias)
        residual = wheel_mps - x[0]
        s = p[0, 0] + _WHEEL_SD_MPS**2 + (_WHEEL_SHARE * wheel_mps) ** 2
        if residual * residual > _OUTLIER_SD**2 * s:
            # wheels that spin or lock are weighed down as Huber has it
            s = abs(residual) * float(np.sqrt(s)) / _OUTLIER_SD
        gain = p[:, 0] / s
        self._x, self._p = x + gain * residual, p - np.outer(gain, p[0])

    @property
    def grade_rad(self) -> float:
        """Uphill positive."""
        return float(self._x[1])

    @property
    def variance(self) -> float:
        """Of the grade, rad^2."""
        return float(self._p[1, 1])
