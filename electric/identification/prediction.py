"""What a car model expects of a log's gyro, accelerometer and side-slip reference.

The nonlinear single track is driven by steering and speed and hears the gyro and, where there is
one, the side-slip reference with a fixed gain, so that it stays with a car at its limits and
forgets within half a second what it could not know: what is left over is a prediction error
(L. Ljung, System Identification, 2nd ed., ch. 7). Without the reference's gain a model with a
little too little friction spins in a slide that the car holds, and a fit trades stiffness for that.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.electric.gaps import find_gaps
from polemap.electric.identification.parameters import Sensors
from polemap.electric.signals import SignalLog, shifted
from polemap.vehicle.axles import Axles
from polemap.vehicle.motion import sideslip_at
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import KINEMATIC_SPEED_MPS

Floats = NDArray[np.float64]

# the fastest rows that a fit needs: lateral motion of a car ends at some 5 Hz
STEP_S = 0.01
HEARD_HZ = 2.0
"""Gain with which a prediction follows gyro and side-slip reference."""
# slower than this the reference is mostly noise of a speed over a speed
_REFERENCE_SPEED_MPS = 3.0


@dataclass(frozen=True, slots=True)
class Rows:
    """A stretch of a log without gaps, averaged down to `STEP_S`; arrays `(n,)`.

    `ay_mps2` and `sideslip_rad` are None where the log does not have them.
    """

    stamp_s: Floats
    steering_rad: Floats
    speed_mps: Floats
    ax_mps2: Floats
    yaw_rate_radps: Floats
    ay_mps2: Floats | None
    sideslip_rad: Floats | None


def rows_of(log: SignalLog) -> list[Rows]:
    """The stretches of a log between its gaps, those of less than two seconds left out."""
    bounds = [float("-inf"), *(gap.to_s for gap in find_gaps(log)), float("inf")]
    found = []
    for start, end in itertools.pairwise(bounds):
        inside = (log.stamp_s >= start) & (log.stamp_s < end)
        if inside.sum() < 3 or np.ptp(log.stamp_s[inside]) < 2.0:
            continue
        found.append(_averaged(log.between(start, end)))
    return found


def _averaged(log: SignalLog) -> Rows:
    every = max(1, round(STEP_S / float(np.median(np.diff(log.stamp_s)))))
    count = len(log) // every

    def mean(values: Floats) -> Floats:
        return np.asarray(values[: count * every].reshape(count, every).mean(axis=1))

    def optional(name: str) -> Floats | None:
        return mean(log.columns[name]) if log.has(name) else None

    return Rows(
        mean(log.stamp_s),
        mean(log.held("road_wheel_angle_rad")),
        mean(log.held("vx_mps")),
        mean(_accelerations(log)),
        mean(log.held("yaw_rate_radps")),
        optional("ay_mps2"),
        optional("sideslip_rad"),
    )


def _accelerations(log: SignalLog) -> Floats:
    """Longitudinal acceleration without vibration, a mean over 0.1 s; else from the speed."""
    if log.has("ax_mps2"):
        values = log.held("ax_mps2")
    else:
        values = np.gradient(log.held("vx_mps"), log.stamp_s)
    width = max(1, round(0.1 / float(np.median(np.diff(log.stamp_s)))))
    total = np.concatenate([[0.0], np.cumsum(values)])
    first = np.maximum(np.arange(len(values)) - width + 1, 0)
    after = np.arange(len(values)) + 1
    return np.asarray((total[after] - total[first]) / (after - first))


@dataclass(frozen=True, slots=True)
class Predicted:
    """Expected before a row's gyro and reference are heard, each `(n,)`.

    Attributes:
        tyres: `(n, 3)` sizes of both axles' forces together, N; slopes of front and rear, N/rad.
    """

    sideslip_rad: Floats
    yaw_rate_radps: Floats
    ay_mps2: Floats
    tyres: Floats


def predict_rows(
    car: Car, sensors: Sensors, rows: Rows, *, hear_reference: bool = True
) -> Predicted:
    """What a car and its sensors make of steering and speed.

    The step is the linearly implicit midpoint rule: stable where the tyres are stiff at low speed.

    Args:
        hear_reference: whether the side-slip reference is followed where the rows have it.
    """
    axles = Axles(car)
    delayed = shifted(rows.stamp_s, rows.steering_rad, car.steering_delay_s)
    steering = ((delayed - car.steering_offset_rad) * car.steering_scale).tolist()
    speed = shifted(rows.stamp_s, rows.speed_mps, -sensors.speed_delay_s)
    speeds = np.maximum(speed, KINEMATIC_SPEED_MPS).tolist()
    gyro = (rows.yaw_rate_radps - sensors.gyro_offset_radps).tolist()
    ax = rows.ax_mps2.tolist()
    point, turned = car.sideslip_point_m, sensors.sideslip_offset_rad
    reference = [float("nan")] * len(speeds)
    if hear_reference and rows.sideslip_rad is not None:
        early = -sensors.sideslip_delay_s
        reference = shifted(rows.stamp_s, rows.sideslip_rad, early).tolist()
    steps = np.diff(rows.stamp_s, append=2.0 * rows.stamp_s[-1] - rows.stamp_s[-2]).tolist()
    m, inertia = car.mass_kg, car.yaw_inertia_kgm2
    lf, lr = car.cg_to_front_m, car.cg_to_rear_m
    beta, gamma = lr * gyro[0] / speeds[0], gyro[0]
    out, tyres = np.empty((len(steps), 4)), np.empty((len(steps), 3))
    driven = zip(steps, steering, speeds, ax, gyro, reference, strict=True)
    for k, (t, delta, v, a, seen, slip_seen) in enumerate(driven):
        front, front_slope, rear, rear_slope = axles.forces(beta, gamma, delta, v, axles.limits(a))
        beta_rate = (front + rear) / (m * v) - gamma - beta * a / v
        gamma_rate = (lf * front - lr * rear) / inertia
        out[k] = beta, gamma, (front + rear) / m, gamma_rate
        tyres[k] = abs(front) + abs(rear), front_slope, rear_slope
        h = 0.5 * t
        a00 = 1.0 - h * ((front_slope + rear_slope) / (m * v) - a / v)
        a01 = -h * ((lf * front_slope - lr * rear_slope) / (m * v * v) - 1.0)
        a10 = -h * (lf * front_slope - lr * rear_slope) / inertia
        a11 = 1.0 - h * (lf * lf * front_slope + lr * lr * rear_slope) / (inertia * v)
        inverse = t / (a00 * a11 - a01 * a10)
        gain = HEARD_HZ * t if t < 0.4 else 0.8
        heard, slid = seen - gamma, slip_seen - turned - beta - point * gamma / v
        beta += inverse * (a11 * beta_rate - a01 * gamma_rate)
        gamma += inverse * (a00 * gamma_rate - a10 * beta_rate)
        gamma += gain * heard
        if v > _REFERENCE_SPEED_MPS and slid == slid:
            beta += gain * slid
        beta = min(max(beta, -1.0), 1.0)
    slip = sideslip_at(out[:, 0], out[:, 1], np.asarray(speeds), car.sideslip_point_m)
    lateral = sensors.ay_scale * (out[:, 2] + sensors.ay_point_m * out[:, 3])
    slip = shifted(rows.stamp_s, np.asarray(slip), sensors.sideslip_delay_s)
    lateral = shifted(rows.stamp_s, np.asarray(lateral), sensors.ay_delay_s)
    return Predicted(
        np.asarray(slip + sensors.sideslip_offset_rad),
        np.asarray(out[:, 1] + sensors.gyro_offset_radps),
        np.asarray(lateral + sensors.ay_offset_mps2),
        tyres,
    )
