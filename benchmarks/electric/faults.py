"""Faults of sensors and every estimator: what they cost, who is accused, how soon, how wrongly.

    python -m benchmarks.electric.faults --out faults.json

Drives, cars and faults are those of `fault_drives`; the seeds from 300 on were not looked at while
the isolation was built. Three tables: the largest error of the side-slip from the fault's beginning
to its end and three seconds on, gates alone against isolation; who is accused of each kind of fault
of each sensor; and false alarms in hours of clean driving.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.electric.fault_drives import CHANNELS, KINDS, STYLES, driven, faulty
from benchmarks.harness import RECORDINGS, command_line, write_results
from polemap.electric.clock_rate import stretched_clock
from polemap.electric.comma2k19.io import read_comma2k19
from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import Estimate, Inputs, Value
from polemap.electric.estimators.registry import ESTIMATORS, make_estimator
from polemap.electric.io import gps_from_truth, read_signal_log
from polemap.electric.isolation.suspicion import Fault
from polemap.electric.isolation.tolerant import FaultTolerant
from polemap.electric.signals import SignalLog, play
from polemap.vehicle.io import load_car
from polemap.vehicle.parameters import Car

CAR = load_car("passat")
CONFIG = EstimatorConfig(
    step_s=0.01, gps_slots=2, camera_slots=2, camera_period_s=0.06, camera_delay_s=0.06,
    course_sd_rad=0.005, lateral_offset_sd_m=0.02, gyro_sd_radps=0.005, heading_walk_rad=0.01,
)  # fmt: skip
FIRST_SEED, FROM_S, TO_S, LENGTH_S = 300, 10.0, 15.0, 18.0
TWELVE = (
    ("gyro", "step"), ("gyro", "stuck"), ("gyro", "noise"), ("gyro", "scale"),
    ("accelerometer", "step"), ("accelerometer", "drift"), ("steering", "step"),
    ("steering", "sign"), ("wheel speed", "stuck"), ("wheel speed", "scale"), ("GPS", "step"),
    ("camera", "step"),
)  # fmt: skip


class Deaf:
    """An estimator that does nothing: for what does not depend on one."""

    fields = ("sideslip_rad",)

    def __init__(self) -> None:
        self.dropped: dict[str, int] = {}

    def step(self, *_: object) -> None:
        """Nothing."""

    capture = measure = step

    def estimate(self) -> Estimate:
        """Zero."""
        return Estimate(0.0, self.fields, np.zeros(1), np.ones(1))

    def covariance(self) -> NDArray[np.float64]:
        """One."""
        return np.eye(1)


def faults_in(log: SignalLog, car: Car = CAR, config: EstimatorConfig = CONFIG) -> list[Fault]:
    """What the isolation finds in a log."""
    found: list[Fault] = []
    play(FaultTolerant(Deaf(), car, config, (), found), log)
    return found


def _broken(sensor: str, kind: str, seed: int, length_s: float) -> SignalLog:
    style = list(STYLES)[seed % len(STYLES)]
    clean = driven(CAR, style, length_s, seed).log
    return faulty(clean, sensor, kind, FROM_S, TO_S, np.random.default_rng([seed, 7]))


class Together:
    """Several estimators that hear the same: one isolation serves them all.

    A gyro that comes back is told them at once, where each by itself would take it in slowly.
    """

    def __init__(self, names: list[str]) -> None:
        self._all = [make_estimator(name, CAR, CONFIG) for name in names]
        self.fields = tuple(names)
        self.dropped: dict[str, int] = {}

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        """All of them."""
        for one in self._all:
            one.step(stamp_s, inputs)

    def capture(self, kind: str, stamp_s: float) -> None:
        """All of them."""
        for one in self._all:
            one.capture(kind, stamp_s)

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        """All of them."""
        for one in self._all:
            one.measure(kind, value, stamp_s, arrival_s)

    def doubt(self) -> None:
        """Those that know how."""
        for one in self._all:
            doubt = getattr(one, "doubt", None)
            if doubt is not None:
                doubt()

    def estimate(self) -> Estimate:
        """Their side-slips."""
        slips = np.array([one.estimate().value("sideslip_rad") for one in self._all])
        return Estimate(0.0, self.fields, slips, np.zeros(len(slips)))

    def covariance(self) -> NDArray[np.float64]:
        """None is told."""
        return np.zeros((len(self.fields),) * 2)


def peaks(sensor: str, kind: str, seed: int) -> dict[str, tuple[float, float]]:
    """Largest error of the side-slip of every estimator, degrees: gates alone, and isolation."""
    log = _broken(sensor, kind, seed, LENGTH_S)
    scored = log.stamp_s >= FROM_S
    truth = log.columns["sideslip_rad"][:, None]
    result = {}
    # of yaw rate and lateral acceleration the observer is told both or none
    alone = "linear_observer"
    for names in ([alone], [name for name in ESTIMATORS if name != alone]):
        tolerant = FaultTolerant(Together(names), CAR, CONFIG, ESTIMATORS[names[0]].needs, [])
        largest = [
            np.degrees(np.abs(play(each, log).mean - truth)[scored].max(axis=0))
            for each in (Together(names), tolerant)
        ]
        for place, name in enumerate(names):
            result[name] = float(largest[0][place]), float(largest[1][place])
    return result


def accusations(sensor: str, kind: str, seed: int) -> dict[str, Any]:
    """Whether a fault was found, after how long, and who else was accused."""
    found = faults_in(_broken(sensor, kind, seed, LENGTH_S + 7.0))
    single = [fault for fault in found if " or " not in fault.sensor]
    right = [fault.found_s - FROM_S for fault in single if sensor in fault.sensor]
    return {
        "after_s": min(right, default=None),
        "wrong": [fault.sensor for fault in single if sensor not in fault.sensor],
        "pairs": [fault.sensor for fault in found if " or " in fault.sensor],
    }


def alarms(style: str, seed: int, length_s: float) -> list[str]:
    """Who is accused on a clean drive."""
    return [fault.sensor for fault in faults_in(driven(CAR, style, length_s, seed).log)]


def recorded() -> dict[str, Any]:
    """Accusations on the recordings beside the project, each with its hours."""
    result: dict[str, Any] = {}
    for name, (log, car) in _recordings().items():
        step_s = float(np.median(np.diff(log.stamp_s)))
        config = CONFIG.model_copy(update={"step_s": step_s})
        found = faults_in(log, car, config)
        result[name] = {
            "hours": float(log.stamp_s[-1] - log.stamp_s[0]) / 3600.0,
            "accused": [f"{fault.sensor}: {fault.what}, {fault.from_s:.1f} s" for fault in found],
        }
    return result


def _recordings() -> dict[str, tuple[SignalLog, Car]]:
    found: dict[str, tuple[SignalLog, Car]] = {}
    published = replace(
        CAR, name="gti", source="Stanford ME227, published", mass_kg=1926.2,
        yaw_inertia_kgm2=2763.5, cg_to_front_m=1.264, cg_to_rear_m=1.367,
        front_stiffness_nprad=40e3, rear_stiffness_nprad=60e3, front_slip_stiffness_nprad=55e3,
        rear_slip_stiffness_nprad=90e3, front_friction=0.9, rear_friction=0.94,
    )  # fmt: skip
    for name, car in (("revs_250lm", load_car("250lm")), ("niki_gti", published)):
        path = RECORDINGS / name / "signals.csv.gz"
        if not path.exists():
            continue
        log = read_signal_log(path)[0]
        clock = stretched_clock(log)
        log = log if clock is None else clock.real_time(log)
        found[name] = log, car
        made = gps_from_truth(log, np.random.default_rng(0), course_sd_rad=0.005, speed_sd_mps=0.05)
        found[f"{name} with derived GPS"] = made, car
    if (RECORDINGS / "comma2k19").exists():
        rav4 = load_car("rav4")
        found["comma2k19"] = read_comma2k19(RECORDINGS / "comma2k19", rav4.steering_ratio).log, rav4
    return found


def _spread(
    work: Callable[..., Any], jobs: list[tuple[Any, ...]], workers: int
) -> list[tuple[tuple[Any, ...], Any]]:
    with ProcessPoolExecutor(workers) as pool:
        return list(zip(jobs, pool.map(work, *zip(*jobs, strict=True)), strict=True))


def main(given: list[str] | None = None) -> None:
    """All three tables into a JSON file."""
    asked = command_line(
        __doc__, given, out=Path("faults.json"), seeds=10, workers=2, hours=2.0, only=""
    )
    seeds = range(FIRST_SEED, FIRST_SEED + asked.seeds)
    result: dict[str, Any] = json.loads(asked.out.read_text()) if asked.out.exists() else {}
    if asked.only in ("", "alarms"):
        length_s = asked.hours * 3600.0 / (len(STYLES) * asked.seeds)
        jobs: list[tuple[Any, ...]] = [(style, s, length_s) for style in STYLES for s in seeds]
        told = _spread(alarms, jobs, asked.workers)
        result["clean"] = {
            style: [name for job, names in told if job[0] == style for name in names]
            for style in STYLES
        }
        result["recorded"] = recorded()
        write_results(asked.out, result)
    if asked.only in ("", "accusations"):
        result["accusations"] = []
        for seed in seeds:
            jobs = [(sensor, kind, seed) for sensor in CHANNELS for kind in KINDS]
            result["accusations"] += [
                {"sensor": j[0], "kind": j[1], "seed": j[2], **x}
                for j, x in _spread(accusations, jobs, asked.workers)
            ]
            write_results(asked.out, result)
    if asked.only in ("", "peaks"):
        result["peaks"] = []
        for seed in seeds:
            jobs = [(sensor, kind, seed) for sensor, kind in TWELVE]
            result["peaks"] += [
                {"sensor": j[0], "kind": j[1], "seed": j[2], "deg": x}
                for j, x in _spread(peaks, jobs, asked.workers)
            ]
            write_results(asked.out, result)  # a long run that is cut leaves whole seeds


if __name__ == "__main__":
    main()
