"""The core in plain floats, for one pose or one state at a time.

What runs a hundred to a thousand times a second on a single state is too small for numpy: its calls
cost more than its sums. The array forms of `pose`, `motion` and `kalman` are the oracle that the
tests hold all of this to. A pose is the tuple (x, y, yaw); the state of the CTRV filter is that,
speed and yaw rate, and what is wrong with the odometry: the relative error of its speed and the
offset of its yaw rate, both wandering slowly. Its covariance is the tuple of the 28 entries of the
upper triangle, row by row.
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Pose = tuple[float, float, float]
Mean = tuple[float, float, float, float, float, float, float]
Upper = tuple[float, ...]

SIZE = 7
_ROWS, _COLUMNS = np.triu_indices(SIZE)
# where entry (i, j) stands in the upper triangle
INDEX = tuple(
    tuple(
        next(k for k in range(len(_ROWS)) if (_ROWS[k], _COLUMNS[k]) == (min(i, j), max(i, j)))
        for j in range(SIZE)
    )
    for i in range(SIZE)
)
_PAIRS = tuple((int(i), int(j)) for i, j in zip(_ROWS, _COLUMNS, strict=True))


class CtrvNoise(NamedTuple):
    """Densities of the process noise; see `motion.ctrv_process_noise`."""

    acceleration_m2ps3: float
    yaw_acceleration_rad2ps3: float
    slip_s5pm2: float  # sideways density: this times (speed x lateral acceleration) squared
    along_s: float = 0.0  # density along the path: this times the squared speed
    yaw_rad2ps: float = 0.0  # density of the yaw, while the car moves
    scale_1ps: float = 0.0  # of the walk of the speed's relative error
    offset_rad2ps3: float = 0.0  # of the walk of the yaw rate's offset


def wrap(angle_rad: float) -> float:
    """To [-pi, pi)."""
    if -pi <= angle_rad < pi:
        return angle_rad
    return (angle_rad + pi) % (2.0 * pi) - pi


def as_mean(values: Floats) -> Mean:
    """The state `(7,)` as plain floats, the yaw wrapped."""
    x, y, yaw, v, w, scale, offset = values.tolist()
    return (x, y, wrap(yaw), v, w, scale, offset)


def pack(covariance: Floats) -> Upper:
    """Upper triangle of `(7, 7)`."""
    return tuple(covariance[_ROWS, _COLUMNS].tolist())


def unpack(upper: Upper) -> Floats:
    """`(7, 7)` from its upper triangle."""
    full = np.empty((SIZE, SIZE))
    full[_ROWS, _COLUMNS] = upper
    full[_COLUMNS, _ROWS] = upper
    return full


def rotate(x: float, y: float, yaw_rad: float) -> tuple[float, float]:
    """A vector of a frame turned by the yaw, in the axes it is turned from (`pose.rotate`)."""
    c, s = cos(yaw_rad), sin(yaw_rad)
    return c * x - s * y, s * x + c * y


def rotate_back(x: float, y: float, yaw_rad: float) -> tuple[float, float]:
    """The inverse of `rotate`: a difference along and across a heading (`pose.rotate_back`)."""
    c, s = cos(yaw_rad), sin(yaw_rad)
    return c * x + s * y, -s * x + c * y


def transform_point(map_from_vehicle: Pose, x_m: float, y_m: float) -> tuple[float, float]:
    """A point of the vehicle frame in the map (`pose.transform_points`)."""
    x, y, yaw = map_from_vehicle
    c, s = cos(yaw), sin(yaw)
    return x + c * x_m - s * y_m, y + s * x_m + c * y_m


def compose(map_from_a: Pose, a_from_b: Pose) -> Pose:
    """`map_from_b`, the yaw wrapped (`pose.compose`)."""
    x, y = transform_point(map_from_a, a_from_b[0], a_from_b[1])
    return x, y, wrap(map_from_a[2] + a_from_b[2])


def inverse(map_from_vehicle: Pose) -> Pose:
    """`vehicle_from_map`, the yaw wrapped (`pose.inverse`)."""
    x, y = rotate_back(map_from_vehicle[0], map_from_vehicle[1], map_from_vehicle[2])
    return -x, -y, wrap(-map_from_vehicle[2])


def arc_displacement(
    yaw_rad: float, distance_m: float, turn_rad: float, sideslip_rad: float = 0.0
) -> tuple[float, float]:
    """How far an arc that starts at a yaw leads east and north (`motion.arc_displacement`)."""
    half = 0.5 * turn_rad
    chord = distance_m * (sin(half) / half if abs(half) > 1e-8 else 1.0)
    way = yaw_rad + half + sideslip_rad
    return chord * cos(way), chord * sin(way)


def ctrv_step(
    pose: Pose, speed_mps: float, yaw_rate_radps: float, dt_s: float, slip_rad_per_mps2: float = 0.0
) -> Pose:
    """A pose at constant speed and yaw rate (`motion.ctrv_step`), the yaw wrapped."""
    x, y, yaw = pose
    turn = yaw_rate_radps * dt_s
    slip = -slip_rad_per_mps2 * speed_mps * yaw_rate_radps
    east, north = arc_displacement(yaw, speed_mps * dt_s, turn, slip)
    return x + east, y + north, wrap(yaw + 0.5 * turn + 0.5 * turn)


def ctrv_predict(
    mean: Mean, upper: Upper, dt_s: float, noise: CtrvNoise, slip: float = 0.0
) -> tuple[Mean, Upper]:
    """State and covariance after `dt_s` (not negative): `f(x)`, `F P F' + Q`.

    Args:
        slip: the rear axle goes in the direction yaw - slip v w: outward, as its tyres do in a
            bend, rad per m/s^2. Zero is plain CTRV.
    """
    x, y, yaw, v, w, scale, offset = mean
    half = 0.5 * w * dt_s
    h2 = half * half
    if h2 < 2.5e-3:
        ratio = 1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0 * (1.0 - h2 / 72.0)))
        slope = -half / 3.0 * (1.0 - h2 / 10.0 * (1.0 - h2 / 28.0 * (1.0 - h2 / 54.0)))
    else:
        ratio = sin(half) / half
        slope = (half * cos(half) - sin(half)) / h2
    heading = yaw + half
    way = heading - slip * v * w
    c, s = cos(way), sin(way)
    length = v * dt_s
    chord = length * ratio
    # rows of the transition F: x by (yaw, v, w) is (a, b, g); y by the same is (d, e, f)
    a, b = -chord * s, dt_s * ratio * c + slip * w * chord * s
    d, e = chord * c, dt_s * ratio * s - slip * w * chord * c
    g = 0.5 * dt_s * (length * slope * c - chord * s) + slip * v * chord * s
    f = 0.5 * dt_s * (length * slope * s + chord * c) - slip * v * chord * c
    p00, p01, p02, p03, p04, p05, p06 = upper[:7]
    p11, p12, p13, p14, p15, p16 = upper[7:13]
    p22, p23, p24, p25, p26 = upper[13:18]
    p33, p34, p35, p36, p44, p45, p46, p55, p56, p66 = upper[18:]
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
    # process noise along (u) and across (n) the path, as in `motion`
    qa, qw = noise.acceleration_m2ps3, noise.yaw_acceleration_rad2ps3
    dt2 = dt_s * dt_s
    dt3 = dt2 * dt_s
    v2 = v * v
    quu, quv = qa * dt3 / 3.0 + noise.along_s * v2 * dt_s, qa * dt2 / 2.0
    bend = v2 * w
    qnn = qw * v2 * dt2 * dt3 / 20.0 + noise.slip_s5pm2 * bend * bend * dt_s
    qny, qnw = qw * v * dt2 * dt2 / 8.0, qw * v * dt3 / 6.0
    new = (
        r00 + a * r02 + b * r03 + g * r04 + c * c * quu + s * s * qnn,
        r01 + d * r02 + e * r03 + f * r04 + c * s * (quu - qnn),
        r02 + dt_s * r04 - s * qny,
        r03 + c * quv,
        r04 - s * qnw,
        p05 + a * p25 + b * p35 + g * p45,
        p06 + a * p26 + b * p36 + g * p46,
        r11 + d * r12 + e * r13 + f * r14 + s * s * quu + c * c * qnn,
        r12 + dt_s * r14 + c * qny,
        r13 + s * quv,
        r14 + c * qnw,
        p15 + d * p25 + e * p35 + f * p45,
        p16 + d * p26 + e * p36 + f * p46,
        r22 + dt_s * r24 + qw * dt3 / 3.0 + noise.yaw_rad2ps * min(v2, 1.0) * dt_s,
        r23,
        r24 + qw * dt2 / 2.0,
        p25 + dt_s * p45,
        p26 + dt_s * p46,
        p33 + qa * dt_s,
        p34,
        p35,
        p36,
        p44 + qw * dt_s,
        p45,
        p46,
        p55 + noise.scale_1ps * dt_s,
        p56,
        p66 + noise.offset_rad2ps3 * dt_s,
    )
    return (x + chord * c, y + chord * s, wrap(heading + half), v, w, scale, offset), new


def update_by_two(
    mean: Mean,
    upper: Upper,
    row: tuple[int, float, int, float],
    residual: float,
    variance: float,
) -> tuple[Mean, Upper]:
    """Joseph update by a scalar that sees two entries of the state.

    Args:
        row: `(i, h_i, j, h_j)`, the two entries of the measurement's Jacobian that are not zero.
        residual: measured minus predicted.
        variance: of the measurement.

    Measurements whose noises are independent may follow one another: it equals taking them at
    once, the residual of the second being formed after the first.
    """
    first, h_first, second, h_second = row
    one, two = INDEX[first], INDEX[second]
    p = [h_first * upper[m] + h_second * upper[n] for m, n in zip(one, two, strict=False)]
    s = h_first * p[first] + h_second * p[second] + variance
    k0, k1, k2, k3, k4, k5, k6 = k = [value / s for value in p]
    # (I - k h') P (I - k h')' + k r k', with P h' = p and s = h p + r
    new = tuple(
        [
            value - k[i] * p[j] - p[i] * k[j] + k[i] * k[j] * s
            for (i, j), value in zip(_PAIRS, upper, strict=False)
        ]
    )
    x, y, yaw, v, w, scale, offset = mean
    return (
        x + k0 * residual,
        y + k1 * residual,
        wrap(yaw + k2 * residual),
        v + k3 * residual,
        w + k4 * residual,
        scale + k5 * residual,
        offset + k6 * residual,
    ), new
