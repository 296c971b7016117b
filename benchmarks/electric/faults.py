"""Faults of sensors and every estimator: what they cost, who is accused, how soon, how wrongly.

    python -m benchmarks.electric.faults --out faults.jsonl

Drives, cars and faults are those of `fault_drives`. Tables: the largest error of the side-slip from
the fault's beginning to its end and three seconds on, gates alone against isolation; who is accused
of each kind of fault of each sensor; and false alarms on clean drives and on the recordings. Each
row is kept when it is done: a run that was stopped goes on from there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.electric.fault_drives import CHANNELS, KINDS, STYLES, driven, faulty
from benchmarks.electric.fault_tables import Row, tables
from benchmarks.harness import RECORDINGS, append_row, command_line, rows_in
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
Job = tuple[str, str, str, int]
KEY = ("table", "of", "fault", "seed")
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


def peaks(sensor: str, kind: str, seed: int) -> Row:
    """Largest error of the side-slip of every estimator, degrees: gates alone, and isolation."""
    log = _broken(sensor, kind, seed, LENGTH_S)
    scored = log.stamp_s >= FROM_S
    truth = log.columns["sideslip_rad"][:, None]
    largest: dict[str, tuple[float, float]] = {}
    told: list[Fault] = []
    # of yaw rate and lateral acceleration the observer is told both or none
    alone = "linear_observer"
    for names in ([alone], [name for name in ESTIMATORS if name != alone]):
        told = []
        tolerant = FaultTolerant(Together(names), CAR, CONFIG, ESTIMATORS[names[0]].needs, told)
        each = [
            np.degrees(np.abs(play(one, log).mean - truth)[scored].max(axis=0))
            for one in (Together(names), tolerant)
        ]
        for place, name in enumerate(names):
            largest[name] = float(each[0][place]), float(each[1][place])
    return {"deg": largest, **_verdict(sensor, told)}


def accusations(sensor: str, kind: str, seed: int) -> Row:
    """Whether a fault was found, after how long, and who else was accused."""
    return _verdict(sensor, faults_in(_broken(sensor, kind, seed, LENGTH_S + 7.0)))


def _verdict(sensor: str, found: list[Fault]) -> Row:
    single = [fault for fault in found if " or " not in fault.sensor]
    right = [fault.found_s - FROM_S for fault in single if sensor in fault.sensor]
    return {
        "after_s": min(right, default=None),
        "wrong": [fault.sensor for fault in single if sensor not in fault.sensor],
        "pairs": [fault.sensor for fault in found if " or " in fault.sensor],
    }


def alarms(style: str, minutes: str, seed: int) -> Row:
    """Who is accused on a clean drive, which of them withheld."""
    found = faults_in(driven(CAR, style, 60.0 * float(minutes), seed).log)
    return {"accused": [fault.sensor for fault in found],
            "withheld": [fault.sensor for fault in found if fault.withheld]}  # fmt: skip


def recorded(name: str, _kind: str, seed: int) -> Row:
    """Accusations on a recording beside the project; the seed is that of a derived GPS."""
    log, car = _recordings(seed)[name]
    step_s = float(np.median(np.diff(log.stamp_s)))
    found = faults_in(log, car, CONFIG.model_copy(update={"step_s": step_s}))
    return {
        "hours": float(log.stamp_s[-1] - log.stamp_s[0]) / 3600.0,
        "accused": [f"{fault.sensor}: {fault.what}, {fault.from_s:.1f} s" for fault in found],
    }


def _recordings(seed: int) -> dict[str, tuple[SignalLog, Car]]:
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
        rng = np.random.default_rng(seed)
        made = gps_from_truth(log, rng, course_sd_rad=0.005, speed_sd_mps=0.05)
        found[f"{name} with derived GPS"] = made, car
    if (RECORDINGS / "comma2k19").exists():
        rav4 = load_car("rav4")
        found["comma2k19"] = read_comma2k19(RECORDINGS / "comma2k19", rav4.steering_ratio).log, rav4
    return found


TABLES: dict[str, Callable[[str, str, int], Row]] = {
    "alarms": alarms, "recorded": recorded, "peaks": peaks, "accusations": accusations,
}  # fmt: skip


def _jobs(tables: Iterable[str], seeds: range, hours: float) -> list[Job]:
    """What there is to do, seed by seed; (table, of, fault, seed)."""
    minutes = f"{60.0 * hours / (len(STYLES) * len(seeds)):.3g}"
    cases: dict[str, list[tuple[str, str]]] = {
        "alarms": [(style, minutes) for style in STYLES],
        "recorded": [],
        "peaks": list(TWELVE),
        "accusations": [(sensor, kind) for sensor in CHANNELS for kind in KINDS],
    }
    jobs = [(table, *case, seed) for seed in seeds for table in tables for case in cases[table]]
    if "recorded" in tables:
        jobs += [("recorded", name, "", seeds[0]) for name in _recordings(0)]
    return jobs


def _work(job: Job) -> Row:
    table, of, fault, seed = job
    return dict(zip(KEY, job, strict=True)) | TABLES[table](of, fault, seed)


def main(given: list[str] | None = None) -> None:
    """A row a line; what is there is not done again. Then all tables of the rows there are."""
    asked = command_line(
        __doc__, given, out=Path("faults.jsonl"), seeds=10, workers=2, hours=1.0, only=list(TABLES)
    )
    seeds = range(FIRST_SEED, FIRST_SEED + asked.seeds)
    rows = rows_in(asked.out, *KEY)
    left = [job for job in _jobs(asked.only, seeds, asked.hours) if job not in rows]
    with ProcessPoolExecutor(asked.workers) as pool:
        for done in as_completed([pool.submit(_work, job) for job in left]):
            append_row(asked.out, done.result())
    print(tables(list(rows_in(asked.out, *KEY).values())))


if __name__ == "__main__":
    main()
