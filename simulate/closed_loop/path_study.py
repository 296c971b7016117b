"""The study path-following: the whole stack steers a car, by filter, raw poses and the truth."""

from __future__ import annotations

import numpy as np

from polemap.drivelog.errors import ConfigError
from polemap.electric.studies.scenes import KMH
from polemap.electric.studies.study import Line, Panel, Report, Study, curves_of
from polemap.simulate.closed_loop.follow_run import SWING_M, SWING_S, SWINGS, FollowRun
from polemap.simulate.closed_loop.path_following import FollowScenario, Source, follow_path
from polemap.vehicle.parameters import Car

NAME = "path-following"
SPEEDS_KMH = (30, 50)
DELAYS_S = (0.05, 0.1, 0.15)
DURATION_S = 35.0
LABELS: dict[Source, str] = {
    "truth": "true pose",
    "filter": "output filter, 100 Hz",
    "raw": "particle filter as it is",
}
CASES: tuple[tuple[Source, float], ...] = (
    ("truth", 0.0),
    ("truth", 0.1),
    *(("filter", delay) for delay in DELAYS_S),
    *(("raw", delay) for delay in DELAYS_S),
)


def path_study(car: Car, seeds: int, report: Report, estimators: tuple[str, ...]) -> Study:
    """A winding road with poles at 30 and 50 km/h, steered by Stanley's law at 100 Hz.

    Raises:
        ConfigError: estimators were asked for; it is the localizer that closes this loop.
    """
    if estimators:
        raise ConfigError(f"{NAME} is closed by the localizer, it takes no --estimator")
    lines: list[Line] = []
    figures: dict[str, float] = {}
    shown: dict[int, dict[str, FollowRun]] = {}
    for kmh in SPEEDS_KMH:
        shown[kmh] = {}
        for source, delay in CASES:
            scenario = FollowScenario(kmh * KMH, source, delay, DURATION_S)
            runs = []
            for seed in range(seeds):
                runs.append(follow_path(car, scenario, seed))
                report(1)
            label = f"{kmh} km/h, {LABELS[source]}, {1000 * delay:.0f} ms"
            key = f"{kmh}_{source}_{1000 * delay:.0f}ms"
            lines.append(_line(label, key, runs, figures))
            if delay in (0.0, 0.1):
                shown[kmh].setdefault(LABELS[source], runs[0])
        for source in ("filter", "raw"):
            low, high = (figures[f"{kmh}_{source}_{1000 * d:.0f}ms_rms_m"] for d in (0.05, 0.15))
            cost = high - low
            figures[f"{kmh}_{source}_latency_cost_m"] = cost
            lines.append(
                Line(
                    f"{kmh} km/h, {source}: what 100 ms more latency cost",
                    f"{1000 * cost:+.0f} mm rms",
                    "",
                    "",
                )
            )
    remarks = (
        "Lateral error of the front axle, mean of the seeds' rms with its sd, and the largest; "
        "scored from three seconds after the driver handed over. The delay is from the picture to "
        "the pose (of the true pose: its age).",
        f"An oscillation is a row of {SWINGS} or more successive swings of {SWING_M} m or more, "
        f"each within {SWING_S:.0f} s; the longest row is given, with the rms steering rate.",
        "Poles every 5 m, detector, odometry (1 % scale, 0.001 rad/s bias) and GNSS (2.5 m) as in "
        "simulate/points; the car is the two-track plant, its speed held.",
    )
    return Study(
        NAME,
        "A car steered along a path by the localizer's pose",
        tuple(lines),
        (),
        remarks,
        figures,
        _panels(shown),
        ("rms, largest", "swings, steering rate", ""),
    )


def _line(label: str, key: str, runs: list[FollowRun], figures: dict[str, float]) -> Line:
    driven = [r for r in runs if r.engaged_s == r.engaged_s and not r.left_road]
    failed = len(runs) - len(driven)
    figures[f"{key}_failed"] = float(failed)
    trouble = [f"{failed} of {len(runs)} failed"] if failed else []
    back = float(np.mean([r.driver_share for r in runs]))
    figures[f"{key}_driver_share"] = back
    if back > 0.0:
        trouble.append(f"driver steered {100 * back:.1f} %")
    if not driven:
        return Line(label, "-", "-", ", ".join(trouble))
    rms = np.array([r.rms_m() for r in driven])
    largest = max(r.largest_m() for r in driven)
    swings = max(r.swings() for r in driven)
    rate = float(np.mean([r.steer_rate_rms_radps() for r in driven]))
    figures.update(
        {
            f"{key}_rms_m": float(rms.mean()),
            f"{key}_rms_sd_m": float(rms.std(ddof=1)) if len(rms) > 1 else 0.0,
            f"{key}_rms_worst_m": float(rms.max()),
            f"{key}_largest_m": largest,
            f"{key}_swings": float(swings),
            f"{key}_steer_rate_radps": rate,
        }
    )
    sd = figures[f"{key}_rms_sd_m"]
    text = f"{rms.mean():.3f} +- {sd:.3f}, {largest:.2f} m"
    return Line(label, text, f"{swings}, {rate:.3f} rad/s", ", ".join(trouble))


def _panels(shown: dict[int, dict[str, FollowRun]]) -> tuple[Panel, ...]:
    panels = []
    for kmh, runs in shown.items():
        curves = curves_of(runs, "lateral_m")
        panels.append(Panel(f"lateral error at {kmh} km/h, m", curves, (-0.15, 0.15)))
        turns = curves_of(runs, "steer_rad", 180.0 / np.pi)
        panels.append(Panel(f"steering at {kmh} km/h, degrees", turns))
    return tuple(panels)
