"""The study full-loop: from mapping to autonomous driving, with pictures all the way."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from os import cpu_count

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import ConfigError
from polemap.drivelog.jobs import LocalWorkers, in_order
from polemap.electric.studies.scenes import KMH
from polemap.electric.studies.study import Curve, Line, Panel, Report, Shown, Study, curves_of
from polemap.extras import check_installed
from polemap.simulate.closed_loop.camera_eye import CameraEye, Timing
from polemap.simulate.closed_loop.follow_run import SWING_M, SWING_S, SWINGS, FollowRun
from polemap.simulate.closed_loop.path_following import FollowScenario, PathDrive, Source
from polemap.simulate.closed_loop.taught_street import TaughtStreet, teach
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]

NAME = "full-loop"
SPEEDS_KMH = (30, 50)
DURATION_S = 20.0
CAMERA_S = 1.0 / 27.0
"""Between pictures: a pipeline that is busy for 74 ms takes every second one, 13.5 a second."""
SOURCE_PAPER_S = 0.074
_SHOWN_EVERY_S = 6.0


@dataclass(frozen=True, slots=True)
class Case:
    """What the car steers by, how often a picture is taken, and how long one is worked on.

    Attributes:
        every: of the camera's pictures one in so many is taken.
        processing_s: None for what it takes here.
        solved: in the map that camera and fixes made, with the camera's odometry.
    """

    key: str
    label: str
    source: Source
    every: int = 1
    processing_s: float | None = None
    solved: bool = False


CASES = (
    Case("truth", "true pose", "truth"),
    Case("instant", "13.5 pictures a second, no processing time", "filter", 2, 0.0),
    Case("few", "6.8 pictures a second, no processing time", "filter", 4, 0.0),
    Case("paper", "74 ms a picture, the rest dropped (13.5 Hz)", "filter", 1, SOURCE_PAPER_S),
    Case("here", "processing time of this machine, the rest dropped", "filter", 1),
    Case(
        "camera",
        "74 ms, map of camera and GNSS, camera odometry",
        "filter",
        1,
        SOURCE_PAPER_S,
        True,
    ),
)


@dataclass(frozen=True, slots=True)
class Driven:
    """A drive and what its camera did; `Timing` is None where nothing looked."""

    run: FollowRun
    timing: Timing | None


def full_loop_study(car: Car, seeds: int, report: Report, estimators: tuple[str, ...]) -> Study:
    """A street taught by a driver, mapped, and driven by the localizer's pose from pictures.

    Raises:
        ConfigError: estimators were asked for; it is the localizer that closes this loop.
        MissingExtraError: pictures need open3d, a map without reference gtsam.
    """
    if estimators:
        raise ConfigError(f"{NAME} is closed by the localizer, it takes no --estimator")
    check_installed("open3d")
    check_installed("gtsam")
    jobs = list(range(seeds))
    workers = LocalWorkers(min(cpu_count() or 1, seeds))
    driven: dict[tuple[int, str], list[Driven]] = {}
    poles = []
    for count, of_seed in in_order(partial(drive_street, car), jobs, workers):
        poles.append(count)
        for case, one in of_seed.items():
            driven.setdefault(case, []).append(one)
        report(1)
    return _study(driven, poles)


def drive_street(
    car: Car, seed: int, duration_s: float = DURATION_S
) -> tuple[int, dict[tuple[int, str], Driven]]:
    """Teach one street and drive it at all speeds in all ways; poles of its map, and the drives."""
    street = teach(seed, solve=any(case.solved for case in CASES))
    return len(street.course.pole_map), {
        (kmh, case.key): _drive(car, street, kmh * KMH, case, duration_s)
        for kmh in SPEEDS_KMH
        for case in CASES
    }


def _drive(
    car: Car, street: TaughtStreet, speed_mps: float, case: Case, duration_s: float
) -> Driven:
    # the path ends some metres after the drive
    duration_s = min(duration_s, (street.course.path.length_m - 15.0) / speed_mps)
    scenario = FollowScenario(speed_mps, case.source, 0.0, duration_s, healthy_only=True)
    period_s = case.every * CAMERA_S
    # drives of one seed have the same errors of odometry, fixes and particles
    rngs = tuple(np.random.default_rng([street.seed, part]) for part in (50, 51))
    eye = None
    if case.source != "truth":
        studio = street.studio(speed_mps, duration_s, period_s)
        eye = CameraEye(
            street, studio, case.processing_s, None, _SHOWN_EVERY_S, measures_motion=case.solved
        )
    course = street.course if not case.solved else street.solved
    assert course is not None
    run = PathDrive(
        car, scenario, course, eye, (rngs[0], rngs[1]), scan_s=period_s
    ).run()  # fmt: skip
    return Driven(run, None if eye is None else eye.timing)


def _study(driven: dict[tuple[int, str], list[Driven]], poles: list[int]) -> Study:
    lines: list[Line] = []
    figures: dict[str, float] = {"map_poles": float(np.mean(poles))}
    for kmh in SPEEDS_KMH:
        for case in CASES:
            drives = driven[kmh, case.key]
            key = f"{kmh}_{case.key}"
            figures |= {f"{key}_{name}": value for name, value in figures_of(drives).items()}
            lines.append(_line(f"{kmh} km/h, {case.label}", key, figures))
        rms = {case.key: figures[f"{kmh}_{case.key}_rms_m"] for case in CASES}
        for name, more, less in (
            ("74 ms of processing", "paper", "instant"),
            ("every second picture left out", "few", "instant"),
            ("doing without reference and wheels", "camera", "paper"),
        ):
            cost = rms[more] - rms[less]
            text = f"{1000 * cost:+.0f} mm rms" if np.isfinite(cost) else "-"
            lines.append(Line(f"{kmh} km/h: what {name} cost", text, "", ""))
    remarks = (
        "A driver drives the street once with a reference of 2 cm; its pictures make the map, its "
        "path is the one to follow. Then the car comes again at constant speed: other traffic, "
        "two parked cars of five exchanged; the driver hands over after six seconds, and steers "
        "where the localizer calls itself unhealthy.",
        "Lateral error of the front axle from the path, mean of the seeds' rms with its sd, and "
        "the largest; scored from three seconds after the driver handed over.",
        f"Pictures at {1 / CAMERA_S:.0f} Hz; one that comes while another is worked on is dropped. "
        "Age: from the exposure to the pose. Processor time of one thread, so a busy machine "
        "changes nothing.",
        f"An oscillation is a row of {SWINGS} or more successive swings of {SWING_M} m or more, "
        f"each within {SWING_S:.0f} s; a jump is the pose's error from one hundredth of a second "
        "to the next. Pictures: 50 km/h, errors of the pose that the car steers by, gaps where it "
        "is not healthy.",
    )
    first = {case.label: driven[50, case.key][0] for case in CASES}
    return Study(
        NAME,
        "A street mapped by one drive, then driven by the localizer from pictures",
        tuple(lines),
        (),
        remarks,
        figures,
        _panels({label: one.run for label, one in first.items()}),
        ("rms, largest", "pose: along, lateral, jump", ""),
        _shown(driven[50, "here"][0].timing),
    )


def figures_of(drives: list[Driven]) -> dict[str, float]:
    """Means over the drives of a case; largest values over all of them."""
    runs = [d.run for d in drives if d.run.engaged_s == d.run.engaged_s and not d.run.left_road]
    found = {
        "failed": float(len(drives) - len(runs)),
        "driver_share": float(np.mean([d.run.driver_share for d in drives])),
    }
    for timing in (d.timing for d in drives if d.timing is not None):
        taken = len(timing.age_s)
        for name, values in (
            ("matching_ms", timing.matching_s), ("seeing_ms", timing.seeing_s),
            ("localizing_ms", timing.localizing_s), ("age_ms", timing.age_s),
        ):  # fmt: skip
            middle = 1000.0 * float(np.median(values)) if values else np.nan
            found[name] = found.get(name, 0.0) + middle / len(drives)
        share = timing.dropped / max(1, taken + timing.dropped)
        found["dropped_share"] = found.get("dropped_share", 0.0) + share / len(drives)
    nothing = float("nan")
    if not runs:
        return found | dict.fromkeys(("rms_m", "rms_sd_m", "largest_m"), nothing)
    rms = np.array([run.rms_m() for run in runs])
    pose = np.array([run.pose_rms_m() for run in runs])
    along, lateral = np.sqrt((pose**2).mean(axis=0)).tolist()
    return found | {
        "rms_m": float(rms.mean()),
        "rms_sd_m": float(rms.std(ddof=1)) if len(rms) > 1 else 0.0,
        "largest_m": max(run.largest_m() for run in runs),
        "swings": float(max(run.swings() for run in runs)),
        "steer_rate_radps": float(np.mean([run.steer_rate_rms_radps() for run in runs])),
        "pose_along_m": along,
        "pose_lateral_m": lateral,
        "pose_jump_m": max(run.pose_jump_m() for run in runs),
    }


def _line(label: str, key: str, figures: dict[str, float]) -> Line:
    def get(name: str) -> float:
        return figures.get(f"{key}_{name}", 0.0)

    notes = []
    if get("failed"):
        notes.append(f"{get('failed'):.0f} failed")
    if get("driver_share"):
        notes.append(f"driver steered {100 * get('driver_share'):.1f} %")
    if get("swings") >= SWINGS:
        notes.append(f"{get('swings'):.0f} swings")
    if f"{key}_age_ms" in figures:
        notes.append(f"age {get('age_ms'):.0f} ms, {100 * get('dropped_share'):.0f} % dropped")
    if f"{key}_pose_jump_m" not in figures:
        return Line(label, "-", "-", ", ".join(notes))
    pose = f"{get('pose_along_m'):.3f}, {get('pose_lateral_m'):.3f}, {get('pose_jump_m'):.3f} m"
    text = f"{get('rms_m'):.3f} +- {get('rms_sd_m'):.3f}, {get('largest_m'):.2f} m"
    return Line(label, text, pose, ", ".join(notes))


def _panels(runs: dict[str, FollowRun]) -> tuple[Panel, ...]:
    steered = {label: run for label, run in runs.items() if label != CASES[0].label}
    return (
        Panel("off the path, m", curves_of(runs, "lateral_m"), (-0.15, 0.15)),
        Panel("steering, degrees", curves_of(runs, "steer_rad", 180.0 / np.pi)),
        *(
            Panel(
                f"pose {name}, m",
                tuple(
                    Curve(label, run.stamp_s, run.pose_error[:, column])
                    for label, run in steered.items()
                ),
            )
            for column, name in enumerate(("along", "lateral"))
        ),
    )


def _shown(timing: Timing | None) -> tuple[Shown, ...]:
    if timing is None:
        return ()
    return tuple(Shown(f"{stamp:.1f} s", left, axes) for stamp, left, axes in timing.shown)
