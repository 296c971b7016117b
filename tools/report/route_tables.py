"""The tables of the report, filled from evaluated routes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy

from polemap.evaluation.laps import road_length_m
from polemap.evaluation.results import RouteResult, SystemResult
from polemap.parsing.errors import ParsingError
from polemap.parsing.yaml_text import read_yaml
from polemap.tools.report.run_tables import (
    accuracy_table,
    event_table,
    kind_table,
    run_spread,
    timing_table,
)
from polemap.tools.report.tables import Table, number, span, with_spread

NEAR_ROUTE_M = 15.0
KIND_NAMES = {
    "pf": "particle filter",
    "kf": "output filter",
    "reference": "reference system",
    "truth": "simulator",
    "added": "added",
}


def all_tables(results: Sequence[RouteResult], machine: str) -> list[Table]:
    """Every table that the routes have something to say for."""
    tables = [
        repeatability_table(results),
        route_table(results),
        repeatability_details(results),
        truth_table(results),
        accuracy_table(results),
        event_table(results),
        kind_table(results),
        timing_table(results, machine),
        map_table(results),
        exclusion_table(results),
    ]
    return [table for table in tables if table.rows]


def repeatability_table(results: Sequence[RouteResult]) -> Table:
    """The source paper's Table II."""
    rows = []
    for result in results:
        figures = {one.system.name: one for one in result.systems}
        reference = figures.get("reference")
        for setting in result.route.setting_names:
            label = result.route.setting_mark(setting)
            pf, kf = figures[f"pf{label}"], figures[f"kf{label}"]
            rows.append(
                (
                    result.route.name + label,
                    with_spread(pf.sd_m, pf.spread_m),
                    with_spread(kf.sd_m, kf.spread_m),
                    number(reference.sd_m) if reference else "–",
                    passes_text(result),
                    str(len(pf.repeatability)),
                )
            )
    return Table(
        "repeatability",
        "Repeatability",
        ("Route", "Particle filter [m]", "Output filter [m]", "Reference [m]", "Laps", "Runs"),
        tuple(rows),
        "Standard deviation of the lateral position over the laps. Mean ± standard deviation "
        "over the Monte Carlo runs. It contains the driver's own wander.",
    )


def route_table(results: Sequence[RouteResult]) -> Table:
    """The source paper's Table I, and pole density."""
    rows = []
    for result in results:
        guides = [recording.guide for recording in result.route.recordings]
        driven = sum(float(guide.travelled_m()[-1]) for guide in guides)
        duration = sum(float(guide.stamp_s[-1] - guide.stamp_s[0]) for guide in guides)
        course = sum(stretch.path.length_m for stretch in result.stretches)
        rows.append(
            (
                result.route.name,
                route_type(result),
                number(course if course else None, 0),
                number(driven, 0),
                number(driven / duration if duration > 0 else None, 1),
                passes_text(result),
                number(poles_per_km(result), 1),
                ", ".join(recording.name for recording in result.route.recordings),
            )
        )
    return Table(
        "routes",
        "Routes",
        (
            "Route",
            "Type",
            "Course [m]",
            "Driven [m]",
            "Mean speed [m/s]",
            "Laps",
            "Poles per km",
            "Runs in",
        ),
        tuple(rows),
        f"Course: length of the road that was driven at least twice in one direction. Poles per "
        f"km: mapped poles within {NEAR_ROUTE_M:.0f} m of the driven line.",
        text_columns=2,
    )


def repeatability_details(results: Sequence[RouteResult]) -> Table:
    """The estimator's inside: interval, bias, degrees of freedom."""
    rows = []
    for result in results:
        for one in result.systems:
            if not one.repeatability or not np.isfinite(one.sd_m):
                continue
            low, high = one.interval_m()
            mean = _mean_of(one)
            rows.append(
                (
                    result.route.name,
                    one.system.name,
                    with_spread(one.sd_m, one.spread_m),
                    span(low, high),
                    number(mean["unbiased_m"]),
                    number(mean["population_m"]),
                    number(mean["freedom"], 0),
                    number(100.0 * mean["share"], 0),
                    number(100.0 * float(np.mean(one.lost_share)), 2),
                )
            )
    return Table(
        "repeatability-details",
        "Repeatability in detail",
        (
            "Route",
            "System",
            "Repeatability [m]",
            "95 % interval [m]",
            "Free of bias [m]",
            "Divided by L [m]",
            "Effective freedom",
            "Stations used [%]",
            "Missing or lost [%]",
        ),
        tuple(rows),
        "The interval is for the laps as a sample of all laps (chi-square with the effective "
        "degrees of freedom). 'Free of bias' divides by c4; 'divided by L' is the estimator that "
        "divides by the laps instead of laps − 1. Missing or lost: share of the places that count "
        "where the system had no pose within 12 m of the path; these cannot enter the figure.",
        text_columns=2,
    )


def truth_table(results: Sequence[RouteResult]) -> Table:
    """How much of the measure is the driver, as the truth or else the reference knows it."""
    rows = []
    for result in results:
        judge = result.of_kind(result.against) if result.against else None
        if judge is None or not np.isfinite(judge.sd_m):
            continue
        for one in result.systems:
            if one.true_lateral_rms_m:
                values = one.true_lateral_rms_m
                rows.append(
                    (
                        result.route.name,
                        one.system.name,
                        result.against or "–",
                        number(one.sd_m),
                        number(judge.sd_m),
                        with_spread(float(np.mean(values)), run_spread(values)),
                        number(float(np.hypot(judge.sd_m, np.mean(values)))),
                    )
                )
    return Table(
        "truth",
        "How much of it is the driver",
        (
            "Route",
            "System",
            "By the",
            "Repeatability [m]",
            "Driver's wander [m]",
            "Lateral error [m]",
            "Root of both squared [m]",
        ),
        tuple(rows),
        "Wander: the repeatability of the true trajectory, or of the reference where there is no "
        "truth. Lateral error: root mean square against it at the same stations. If error and "
        "wander are independent, the root of both squared is the repeatability, except for "
        "errors that return on every lap.",
        text_columns=3,
    )


def map_table(results: Sequence[RouteResult]) -> Table:
    """What the map holds."""
    rows = []
    for result in results:
        poles = result.route.pole_map
        if poles is None or len(poles) == 0:
            continue
        extent = np.ptp(poles.points_m, axis=0)
        sd = np.sqrt(np.linalg.eigvalsh(poles.covariance_m2)[:, -1])
        widths = poles.width_m[np.isfinite(poles.width_m)]
        rows.append(
            (
                result.route.name,
                str(poles.frame),
                str(len(poles)),
                f"{extent[0]:.0f} x {extent[1]:.0f}",
                number(float(np.median(sd))),
                number(float(np.median(widths)) if len(widths) else None, 2),
                number(float(np.median(poles.observations)), 0),
                number(float(np.mean(poles.existence)), 2),
            )
        )
    return Table(
        "map",
        "Maps",
        (
            "Route",
            "Frame",
            "Poles",
            "Extent [m]",
            "Position sd, major [m]",
            "Width [m]",
            "Observations",
            "Mean existence",
        ),
        tuple(rows),
        "Position, width and observations: medians over the poles.",
        text_columns=2,
    )


def exclusion_table(results: Sequence[RouteResult]) -> Table:
    """Everything that did not count, and why."""
    rows = []
    for result in results:
        for one in result.exclusions:
            stretch = result.stretches[one.stretch]
            who = "all" if one.pass_row is None else stretch.passes[one.pass_row].name
            where = f"{one.start_m:.0f} – {one.end_m:.0f}"
            rows.append((result.route.name, str(one.stretch + 1), who, one.reason, where))
    return Table(
        "exclusions",
        "Left out of the repeatability",
        ("Route", "Road", "Lap", "Why", "Stations [m]"),
        tuple(rows),
        "The rules stand in docs/repeatability.md; manoeuvres are judged by the truth, else the "
        "reference, else the output filter.",
        text_columns=4,
    )


def passes_text(result: RouteResult) -> str:
    """`6`, or `2–4` where roads were driven differently often."""
    counts = [len(stretch.passes) for stretch in result.stretches]
    if not counts:
        return "1"
    return str(counts[0]) if len(set(counts)) == 1 else f"{min(counts)}–{max(counts)}"


def poles_per_km(result: RouteResult) -> float | None:
    """Mapped poles near the driven line, per kilometre of different road."""
    poles = result.route.pole_map
    if poles is None or len(poles) == 0:
        return None
    guides = [recording.guide for recording in result.route.recordings]
    line = np.concatenate([guide.thinned(2.0).poses[:, :2] for guide in guides])
    near = np.isfinite(
        scipy.spatial.KDTree(line).query(poles.points_m, distance_upper_bound=NEAR_ROUTE_M)[0]
    )
    length_m = road_length_m(guides)
    return float(near.sum() / length_m * 1e3) if length_m else None


def route_type(result: RouteResult) -> str:
    """`type` (or `scenario`) of drive.yaml, if the drive has one."""
    for recording in result.route.recordings:
        path = recording.main.drive
        if path is None or not (path / "drive.yaml").is_file():
            continue
        try:
            head: Any = read_yaml(path / "drive.yaml")
        except (OSError, ParsingError):
            continue
        for key in ("type", "scenario"):
            if isinstance(head, dict) and isinstance(head.get(key), str):
                return str(head[key])
    return "–"


def _mean_of(one: SystemResult) -> dict[str, float]:
    names = ("unbiased_m", "population_m", "freedom", "share")
    return {n: float(np.mean([getattr(r, n) for r in one.repeatability])) for n in names}
