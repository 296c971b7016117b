"""Innovation gates: what cannot be true moves no estimator, and nothing is shut out for good."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA, GPS
from polemap.electric.estimators.gate import PATIENCE_S, Gate
from polemap.electric.estimators.registry import ESTIMATORS, make_estimator
from polemap.electric.signals import Played, SignalLog, play
from polemap.electric.studies.scenes import MATCHED, Scene, drive_with_camera, drive_with_gps
from polemap.vehicle.io import load_car

COMS = load_car("coms")
SEEING = [name for name, entry in ESTIMATORS.items() if CAMERA in entry.late]
HEARING_GPS = [
    "two_layer",
    "two_layer_reconstructed",
    "two_layer_ignored",
    "stiffness",
    "nonlinear",
]
STEP_S = 0.005
GATED = MATCHED.model_copy(update={"innovation_gate_sd": 5.0, "step_s": STEP_S, "gps_slots": 2})
OPEN = GATED.model_copy(update={"innovation_gate_sd": 0.0})


def camera_log() -> SignalLog:
    scene = Scene(7.0, 5.0, 0.05, 0.5, delays_s=(0.03,), period_s=0.03)
    return drive_with_camera(COMS, scene, GATED, np.random.default_rng(1)).log


def gps_log() -> SignalLog:
    scene = Scene(7.0, 6.0, 0.05, 0.5, delays_s=(0.1,), period_s=0.2)
    return drive_with_gps(COMS, scene, GATED, np.random.default_rng(1)).log


def changed(log: SignalLog, **shifts: float) -> SignalLog:
    """One value after three seconds moved, of each column named."""
    columns = dict(log.columns)
    for name, shift in shifts.items():
        values = columns[name].copy()
        values[np.flatnonzero(np.isfinite(values) & (log.stamp_s > 3.0))[0]] += shift
        columns[name] = values
    return SignalLog(log.stamp_s, columns)


def moved(name: str, log: SignalLog, wrong: SignalLog, config: EstimatorConfig) -> float:
    """How far wrong values move the side-slip at most, radians."""
    played: list[Played] = [play(make_estimator(name, COMS, config), each) for each in (log, wrong)]
    difference = played[1].column("sideslip_rad") - played[0].column("sideslip_rad")
    return float(np.abs(difference).max())


@pytest.mark.parametrize("name", SEEING)
def test_one_wrong_picture_moves_no_camera_filter(name: str) -> None:
    log = camera_log()
    wrong = changed(log, heading_rad=0.1, lateral_offset_m=2.0)
    assert moved(name, log, wrong, GATED) < 0.01
    assert moved(name, log, wrong, OPEN) > 0.05


@pytest.mark.parametrize("name", HEARING_GPS)
def test_one_wrong_fix_moves_no_gps_filter(name: str) -> None:
    log = gps_log()
    assert moved(name, log, changed(log, course_rad=1.0, speed_mps=8.0), GATED) < 0.02


@pytest.mark.parametrize(
    ("name", "column", "shift"),
    [
        *((name, "yaw_rate_radps", 3.0) for name in ("bicycle", "linear_observer", "two_layer")),
        *((name, "yaw_rate_radps", 3.0) for name in ("stiffness", "nonlinear")),
        ("linear_observer", "ay_mps2", 40.0),
        ("nonlinear", "ay_mps2", 40.0),
        ("kinematic", "vx_mps", 30.0),
    ],
)
def test_one_wrong_fast_value_moves_no_filter(name: str, column: str, shift: float) -> None:
    # the speed drives the models too: only what is measured of it is the gate's
    log = gps_log()
    assert moved(name, log, changed(log, **{column: shift}), GATED) < 0.03


@pytest.mark.parametrize("name", SEEING)
def test_what_stays_other_than_expected_is_believed_after_a_while(name: str) -> None:
    """A new lane: the offset jumps by a metre and stays."""
    log = camera_log()
    offset = log.columns["lateral_offset_m"] + np.where(log.stamp_s > 3.0, 1.0, 0.0)
    jumped = SignalLog(log.stamp_s, {**log.columns, "lateral_offset_m": offset})
    played = [play(make_estimator(name, COMS, GATED), each) for each in (log, jumped)]
    step = played[1].column("lateral_offset_m") - played[0].column("lateral_offset_m")
    before = log.stamp_s < 3.0 + PATIENCE_S
    assert np.abs(step[before]).max() < 0.05
    assert np.abs(step[-20:] - 1.0).max() < 0.2


def test_a_gate_says_what_it_refuses_and_never_takes_what_is_no_number() -> None:
    dropped: dict[str, int] = {}
    gate = Gate(GATED, dropped)
    assert not gate.refuses(GPS, 0.0, (0.09, 1e-6))
    for k in range(500):
        assert gate.refuses(GPS, 0.01 * k, (float("nan"), 1.0))
    assert dropped == {"gps beyond the innovation gate, left out": 500}
    assert not Gate(OPEN, dropped).refuses(GPS, 0.0, (9.0, 1e-6))
    gate.noise_scale[GPS] = 3.0
    assert gate.variance(GPS, 2.0) == 18.0
    assert gate.variance(CAMERA, 2.0) == 2.0
