"""The CTRV EKF's two hot steps in plain floats.

A 5x5 filter is too small for numpy: its calls cost more than its sums. The covariance is the
tuple of the 15 entries of its upper triangle, row by row; the tests hold these functions to
`vehicle.motion` and `vehicle.kalman` to 1e-12.
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mean = tuple[float, float, float, float, float]
Upper = tuple[float, ...]

_ROWS, _COLUMNS = np.triu_indices(5)
# where entry (i, j) stands in the upper triangle
INDEX = tuple(
    tuple(
        next(k for k in range(15) if (_ROWS[k], _COLUMNS[k]) == (min(i, j), max(i, j)))
        for j in range(5)
    )
    for i in range(5)
)
_PAIRS = tuple((int(i), int(j)) for i, j in zip(_ROWS, _COLUMNS, strict=True))


class Noise(NamedTuple):
    """Densities of the process noise; see `vehicle.motion.ctrv_process_noise`."""

    acceleration_m2ps3: float
    yaw_acceleration_rad2ps3: float
    slip_s: float  # the sideways density is this times the squared speed


def wrap(angle_rad: float) -> float:
    """To [-pi, pi)."""
    if -pi <= angle_rad < pi:
        return angle_rad
    return (angle_rad + pi) % (2.0 * pi) - pi


def pack(covariance: Floats) -> Upper:
    """Upper triangle of `(5, 5)`."""
    return tuple(covariance[_ROWS, _COLUMNS].tolist())


def unpack(upper: Upper) -> Floats:
    """`(5, 5)` from its upper triangle."""
    full = np.empty((5, 5))
    full[_ROWS, _COLUMNS] = upper
    full[_COLUMNS, _ROWS] = upper
    return full


def step(mean: Mean, dt_s: float) -> Mean:
    """`vehicle.motion.ctrv_step` of one state."""
    x, y, yaw, v, w = mean
    half = 0.5 * w * dt_s
    ratio = sin(half) / half if abs(half) > 1e-9 else 1.0
    chord = v * dt_s * ratio
    heading = yaw + half
    return (x + chord * cos(heading), y + chord * sin(heading), wrap(heading + half), v, w)


def predict(mean: Mean, upper: Upper, dt_s: float, noise: Noise) -> tuple[Mean, Upper]:
    """State and covariance after `dt_s` (not negative): `f(x)`, `F P F' + Q`."""
    x, y, yaw, v, w = mean
    half = 0.5 * w * dt_s
    h2 = half * half
    if h2 < 2.5e-3:
        ratio = 1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0 * (1.0 - h2 / 72.0)))
        slope = -half / 3.0 * (1.0 - h2 / 10.0 * (1.0 - h2 / 28.0 * (1.0 - h2 / 54.0)))
    else:
        ratio = sin(half) / half
        slope = (half * cos(half) - sin(half)) / h2
    heading = yaw + half
    c, s = cos(heading), sin(heading)
    length = v * dt_s
    chord = length * ratio
    # rows of the transition F: x by (yaw, v, w) is (a, b, g); y by the same is (d, e, f)
    a, b = -chord * s, dt_s * ratio * c
    d, e = chord * c, dt_s * ratio * s
    g = 0.5 * dt_s * (length * slope * c - chord * s)
    f = 0.5 * dt_s * (length * slope * s + chord * c)
    p00, p01, p02, p03, p04, p11, p12, p13, p14, p22, p23, p24, p33, p34, p44 = upper
    r00 = p00 + a * p02 + b * p03 + g * p04
    r01 = p01 + a * p12 + b * p13 + g * p14
    r02 = p02 + a * p22 + b * p23 + g * p24
    r03 = p03 + a * p23 + b * p33 + g * p34
    r04 = p04 + a * p24 + b * p34 + g * p44
    r11 = p11 + d * p12 + e * p13 + f * p14
    r12 = p12 + d * p22 + e * p23 + f * p24
    r13 = p13 + d * p23 + e * p33 + f * p34
    r14 = p14 + d * p24 + e * p34 + f * p44
    r22 = p22 + dt_s * p24
    r23 = p23 + dt_s * p34
    r24 = p24 + dt_s * p44
    # process noise along (u) and across (n) the path, as in vehicle.motion
    qa, qw = noise.acceleration_m2ps3, noise.yaw_acceleration_rad2ps3
    dt2 = dt_s * dt_s
    dt3 = dt2 * dt_s
    quu, quv = qa * dt3 / 3.0, qa * dt2 / 2.0
    qnn = qw * v * v * dt2 * dt3 / 20.0 + noise.slip_s * v * v * dt_s
    qny, qnw = qw * v * dt2 * dt2 / 8.0, qw * v * dt3 / 6.0
    new = (
        r00 + a * r02 + b * r03 + g * r04 + c * c * quu + s * s * qnn,
        r01 + d * r02 + e * r03 + f * r04 + c * s * (quu - qnn),
        r02 + dt_s * r04 - s * qny,
        r03 + c * quv,
        r04 - s * qnw,
        r11 + d * r12 + e * r13 + f * r14 + s * s * quu + c * c * qnn,
        r12 + dt_s * r14 + c * qny,
        r13 + s * quv,
        r14 + c * qnw,
        r22 + dt_s * r24 + qw * dt3 / 3.0,
        r23,
        r24 + qw * dt2 / 2.0,
        p33 + qa * dt_s,
        p34,
        p44 + qw * dt_s,
    )
    return (x + chord * c, y + chord * s, wrap(heading + half), v, w), new


def update_entry(
    mean: Mean, upper: Upper, entry: int, residual: float, variance: float
) -> tuple[Mean, Upper]:
    """Joseph update by a measurement of one entry of the state, with its `variance`.

    Measurements whose noises are independent may follow one another: it equals taking them at
    once, the residual of the second being formed after the first.
    """
    row = INDEX[entry]
    p = (upper[row[0]], upper[row[1]], upper[row[2]], upper[row[3]], upper[row[4]])
    s = p[entry] + variance
    k = (p[0] / s, p[1] / s, p[2] / s, p[3] / s, p[4] / s)
    # (I - k h') P (I - k h')' + k r k', written out for an h that picks one entry
    new = tuple(
        [
            value - k[i] * p[j] - p[i] * k[j] + k[i] * k[j] * s
            for (i, j), value in zip(_PAIRS, upper, strict=False)
        ]
    )
    return (
        mean[0] + k[0] * residual,
        mean[1] + k[1] * residual,
        wrap(mean[2] + k[2] * residual),
        mean[3] + k[3] * residual,
        mean[4] + k[4] * residual,
    ), new
