"""Scale and lateness of sensors from the turns of a few seconds."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.electric.fault_drives import driven, faulty
from polemap.electric.isolation.alone import GYRO, LATERAL, STEERING
from polemap.electric.isolation.families import GPS
from polemap.electric.isolation.late import Event
from polemap.electric.isolation.motion import Moment
from polemap.electric.isolation.proportions import SPAN_S, proportions
from polemap.electric.isolation.votes import accused
from polemap.vehicle.io import load_car
from tests.electric.isolation.test_isolation import faults_in

CAR = load_car("passat")
HEARD = {GYRO, LATERAL, STEERING}
SPEED = 15.0
LEAD_S = CAR.cg_to_rear_m / SPEED - CAR.rear_slip_rad_per_mps2 * SPEED


def turn(t: np.ndarray) -> np.ndarray:
    """Heading of a swerve, rad."""
    return np.asarray(0.15 * np.sin(2.0 * np.pi * t / 4.0))


def moments(
    *,
    gain: dict[str, float] | None = None,
    late_s: dict[str, float] | None = None,
    size: float = 1.0,
) -> tuple[list[Moment], list[Event]]:
    """What sensors integrate to in a swerve, offsets in all; fixes of it five times a second."""
    t = np.arange(0.0, SPAN_S + 0.01, 0.05)
    gain, late_s = gain or {}, late_s or {}

    def told(name: str, ahead_s: float, offset: float) -> np.ndarray:
        then = t + ahead_s - late_s.get(name, 0.0)
        return gain.get(name, 1.0) * size * turn(then) + offset * t

    gyro, lateral, steering = (
        told(GYRO, 0.0, 0.01), told(LATERAL, LEAD_S, -0.03), told(STEERING, 0.0, 0.02),
    )  # fmt: skip
    record = [
        Moment(float(s), float(g), float(y), float(w), distance=float(SPEED * s))
        for s, g, y, w in zip(t, gyro, lateral, steering, strict=True)
    ]
    course = told(GPS, LEAD_S, 0.0)
    fixes = [Event(record[k], float(course[k]), SPEED, 0.0) for k in range(0, len(t), 4)]
    return record, fixes


def test_sound_sensors_agree_whatever_their_offsets() -> None:
    record, fixes = moments()
    gains, leads = proportions(CAR, record, HEARD, fixes)
    assert gains.keys() == leads.keys() == {GYRO, LATERAL, STEERING, GPS}
    for votes, most in ((gains, 0.05), (leads, 0.02)):
        assert max(abs(vote.value) for vote in votes.values()) < most


@pytest.mark.parametrize("name", [GYRO, LATERAL, STEERING, GPS])
def test_a_scale_or_a_delay_accuses_its_sensor(name: str) -> None:
    gains, _ = proportions(CAR, *_with(moments(gain={name: 1.6})))
    assert accused(gains)[0] == {name}
    _, leads = proportions(CAR, *_with(moments(late_s={name: 0.4})))
    assert accused(leads)[0] == {name}


def _with(
    made: tuple[list[Moment], list[Event]],
) -> tuple[list[Moment], set[str], list[Event]]:
    return made[0], HEARD, made[1]


def test_a_straight_road_and_too_few_sensors_tell_nothing() -> None:
    record, fixes = moments(size=0.05)
    assert proportions(CAR, record, HEARD, fixes) == ({}, {})
    record, _ = moments()
    assert proportions(CAR, record, {GYRO, LATERAL}, []) == ({}, {})
    assert proportions(CAR, record, {LATERAL, STEERING}, []) == ({}, {})


def test_a_scaled_steering_is_found_and_the_sound_camera_is_not_accused() -> None:
    log = driven(load_car("passat"), "town", 18.0, 100).log
    broken = faulty(log, "steering", "scale", 10.0, 15.0, np.random.default_rng([100, 7]))
    assert {fault.sensor for fault in faults_in(broken)} == {STEERING}
