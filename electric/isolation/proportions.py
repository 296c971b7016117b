"""Scale and lateness of sensors in bends: the same turns, larger, smaller or later.

Offsets of gyro, steering, bank and bias hide a scale in the mean of a window. In the heading that
each sensor integrates to, without its straight line, they are gone: what is left of the others is
regressed on the gyro's and its rate, h_i = g_i h + tau_i h' + a + b t. The slope is a scale and
tau / g how much earlier the sensor turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import log

import numpy as np
from numpy.typing import NDArray

from polemap.electric.isolation.alone import GYRO, LATERAL, STEERING
from polemap.electric.isolation.families import GPS
from polemap.electric.isolation.late import Event
from polemap.electric.isolation.motion import Moment
from polemap.electric.isolation.votes import Vote
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]

SPAN_S = 3.0
# the heading must leave its straight line by so much (rms), what is not explained be a small share
_LEAST_RAD, _UNLIKE = 0.03, 0.15
# logarithms of scales: gyro; roll and changing bank; car file and tyres; side-slip in a course
_GAIN = {GYRO: 0.04, LATERAL: 0.15, STEERING: 0.2, GPS: 0.12}
# seconds: tyres and steering answer with a lag that a car file tells roughly
_LAG_S = {GYRO: 0.03, LATERAL: 0.15, STEERING: 0.15, GPS: 0.1}
# roll, bank and side-slip beside the turn, rad of heading: their share of the signal widens both
_BESIDE = {GYRO: 0.001, LATERAL: 0.004, STEERING: 0.002, GPS: 0.005}


def _shape(times: Floats, headings: Floats) -> Floats:
    """Without its straight line."""
    return np.asarray(headings - np.polyval(np.polyfit(times, headings, 1), times))


def proportions(
    car: Car, moments: Sequence[Moment], heard: set[str], fixes: Sequence[Event]
) -> tuple[dict[str, Vote], dict[str, Vote]]:
    """Logarithms of scales and leads in seconds; empty where the turns tell none.

    Args:
        moments: of the last `SPAN_S`, in order.
        heard: sensors that have spoken.
        fixes: of the GPS within the same time.
    """
    nothing: tuple[dict[str, Vote], dict[str, Vote]] = {}, {}
    if GYRO not in heard or len(moments) < 20 or moments[-1].limit_s >= moments[0].stamp_s:
        return nothing
    table = np.array([(m.stamp_s, m.gyro, m.lateral, m.steering) for m in moments])
    times = table[:, 0] - table[0, 0]
    size = float(np.sqrt(np.mean(_shape(times, table[:, 1]) ** 2)))
    if size < _LEAST_RAD:
        return nothing
    rate = np.gradient(table[:, 1], times)
    beside = {name: value / size for name, value in _BESIDE.items()}
    gains = {GYRO: Vote(0.0, _GAIN[GYRO])}
    slow = size / max(float(np.std(rate)), 1e-6)
    leads = {GYRO: Vote(0.0, _LAG_S[GYRO])}
    # course and a_y / v lead the heading by the side-slip of the steady bend
    speed = max((moments[-1].distance - moments[0].distance) / float(times[-1]), 1.0)
    ahead = car.cg_to_rear_m / speed - car.rear_slip_rad_per_mps2 * speed
    base = np.column_stack([table[:, 1], rate, np.ones(len(times)), times])
    candidates = [
        (name, base, table[:, column])
        for name, column in ((LATERAL, 2), (STEERING, 3))
        if name in heard
    ]
    if len(fixes) >= 8:
        at = np.array([event.moment.stamp_s for event in fixes]) - table[0, 0]
        rows = np.column_stack([
            [event.moment.gyro for event in fixes],
            np.interp(at, times, rate), np.ones(len(fixes)), at,
        ])  # fmt: skip
        candidates.append((GPS, rows, np.array([event.angle_rad for event in fixes])))
    for name, rows, headings in candidates:
        found = np.linalg.lstsq(rows, headings, rcond=None)[0]
        unlike = float(np.sqrt(np.mean((headings - rows @ found) ** 2)))
        if not found[0] > 0.2 or unlike > _UNLIKE * size * found[0]:
            continue
        gains[name] = Vote(log(found[0]), _GAIN[name] + beside[name])
        lead = found[1] / found[0] - (ahead if name != STEERING else 0.0)
        leads[name] = Vote(lead, _LAG_S[name] + beside[name] * slow)
    return (gains, leads) if len(gains) > 2 else nothing
