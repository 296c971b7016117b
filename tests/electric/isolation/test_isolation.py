"""Every kind of fault of every sensor, on drives by cars that are not quite the car file's."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.electric.fault_drives import CHANNELS, STYLES, driven, faulty
from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import GPS, Estimate
from polemap.electric.estimators.registry import ESTIMATORS, make_estimator
from polemap.electric.isolation.suspicion import Fault
from polemap.electric.isolation.tolerant import FaultTolerant
from polemap.electric.signals import SignalLog, play
from polemap.vehicle.io import load_car

CAR = load_car("passat")
CONFIG = EstimatorConfig(
    step_s=0.01,
    gps_slots=2,
    camera_slots=2,
    camera_period_s=0.06,
    camera_delay_s=0.06,
    course_sd_rad=0.005,
    lateral_offset_sd_m=0.02,
    gyro_sd_radps=0.005,
    heading_walk_rad=0.01,
)
START_S, END_S = 12.0, 17.0


class Deaf:
    """An estimator that does nothing."""

    fields = ("sideslip_rad",)

    def __init__(self) -> None:
        self.dropped: dict[str, int] = {}

    def step(self, *_: object) -> None:
        pass

    capture = measure = step

    def estimate(self) -> Estimate:
        return Estimate(0.0, self.fields, np.zeros(1), np.ones(1))

    def covariance(self) -> np.ndarray:
        return np.eye(1)


def faults_in(log: SignalLog) -> list[Fault]:
    found: list[Fault] = []
    play(FaultTolerant(Deaf(), CAR, CONFIG, (), found), log)
    return found


@pytest.mark.parametrize("style", STYLES)
def test_a_clean_drive_accuses_nobody(style: str) -> None:
    assert faults_in(driven(CAR, style, 40.0, seed=11).log) == []


@pytest.mark.parametrize("sensor", CHANNELS)
@pytest.mark.parametrize("kind", ["step", "stuck", "noise", "silence", "spikes"])
def test_the_faulty_sensor_is_accused_and_no_other(sensor: str, kind: str) -> None:
    clean = driven(CAR, "country", 22.0, seed=12).log
    found = faults_in(faulty(clean, sensor, kind, START_S, END_S, np.random.default_rng(0)))
    assert found, "nothing found"
    assert all(sensor in fault.sensor and " or " not in fault.sensor for fault in found)
    # half a second of noise, a second of silence, a fix or two
    assert START_S <= found[0].found_s <= START_S + 3.0
    if kind != "spikes":
        assert max(fault.to_s for fault in found) <= 22.0


def test_two_that_contradict_each_other_are_named_together() -> None:
    log = driven(CAR, "country", 22.0, seed=12).log
    two = ("road_wheel_angle_rad", "yaw_rate_radps", "vx_mps")
    alone = {name: log.columns[name] for name in two}
    # no leap, which would tell who it is
    alone["yaw_rate_radps"] = log.columns["yaw_rate_radps"] + 0.15 * np.clip(
        np.minimum(log.stamp_s - START_S, END_S - log.stamp_s) / 0.5, 0.0, 1.0
    )
    found = faults_in(SignalLog(log.stamp_s, alone))
    assert [fault.sensor for fault in found] == ["gyro or steering"]
    assert found[0].withheld == 0


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_clean_log_is_told_as_it_is(name: str) -> None:
    log = driven(CAR, "country", 6.0, seed=13).log
    plain = play(make_estimator(name, CAR, CONFIG), log)
    inner = make_estimator(name, CAR, CONFIG)
    tolerant = play(FaultTolerant(inner, CAR, CONFIG, ESTIMATORS[name].needs, []), log)
    assert (tolerant.mean == plain.mean).all()
    assert (tolerant.sd == plain.sd).all()


@pytest.mark.parametrize(
    ("name", "sensor", "kind"),
    [
        ("bicycle", "steering", "step"),
        ("linear_observer", "accelerometer", "step"),
        ("kinematic", "wheel speed", "stuck"),
        ("clones", "camera", "stuck"),
        ("two_layer", "GPS", "scale"),
        ("nonlinear", "accelerometer", "stuck"),
        ("nonlinear", "wheel speed", "scale"),
    ],
)
def test_without_the_faulty_sensor_it_errs_less(name: str, sensor: str, kind: str) -> None:
    clean = driven(CAR, "country", 22.0, seed=14).log
    log = faulty(clean, sensor, kind, START_S, END_S, np.random.default_rng(0))
    inside = (log.stamp_s > START_S + 1.5) & (log.stamp_s < END_S)
    truth = log.columns["sideslip_rad"]

    def error(tolerant: bool) -> float:
        made = make_estimator(name, CAR, CONFIG)
        if tolerant:
            made = FaultTolerant(made, CAR, CONFIG, ESTIMATORS[name].needs, [])
        off = play(made, log).column("sideslip_rad") - truth
        return float(np.sqrt(np.mean(off[inside] ** 2)))

    assert error(True) < 0.8 * error(False)


def test_a_sensor_that_comes_back_moves_nothing_at_once() -> None:
    clean = driven(CAR, "country", 22.0, seed=12).log
    log = faulty(clean, "gyro", "step", START_S, END_S, np.random.default_rng(0))
    found: list[Fault] = []
    made = FaultTolerant(make_estimator("bicycle", CAR, CONFIG), CAR, CONFIG, (), found)
    rate = play(made, log).column("yaw_rate_radps")
    plain = play(make_estimator("bicycle", CAR, CONFIG), clean).column("yaw_rate_radps")
    after = log.stamp_s > END_S
    assert found[0].to_s > END_S
    assert found[0].withheld > 0
    usual = np.abs(np.diff(plain)).max()
    assert np.abs(np.diff(rate[after])).max() < 2.0 * usual


def test_slow_driving_acquits_nobody() -> None:
    """Where no other sensor can speak for it, a faulty one stays faulty."""
    log = driven(CAR, "country", 22.0, seed=12).log
    columns = dict(log.columns)
    crawl = np.where(log.stamp_s > 11.0, 2.0, columns["vx_mps"])
    ramp = np.clip((log.stamp_s - 11.0) / 3.5, 0.0, 1.0)
    columns["vx_mps"] = (1.0 - ramp) * columns["vx_mps"] + ramp * crawl
    columns = {n: c for n, c in columns.items() if n not in ("ax_mps2", "speed_mps", "course_rad")}
    gyro = columns["yaw_rate_radps"].copy()
    gyro[(log.stamp_s > 10.0) & (log.stamp_s < 17.0)] = 0.01
    columns["yaw_rate_radps"] = gyro
    found = [
        fault for fault in faults_in(SignalLog(log.stamp_s, columns)) if "gyro" in fault.sensor
    ]
    assert found[-1].to_s > 21.9


def test_what_a_fault_taught_is_forgotten() -> None:
    """Found late, a gyro had moved biases and roll, which would be wrong for minutes."""
    clean = driven(CAR, "brisk", 34.0, seed=811).log
    ramp = np.clip((clean.stamp_s - 15.0) / 0.3, 0.0, 1.0) * (clean.stamp_s < 22.0)
    rate = clean.columns["yaw_rate_radps"] + 0.1 * ramp
    log = SignalLog(clean.stamp_s, {**clean.columns, "yaw_rate_radps": rate})
    found: list[Fault] = []
    made = FaultTolerant(make_estimator("nonlinear", CAR, CONFIG), CAR, CONFIG, (), found)
    slip = play(made, log).column("sideslip_rad")
    assert found[0].sensor == "gyro"
    assert found[0].found_s > found[0].from_s
    off = np.degrees(slip - log.columns["sideslip_rad"])[log.stamp_s > 28.0]
    assert float(np.sqrt(np.mean(off**2))) < 0.25


def test_a_course_that_was_only_silent_is_believed_as_it_comes() -> None:
    """What the car slid meanwhile is no fault of the course."""
    clean = driven(CAR, "brisk", 20.0, seed=15).log
    away = (clean.stamp_s > START_S) & (clean.stamp_s < START_S + 4.0)
    course = np.where(away, np.nan, clean.columns["course_rad"])
    heard: list[tuple[float, float]] = []

    class Hears(Deaf):
        def measure(self, kind: str, value: object, stamp_s: float, _: float) -> None:
            if kind == GPS:
                heard.append((stamp_s, value[0]))  # type: ignore[index]

    log = SignalLog(clean.stamp_s, {**clean.columns, "course_rad": course})
    found: list[Fault] = []
    play(FaultTolerant(Hears(), CAR, CONFIG, (), found), log)
    assert [fault.what for fault in found if fault.sensor == "GPS"] == ["silent"]
    late = [(s, c) for s, c in heard if s > START_S + 4.0]
    assert late
    rows = np.searchsorted(clean.stamp_s, [s for s, _ in late])
    assert [c for _, c in late] == course[rows].tolist()


def test_a_rough_road_is_no_fault_of_the_accelerometers() -> None:
    """A quiet sensor on new asphalt, then cobbles: ten times what it used to show."""
    log = driven(CAR, "country", 20.0, seed=16).log
    rng, columns = np.random.default_rng(0), dict(log.columns)
    for name in ("ax_mps2", "ay_mps2"):
        smooth = np.convolve(log.columns[name], np.full(41, 1 / 41), "same")
        rough = np.where(log.stamp_s > START_S, 0.5, 0.03)
        columns[name] = smooth + rough * rng.standard_normal(len(smooth))
    assert faults_in(SignalLog(log.stamp_s, columns)) == []
