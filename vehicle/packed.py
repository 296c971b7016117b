"""The core in plain floats, for one pose or one state at a time.

What runs a hundred to a thousand times a second on a single state is too small for numpy: its calls
cost more than its sums. The array forms of `pose`, `motion` and `kalman` are the oracle that the
tests hold all of this to. A pose is the tuple (x, y, yaw); the state of the CTRV filter is that,
speed and yaw rate, what is wrong with the odometry (the relative error of its speed, the offset of
its yaw rate) and the error that GNSS fixes share, east and north. The last four are Gauss-Markov:
they wander within bounds, and return to zero where nothing shows them. The covariance is the tuple
of the 45 entries of the upper triangle, row by row.
"""

from __future__ import annotations

from math import cos, exp, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.kalman import innovate, joseph_update

Floats = NDArray[np.float64]
Pose = tuple[float, float, float]
Mean = tuple[float, float, float, float, float, float, float, float, float]
Upper = tuple[float, ...]

SIZE = 9
_ROWS, _COLUMNS = np.triu_indices(SIZE)
# where entry (i, j) stands in the upper triangle
_NUMBER = np.zeros((SIZE, SIZE), dtype=np.int64)
_NUMBER[_ROWS, _COLUMNS] = _NUMBER[_COLUMNS, _ROWS] = np.arange(len(_ROWS))
INDEX: tuple[tuple[int, ...], ...] = tuple(map(tuple, _NUMBER.tolist()))


class GaussMarkov(NamedTuple):
    """An error that wanders within bounds: its standard deviation, the time in which it forgets."""

    sd: float = 0.0
    time_s: float = 1.0


class CtrvNoise(NamedTuple):
    """Spectral densities of what CTRV lacks."""

    acceleration_m2ps3: float
    yaw_acceleration_rad2ps3: float
    slip_s5pm2: float  # sideways density: this times (speed x lateral acceleration) squared
    along_s: float = 0.0  # density along the path: this times the squared speed
    yaw_rad2ps: float = 0.0  # density of the yaw, while the car moves
    turn_s: float = 0.0  # density of the yaw: this times the squared yaw rate
    scale: GaussMarkov = GaussMarkov()  # the speed's relative error
    offset_radps: GaussMarkov = GaussMarkov()  # the yaw rate's offset
    fix_m: GaussMarkov = GaussMarkov()  # the error that fixes share, in each axis


def wrap(angle_rad: float) -> float:
    """To [-pi, pi)."""
    if -pi <= angle_rad < pi:
        return angle_rad
    return (angle_rad + pi) % (2.0 * pi) - pi


def as_mean(values: Floats) -> Mean:
    """The state `(9,)` as plain floats, the yaw wrapped."""
    x, y, yaw, v, w, scale, offset, fix_e, fix_n = values.tolist()
    return (x, y, wrap(yaw), v, w, scale, offset, fix_e, fix_n)


def pack(covariance: Floats) -> Upper:
    """Upper triangle of `(9, 9)`."""
    return tuple(covariance[_ROWS, _COLUMNS].tolist())


def unpack(upper: Upper) -> Floats:
    """`(9, 9)` from its upper triangle."""
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
    """A pose at constant speed and yaw rate, the yaw wrapped."""
    x, y, yaw = pose
    turn = yaw_rate_radps * dt_s
    slip = -slip_rad_per_mps2 * speed_mps * yaw_rate_radps
    east, north = arc_displacement(yaw, speed_mps * dt_s, turn, slip)
    return x + east, y + north, wrap(yaw + 0.5 * turn + 0.5 * turn)


def _arc_derivatives(yaw: float, v: float, w: float, dt_s: float, slip: float) -> tuple[float, ...]:
    """Half the turn, chord, cosine and sine of its way; d(x) and then d(y) by yaw, v and w."""
    half = 0.5 * w * dt_s
    h2 = half * half
    if h2 < 2.5e-3:
        ratio = 1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0 * (1.0 - h2 / 72.0)))
        slope = -half / 3.0 * (1.0 - h2 / 10.0 * (1.0 - h2 / 28.0 * (1.0 - h2 / 54.0)))
    else:
        ratio = sin(half) / half
        slope = (half * cos(half) - sin(half)) / h2
    way = yaw + half - slip * v * w
    c, s = cos(way), sin(way)
    length = v * dt_s
    chord = length * ratio
    a, b = -chord * s, dt_s * ratio * c + slip * w * chord * s
    d, e = chord * c, dt_s * ratio * s - slip * w * chord * c
    g = 0.5 * dt_s * (length * slope * c - chord * s) + slip * v * chord * s
    f = 0.5 * dt_s * (length * slope * s + chord * c) - slip * v * chord * c
    return half, chord, c, s, a, b, g, d, e, f


def _process_noise(v: float, w: float, dt_s: float, noise: CtrvNoise) -> tuple[float, ...]:
    """Covariances uu, uv, nn, ny, nw, yy, yw that white accelerations add along (u) and across (n)
    the path, to yaw, speed and yaw rate (y, v, w), and the drift of the yaw. The chains of
    integrals are exact on a straight, and positive semi-definite always.
    """
    qa, qw = noise.acceleration_m2ps3, noise.yaw_acceleration_rad2ps3
    dt2 = dt_s * dt_s
    dt3 = dt2 * dt_s
    v2 = v * v
    return (
        qa * dt3 / 3.0 + noise.along_s * v2 * dt_s,
        qa * dt2 / 2.0,
        qw * v2 * dt2 * dt3 / 20.0 + noise.slip_s5pm2 * (v2 * w) * (v2 * w) * dt_s,
        qw * v * dt2 * dt2 / 8.0,
        qw * v * dt3 / 6.0,
        qw * dt3 / 3.0,
        qw * dt2 / 2.0,
        (noise.yaw_rad2ps * min(v2, 1.0) + noise.turn_s * w * w) * dt_s,
    )


def ctrv_predict(
    mean: Mean, upper: Upper, dt_s: float, noise: CtrvNoise, slip: float = 0.0
) -> tuple[Mean, Upper]:
    """State and covariance after `dt_s` (not negative): `f(x)`, `F P F' + Q`.

    Args:
        slip: the rear axle goes in the direction yaw - slip v w: outward, as its tyres do in a
            bend, rad per m/s^2. Zero is plain CTRV.
    """
    x, y, yaw, v, w, scale, offset, fix_e, fix_n = mean
    # rows of the transition F: x by (yaw, v, w) is (a, b, g); y by the same is (d, e, f)
    half, chord, c, s, a, b, g, d, e, f = _arc_derivatives(yaw, v, w, dt_s, slip)
    p00, p01, p02, p03, p04, p05, p06, p07, p08 = upper[:9]
    p11, p12, p13, p14, p15, p16, p17, p18 = upper[9:17]
    p22, p23, p24, p25, p26, p27, p28 = upper[17:24]
    p33, p34, p35, p36, p37, p38 = upper[24:30]
    p44, p45, p46, p47, p48, p55, p56, p57, p58 = upper[30:39]
    p66, p67, p68, p77, p78, p88 = upper[39:]
    # what is kept of the Gauss-Markov errors
    i = exp(-dt_s / noise.scale.time_s)
    j = exp(-dt_s / noise.offset_radps.time_s)
    k = exp(-dt_s / noise.fix_m.time_s)
    fix_m2 = (1.0 - k * k) * noise.fix_m.sd * noise.fix_m.sd
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
    quu, quv, qnn, qny, qnw, qyy, qyw, drift = _process_noise(v, w, dt_s, noise)
    new = (
        r00 + a * r02 + b * r03 + g * r04 + c * c * quu + s * s * qnn,
        r01 + d * r02 + e * r03 + f * r04 + c * s * (quu - qnn),
        r02 + dt_s * r04 - s * qny,
        r03 + c * quv,
        r04 - s * qnw,
        i * (p05 + a * p25 + b * p35 + g * p45),
        j * (p06 + a * p26 + b * p36 + g * p46),
        k * (p07 + a * p27 + b * p37 + g * p47),
        k * (p08 + a * p28 + b * p38 + g * p48),
        r11 + d * r12 + e * r13 + f * r14 + s * s * quu + c * c * qnn,
        r12 + dt_s * r14 + c * qny,
        r13 + s * quv,
        r14 + c * qnw,
        i * (p15 + d * p25 + e * p35 + f * p45),
        j * (p16 + d * p26 + e * p36 + f * p46),
        k * (p17 + d * p27 + e * p37 + f * p47),
        k * (p18 + d * p28 + e * p38 + f * p48),
        r22 + dt_s * r24 + qyy + drift,
        r23,
        r24 + qyw,
        i * (p25 + dt_s * p45),
        j * (p26 + dt_s * p46),
        k * (p27 + dt_s * p47),
        k * (p28 + dt_s * p48),
        p33 + noise.acceleration_m2ps3 * dt_s,
        p34,
        i * p35,
        j * p36,
        k * p37,
        k * p38,
        p44 + noise.yaw_acceleration_rad2ps3 * dt_s,
        i * p45,
        j * p46,
        k * p47,
        k * p48,
        i * i * p55 + (1.0 - i * i) * noise.scale.sd * noise.scale.sd,
        i * j * p56,
        i * k * p57,
        i * k * p58,
        j * j * p66 + (1.0 - j * j) * noise.offset_radps.sd * noise.offset_radps.sd,
        j * k * p67,
        j * k * p68,
        k * k * p77 + fix_m2,
        k * k * p78,
        k * k * p88 + fix_m2,
    )
    ahead = (x + chord * c, y + chord * s, wrap(yaw + half + half), v, w)
    return (*ahead, i * scale, j * offset, k * fix_e, k * fix_n), new


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
    p0, p1, p2, p3, p4, p5, p6, p7, p8 = p
    k0, k1, k2, k3, k4, k5, k6, k7, k8 = [value / s for value in p]
    (
        u00, u01, u02, u03, u04, u05, u06, u07, u08, u11, u12, u13, u14, u15, u16, u17, u18, u22,
        u23, u24, u25, u26, u27, u28, u33, u34, u35, u36, u37, u38, u44, u45, u46, u47, u48, u55,
        u56, u57, u58, u66, u67, u68, u77, u78, u88,
    ) = upper  # fmt: skip
    # (I - k h') P (I - k h')' + k r k', with P h' = p and s = h p + r; written out, since this is
    # most of what a sample of odometry costs
    new = (
        u00 - k0 * p0 - p0 * k0 + k0 * k0 * s, u01 - k0 * p1 - p0 * k1 + k0 * k1 * s,
        u02 - k0 * p2 - p0 * k2 + k0 * k2 * s, u03 - k0 * p3 - p0 * k3 + k0 * k3 * s,
        u04 - k0 * p4 - p0 * k4 + k0 * k4 * s, u05 - k0 * p5 - p0 * k5 + k0 * k5 * s,
        u06 - k0 * p6 - p0 * k6 + k0 * k6 * s, u07 - k0 * p7 - p0 * k7 + k0 * k7 * s,
        u08 - k0 * p8 - p0 * k8 + k0 * k8 * s, u11 - k1 * p1 - p1 * k1 + k1 * k1 * s,
        u12 - k1 * p2 - p1 * k2 + k1 * k2 * s, u13 - k1 * p3 - p1 * k3 + k1 * k3 * s,
        u14 - k1 * p4 - p1 * k4 + k1 * k4 * s, u15 - k1 * p5 - p1 * k5 + k1 * k5 * s,
        u16 - k1 * p6 - p1 * k6 + k1 * k6 * s, u17 - k1 * p7 - p1 * k7 + k1 * k7 * s,
        u18 - k1 * p8 - p1 * k8 + k1 * k8 * s, u22 - k2 * p2 - p2 * k2 + k2 * k2 * s,
        u23 - k2 * p3 - p2 * k3 + k2 * k3 * s, u24 - k2 * p4 - p2 * k4 + k2 * k4 * s,
        u25 - k2 * p5 - p2 * k5 + k2 * k5 * s, u26 - k2 * p6 - p2 * k6 + k2 * k6 * s,
        u27 - k2 * p7 - p2 * k7 + k2 * k7 * s, u28 - k2 * p8 - p2 * k8 + k2 * k8 * s,
        u33 - k3 * p3 - p3 * k3 + k3 * k3 * s, u34 - k3 * p4 - p3 * k4 + k3 * k4 * s,
        u35 - k3 * p5 - p3 * k5 + k3 * k5 * s, u36 - k3 * p6 - p3 * k6 + k3 * k6 * s,
        u37 - k3 * p7 - p3 * k7 + k3 * k7 * s, u38 - k3 * p8 - p3 * k8 + k3 * k8 * s,
        u44 - k4 * p4 - p4 * k4 + k4 * k4 * s, u45 - k4 * p5 - p4 * k5 + k4 * k5 * s,
        u46 - k4 * p6 - p4 * k6 + k4 * k6 * s, u47 - k4 * p7 - p4 * k7 + k4 * k7 * s,
        u48 - k4 * p8 - p4 * k8 + k4 * k8 * s, u55 - k5 * p5 - p5 * k5 + k5 * k5 * s,
        u56 - k5 * p6 - p5 * k6 + k5 * k6 * s, u57 - k5 * p7 - p5 * k7 + k5 * k7 * s,
        u58 - k5 * p8 - p5 * k8 + k5 * k8 * s, u66 - k6 * p6 - p6 * k6 + k6 * k6 * s,
        u67 - k6 * p7 - p6 * k7 + k6 * k7 * s, u68 - k6 * p8 - p6 * k8 + k6 * k8 * s,
        u77 - k7 * p7 - p7 * k7 + k7 * k7 * s, u78 - k7 * p8 - p7 * k8 + k7 * k8 * s,
        u88 - k8 * p8 - p8 * k8 + k8 * k8 * s,
    )  # fmt: skip
    x, y, yaw, v, w, scale, offset, fix_e, fix_n = mean
    return (
        x + k0 * residual,
        y + k1 * residual,
        wrap(yaw + k2 * residual),
        v + k3 * residual,
        w + k4 * residual,
        scale + k5 * residual,
        offset + k6 * residual,
        fix_e + k7 * residual,
        fix_n + k8 * residual,
    ), new


def update_by_pair(
    mean: Mean,
    upper: Upper,
    row_one: Mean,
    row_two: Mean,
    residual_one: float,
    residual_two: float,
    variance: float,
) -> tuple[float, Mean, Upper]:
    """NIS of two measurements, and state and covariance after a Joseph update by both.

    Args:
        row_one, row_two: of the measurements' Jacobian.
        residual_one, residual_two: measured minus predicted.
        variance: of either.
    """
    covariance, jacobian = unpack(upper), np.array([row_one, row_two])
    noise = variance * np.eye(2)
    found = innovate(np.array([residual_one, residual_two]), covariance, jacobian, noise)
    after, updated = joseph_update(np.array(mean), covariance, found, jacobian, noise)
    return found.nis, as_mean(after), pack(updated)
