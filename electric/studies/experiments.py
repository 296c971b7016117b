"""The papers' experiments beyond one speed and side-slip: swinging speed, position, velocity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.signals import Played, play
from polemap.electric.studies.outcomes import EVERY, SETTLED_S, outcome
from polemap.electric.studies.scenes import (
    KMH,
    MATCHED,
    MISMATCH,
    PATTERN_S,
    Scene,
    Simulated,
    drive_with_camera,
)
from polemap.electric.studies.study import Curve, Line, Panel, Report
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]
Rows = tuple[list[Line], dict[str, float]]
# so much the true yaw rate is at least where a car is said to corner
CORNERING_RADPS = 0.05


def swinging(low_kmh: float, high_kmh: float, scene: Scene) -> Scene:
    """The scene with its speed swinging between two, as the cars of the papers drove."""
    return Scene(
        low_kmh * KMH, scene.duration_s, scene.steering_rad, scene.steering_hz, scene.delays_s,
        scene.period_s, scene.model_noise, high_kmh * KMH,
    )  # fmt: skip


def camera_drives(plant: Car, scene: Scene, config: EstimatorConfig, seeds: int) -> list[Simulated]:
    """One drive a seed."""
    return [
        drive_with_camera(plant, scene, config, np.random.default_rng(seed))
        for seed in range(seeds)
    ]


def swinging_rows(
    car: Car,
    plant: Car,
    scene: Scene,
    names: dict[str, str],
    seeds: int,
    report: Report,
) -> Rows:
    """Side-slip of estimators over the bicycle's on a swinging speed; `names` to the claim."""
    text = f"{scene.speed_mps / KMH:.0f}-{(scene.top_speed_mps or 0.0) / KMH:.0f} km/h"
    drives = camera_drives(plant, scene, MISMATCH, seeds)
    base = outcome("bicycle", car, MISMATCH, drives).rmse_rad
    report(seeds)
    lines, figures = [Line(f"{text}: bicycle, RMSE rad", f"{base:.5f}", "", "")], {}
    for name, claim in names.items():
        ratio = outcome(name, car, MISMATCH, drives).rmse_rad / base
        figures[f"swinging_{name}"] = ratio
        lines.append(Line(f"{text}: {name} / bicycle", f"{ratio:.3f}", "", claim))
        report(seeds)
    return lines, figures


def delay_rows(car: Car, seeds: int, report: Report) -> Rows:
    """W12's delay experiment: pictures 33 ms late, taken for new ones and taken as they are."""
    drives = camera_drives(car, Scene(30 * KMH, 8.0, 0.06, 0.5), MATCHED, seeds)
    exact = outcome("clones", car, MATCHED, drives).rmse_rad
    ignored = MATCHED.model_copy(update={"camera_delay_s": 0.0})
    ratio = outcome("multi_rate", car, ignored, drives).rmse_rad / exact
    report(2 * seeds)
    line = Line("33 ms of delay ignored / augmented state", f"{ratio:.3f}", "1.5-1.6", "worse")
    return [line], {"delay_ignored": ratio}


_STEADY_25 = Scene(25 * KMH, 8.0, 0.1, 0.5, PATTERN_S, model_noise=False)


def position_rows(car: Car, seeds: int, report: Report) -> Rows:
    """W13's simulation: stiffness x 1.2, delays 20, 15, 10, 25 ms, scored on lateral position.

    At 25 km/h and at 0-30 km/h as in its field test. Errors relative to the filter that assumes
    a constant delay, their mean; beside it what the first picture held is worth.
    """
    lines: list[Line] = []
    figures: dict[str, float] = {}
    mean_s = float(np.mean(PATTERN_S))
    assumed = MISMATCH.model_copy(update={"camera_delay_s": mean_s})
    rows = {
        "uneven_compensated": ("W13", "best"),
        "uneven_delay": ("stored residual alone", ""),
        "clones": ("exact", ""),
    }
    for key, scene in (("25", _STEADY_25), ("0-30", swinging(0.0, 30.0, _STEADY_25))):
        drives = camera_drives(car.scaled(stiffness=1.2), scene, MISMATCH, seeds)
        for field, label in (
            ("lateral_offset_m", "lateral position"),
            ("sideslip_rad", "side-slip"),
        ):
            base = outcome("multi_rate", car, assumed, drives, field=field).rmse_rad
            unit = "m" if field.endswith("_m") else "rad"
            lines.append(
                Line(
                    f"{key} km/h, x1.2, {label}: {1e3 * mean_s:.1f} ms assumed, {unit}",
                    f"{base:.5f}",
                    "",
                    "not satisfying",
                )
            )
            report(seeds)
            for name, (text, claim) in rows.items():
                ratio = outcome(name, car, MISMATCH, drives, field=field).rmse_rad / base
                figures[f"{key}_{field}_{name}"] = ratio
                lines.append(
                    Line(f"{key} km/h, x1.2, {label}: {text} / assumed", f"{ratio:.3f}", "", claim)
                )
                report(seeds)
    return lines, figures


def position_panels(car: Car) -> tuple[Panel, ...]:
    """W13's Figs. 4 and 5 for one drive: delays of the pictures, errors of the lateral position."""
    drive = camera_drives(car.scaled(stiffness=1.2), _STEADY_25, MISMATCH, 1)[0]
    stamps, true = drive.log.stamp_s[::EVERY], drive.truth[::EVERY, 3]
    assumed = MISMATCH.model_copy(update={"camera_delay_s": float(np.mean(PATTERN_S))})
    errors = []
    for label, name, config in (
        ("W13", "uneven_compensated", MISMATCH),
        ("17.5 ms assumed", "multi_rate", assumed),
        ("stored residual alone", "uneven_delay", MISMATCH),
    ):
        played = play(make_estimator(name, car, config), drive.log, every=EVERY)
        errors.append(Curve(label, stamps, 1e3 * (played.column("lateral_offset_m") - true)))
    rows = np.flatnonzero(np.isfinite(drive.log.columns["camera_arrival_s"]))
    taken = drive.log.stamp_s[rows]
    late = 1e3 * (drive.log.columns["camera_arrival_s"][rows] - taken)
    shown = taken < 1.0
    return (
        Panel("lateral position error, mm", tuple(errors), (0.0,)),
        Panel("delay of a picture, ms", (Curve("delay", taken[shown], late[shown]),)),
    )


def velocity_rows(
    model: Car, config: EstimatorConfig, drives: list[Simulated], names: tuple[str, ...]
) -> Rows:
    """N13's Figs. 9 to 11 and the yaw rate: RMSE of course, velocities and yaw rate."""
    lines: list[Line] = []
    figures: dict[str, float] = {}
    late = round(SETTLED_S / config.step_s) // EVERY
    for name in names:
        squares: dict[str, list[Floats]] = {}
        cornering: list[Floats] = []
        for drive in drives:
            played = play(make_estimator(name, model, config), drive.log, every=EVERY)
            turning = (np.abs(drive.truth[::EVERY, 1]) > CORNERING_RADPS)[late:]
            for field, error in _errors(played, drive).items():
                squares.setdefault(field, []).append(np.square(error[late:]))
                if field == "yaw_rate_radps":
                    cornering.append(np.square(error[late:][turning]))
        for field, values in squares.items():
            rms = float(np.sqrt(np.mean(values)))
            figures[f"{name}_{field}"] = rms
            lines.append(Line(f"{field}, {name}", f"{rms:.4f}", "", _CLAIMS.get(field, "")))
        if sum(map(len, cornering)):
            rms = float(np.sqrt(np.mean(np.concatenate(cornering))))
            figures[f"{name}_yaw_rate_radps_cornering"] = rms
            lines.append(Line(f"yaw_rate_radps in cornering, {name}", f"{rms:.4f}", "", ""))
    held = np.sqrt(np.mean([np.mean(np.square(_held_course(d)[late:])) for d in drives]))
    figures["held_course_rad"] = float(held)
    lines.append(Line("course_rad, last GPS value that arrived", f"{held:.4f}", "", "delayed"))
    return lines, figures


_CLAIMS = {
    "course_rad": "Fig. 9: delay handled",
    "vx_mps": "Fig. 10: high accuracy",
    "vy_mps": "Fig. 11: high accuracy",
}


def _errors(played: Played, drive: Simulated) -> dict[str, Floats]:
    """Errors of what an estimator has of yaw rate, course and velocities."""
    truth, found = drive.truth[::EVERY], {}
    if "yaw_rate_radps" in played.fields:
        found["yaw_rate_radps"] = played.column("yaw_rate_radps") - truth[:, 1]
    if "heading_rad" in played.fields and "sideslip_rad" in played.fields:
        course = played.column("heading_rad") + played.column("sideslip_rad")
        found["course_rad"] = course - truth[:, 2] - truth[:, 0]
    vx = drive.log.columns["vx_mps"][::EVERY] * np.cos(truth[:, 0])
    for field, true in (("vx_mps", vx), ("vy_mps", drive.log.columns["vy_mps"][::EVERY])):
        if field in played.fields:
            found[field] = played.column(field) - true
    return found


def _held_course(drive: Simulated) -> Floats:
    """What the receiver's last course is off by, `(n,)`."""
    log = drive.log
    rows = np.flatnonzero(np.isfinite(log.columns["course_rad"]))
    there = np.searchsorted(log.columns["gnss_arrival_s"][rows], log.stamp_s, side="right")
    course = np.concatenate([[0.0], log.columns["course_rad"][rows]])[there]
    return np.asarray((course - drive.truth[:, 0] - drive.truth[:, 2])[::EVERY])


def velocity_panels(
    model: Car, config: EstimatorConfig, drive: Simulated, names: tuple[str, ...]
) -> tuple[Panel, ...]:
    """N13's Figs. 8 to 11 for one drive: side-slip, yaw and course, both velocities."""
    stamps = drive.log.stamp_s[::EVERY]
    truth, log = drive.truth[::EVERY], drive.log
    true = {
        "sideslip_rad": truth[:, 0],
        "heading_rad": truth[:, 2],
        "vx_mps": log.columns["vx_mps"][::EVERY] * np.cos(truth[:, 0]),
        "vy_mps": log.columns["vy_mps"][::EVERY],
    }
    labels = {
        "sideslip_rad": "side-slip, rad", "heading_rad": "yaw angle, rad",
        "vx_mps": "vx, m/s", "vy_mps": "vy, m/s",
    }  # fmt: skip
    runs = {n: play(make_estimator(n, model, config), log, every=EVERY) for n in names}
    panels = []
    for field, label in labels.items():
        curves = [Curve("truth", stamps, true[field])]
        curves += [
            Curve(name, stamps, run.column(field))
            for name, run in runs.items()
            if field in run.fields
        ]
        if field == "heading_rad":
            held = _held_course(drive) + truth[:, 0] + truth[:, 2]
            curves.append(Curve("GPS course, as it arrives", stamps, held))
        panels.append(Panel(label, tuple(curves)))
    return tuple(panels)
