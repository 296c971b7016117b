"""Tables I to III, and the figures behind Figures 6 and 7, as Markdown."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import Any, Protocol

import numpy as np

from benchmarks.evaluate.report_routes import short_world
from benchmarks.figures.laps import CONFIGURATIONS, EASY, HARD, Laps
from benchmarks.figures.measure import EVERY, PARTICLES, PRINTED_PARTICLES, rate_hz, run_of
from polemap.detect.detection import detect
from polemap.detect.models.io import read_classifier
from polemap.drivelog.samples import StereoFrame
from polemap.simulate.config import SimulateConfig
from polemap.simulate.studio import Studio, make_plan
from polemap.simulate.world import make_world
from polemap.stereo.matching import make_matcher

Row = dict[str, Any]
KINDS = {
    "park_loop": "park, houses, cobbles", "avenue": "avenue of trees and lamps",
    "suburb": "suburban neighbourhood",
}  # fmt: skip
# the paper's: routes by likeness, then repeatability of particle filter, output and reference
PAPER = {
    "park_loop": ("FUB Campus Short", 0.177, 0.175, 1.162),
    "avenue": ("Englerallee", 0.140, 0.139, 0.507),
    "suburb": ("FUB Campus Long", 0.186, 0.188, 0.737),
}
PAPER_MS = {"disparity": "56", "detection": "8", "particle filter": "5", "output filter": "< 1"}
_PAIRS = 6
# of the times of the filters, the first half is the start
_SCANS = 600


class Courses(Protocol):
    """Laps by route, condition and configuration."""

    def laps(self, route: str, condition: str, configuration: str) -> Laps:
        """The laps of a route."""


def of(rows: Iterable[Row], **wanted: Any) -> list[Row]:
    """Rows with these values that came through."""
    return [
        row for row in rows
        if "failed" not in row and all(row[k] == v for k, v in wanted.items())
    ]  # fmt: skip


def mean_of(rows: list[Row], system: str, figure: str) -> float:
    """Mean of a figure over the runs."""
    return float(np.mean([row[system][figure] for row in rows])) if rows else float("nan")


def tables(rows: list[Row], courses: Courses, routes: list[str]) -> Iterator[str]:
    """The tables in the paper's order."""
    yield "\n".join(_routes(rows, courses, routes))
    yield "\n".join(_repeatability(rows, routes))
    yield "\n".join(_times(courses, routes[0]))
    for title, key, values in (
        ("frames a second", "every", EVERY), ("particles", "particles", PARTICLES),
    ):  # fmt: skip
        yield "\n".join(sweep_table(rows, routes[0], title, key, values))


def _routes(rows: list[Row], courses: Courses, routes: list[str]) -> Iterator[str]:
    yield "| Table I: route | length | type | mapped poles, per 100 m |"
    yield "|---|---|---|---|"
    for route in routes:
        mine = of(rows, route=route, condition=EASY, configuration="ours")
        if mine:
            length, poles = mine[0]["length_m"], mine[0]["poles"]
            kind = KINDS.get(route, "")
            yield f"| {route} | {length:.0f} m | {kind} | {poles}, {100 * poles / length:.0f} |"


def _repeatability(rows: list[Row], routes: list[str]) -> Iterator[str]:
    yield (
        "| Table II: route | configuration | particle filter | output filter | reference that "
        "drifts | the driver himself | laps, runs | lateral error: particle filter, output |"
    )
    yield "|---" * 8 + "|"
    for route in routes:
        if route in PAPER:
            name, particle, output, reference = PAPER[route]
            yield f"| {name} | the paper | {particle} | {output} | {reference} | not known | | |"
        for configuration in CONFIGURATIONS:
            mine = of(rows, route=route, condition=EASY, configuration=configuration, every=1,
                      particles=PRINTED_PARTICLES)  # fmt: skip
            if mine:
                figures = [mean_of(mine, s, "repeatability_m") for s in ("pf", "kf")]
                errors = [mean_of(mine, s, "lateral_m") for s in ("pf", "kf")]
                yield (
                    f"| {route} | {configuration} | {figures[0]:.3f} | {figures[1]:.3f} "
                    f"| {mine[0]['reference_m']:.3f} | {mine[0]['truth_m']:.3f} "
                    f"| {mine[0]['laps']}, {len(mine)} | {errors[0]:.3f}, {errors[1]:.3f} m |"
                )


def sweep_table(
    rows: list[Row], route: str, title: str, key: str, values: Iterable[int]
) -> Iterator[str]:
    """Lines of the table of a sweep, by condition and configuration."""
    yield (
        f"| {title} | laps | configuration | runs | repeatability: particle filter, output "
        "| lateral error | more than 2 m off: particle filter, output | re-initializations a run |"
    )
    yield "|---" * 8 + "|"
    fixed = {"every": {"particles": PRINTED_PARTICLES}, "particles": {"every": 1}}[key]
    for condition in (EASY, HARD):
        for configuration in CONFIGURATIONS:
            for value in values:
                mine = of(rows, route=route, condition=condition, configuration=configuration,
                          **fixed, **{key: value})  # fmt: skip
                if mine:
                    shown = f"{rate_hz(value):.1f}" if key == "every" else str(value)
                    yield f"| {shown} | {condition} | {configuration} | {_cells(mine)} |"


def _cells(rows: list[Row]) -> str:
    same, off, lost = (
        [mean_of(rows, s, figure) for s in ("pf", "kf")]
        for figure in ("repeatability_m", "lateral_m", "lost")
    )
    causes: dict[str, int] = {}
    for row in rows:
        for cause, count in row["restarts"].items():
            causes[cause] = causes.get(cause, 0) + count
    told = ", ".join(f"{c} {n / len(rows):.1f}" for c, n in sorted(causes.items())) or "0"
    return (
        f"{len(rows)} | {same[0]:.3f}, {same[1]:.3f} | {off[0]:.3f}, {off[1]:.3f} m "
        f"| {100 * lost[0]:.0f}, {100 * lost[1]:.0f} % | {told}"
    )


def _times(courses: Courses, route: str) -> Iterator[str]:
    """Milliseconds of processor time of one thread, of a few rendered pairs and a lap."""
    found = {name: _stage_ms(courses, route, name) for name in CONFIGURATIONS}
    yield "| Table III: stage | the paper (i7-4960HQ) | as printed, here | ours |"
    yield "|---|---|---|---|"
    for stage, paper in PAPER_MS.items():
        here = " | ".join(f"{found[name][stage]:.1f}" for name in CONFIGURATIONS)
        yield f"| {stage} | {paper} | {here} ms |"


def _stage_ms(courses: Courses, route: str, configuration: str) -> dict[str, float]:
    settings = CONFIGURATIONS[configuration]()
    scenario, config = short_world(route), SimulateConfig()
    world = make_world(scenario.lit(config.light), 0)
    studio = Studio(make_plan(world.route, world.scenario, 1, 0, config), world, 1)
    stereo = settings.stereo.model_copy(update={"threads": 1})
    matcher = make_matcher(stereo, studio.renderer.rig)
    classifier = read_classifier(settings.polemap.detection.model)
    spent = []
    for number in range(_PAIRS):
        shot = studio.shot(25 + 10 * number)
        begin = time.process_time()
        disparity = matcher.match(shot.left, shot.right)
        middle = time.process_time()
        frame = StereoFrame(0.0, 0.0, number, shot.left, shot.right)
        detect(frame, disparity, studio.renderer.rig, classifier, settings.polemap.detection)
        spent.append((middle - begin, time.process_time() - middle))
    matching, detecting = 1e3 * np.median(np.array(spent[1:]), axis=0)
    laps = courses.laps(route, EASY, configuration)
    scans = laps.drive.scans[:_SCANS]
    stages = run_of(laps, settings, scans, PRINTED_PARTICLES, 0, clock=time.process_time).timings_s
    found = {"disparity": float(matching), "detection": float(detecting)}
    for name, key in _FILTERS.items():
        found[name] = 1e3 * float(np.median(stages[key][-_SCANS // 2 :]))
    return found


_FILTERS = {"particle filter": "particle_filter", "output filter": "output_pose"}
