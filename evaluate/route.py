"""The room on one screen: a route -> stretches -> deviations, errors and events of every system."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import starmap
from math import inf

import numpy as np
from numpy.typing import NDArray

from polemap.evaluation.bootstrap import Blocks, all_blocks, summary_and_start
from polemap.evaluation.errors import Errors, errors_against
from polemap.evaluation.exclusions import (
    Exclusion,
    UserInterval,
    evasive_manoeuvres,
    excluded_mask,
    other_lanes,
    start_up_exclusions,
    u_turns,
    user_exclusions,
    without,
)
from polemap.evaluation.laps import Stretch, find_stretches
from polemap.evaluation.repeatability import (
    Crossing,
    Deviations,
    Guide,
    crossings,
    deviations,
    guides_of,
    repeatability,
)
from polemap.evaluation.results import RouteResult, System, SystemResult
from polemap.evaluation.routes import Recording, Route
from polemap.evaluation.runs.io import Run
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

BLOCK_M = 25.0
USUAL_WANDER_M = 0.35


def evaluate_route(
    route: Route,
    intervals: Sequence[UserInterval] = (),
    advance: Callable[[int], None] = lambda _steps: None,
    max_runs: int | None = None,
) -> RouteResult:
    """Find the passes of a route, leave out what does not count, and measure every system."""
    found_in = [recording.guide for recording in route.recordings]
    stretches = find_stretches(found_in, route.named_laps())
    guides = [guides_of(stretch, found_in) for stretch in stretches]
    judge, judge_tracks = _judge(route.recordings)
    crossed = [
        crossings(stretch, judge_tracks, guide)
        for stretch, guide in zip(stretches, guides, strict=True)
    ]
    localized = crossed
    if judge != "kf":
        localized = [
            crossings(stretch, found_in, guide)
            for stretch, guide in zip(stretches, guides, strict=True)
        ]
    exclusions = _exclusions(route, stretches, crossed, localized, intervals)
    masks = _masks(stretches, crossed, exclusions)
    against = next((k for k in ("truth", "reference") if _tracks(route.recordings, k)), None)
    goal = _tracks(route.recordings, against) if against else None
    true_parts = _masked(stretches, goal, guides, masks) if goal else None
    results = []
    for system in route_systems(route, max_runs):
        results.append(_evaluate(system, route, stretches, masks, guides, true_parts, against))
        advance(len(system.tracks))
    notes = list(route.notes)
    notes += _wander_note(route.name, judge, [r for r in results if r.system.kind == judge])
    if not stretches:
        notes.append(
            f"{route.name}: no road was driven twice in the same direction: no repeatability"
        )
    return RouteResult(
        route,
        tuple(stretches),
        tuple(tuple(one) for one in crossed),
        judge,
        tuple(exclusions),
        tuple(results),
        against,
        tuple(notes),
    )


def measure(result: RouteResult, system: System) -> SystemResult:
    """Another system on an evaluated route: same passes, stations and exclusions."""
    found_in = [recording.guide for recording in result.route.recordings]
    guides = [guides_of(stretch, found_in) for stretch in result.stretches]
    masks = _masks(result.stretches, result.crossed, result.exclusions)
    goal = result.of_kind(result.against) if result.against else None
    true_parts = goal.example if goal else None
    return _evaluate(
        system, result.route, result.stretches, masks, guides, true_parts, result.against
    )


def route_systems(route: Route, max_runs: int | None = None) -> list[System]:
    """Particle filter and output filter of every setting, reference, truth, and what was added."""
    systems = []
    for setting in route.setting_names:
        sets = [recording.settings[setting] for recording in route.recordings]
        count = min(len(one.runs) for one in sets)
        count = count if max_runs is None else min(count, max_runs)
        label = route.setting_mark(setting)
        groups = tuple(tuple(one.runs[run] for one in sets) for run in range(count))
        systems += [filter_system(f"{k}{label}", k, setting, groups) for k in ("pf", "kf")]
    for kind in ("reference", "truth"):
        track = _tracks(route.recordings, kind)
        if track is not None:
            systems.append(System(kind, kind, "", (track,)))
    for name in dict.fromkeys(name for one in route.recordings for name in one.added):
        nothing = Trajectory(np.empty(0), np.empty((0, 3)))
        track = tuple(one.added.get(name, nothing) for one in route.recordings)
        systems.append(System(name, "added", "", (track,)))
    return systems


def filter_system(name: str, kind: str, setting: str, groups: Sequence[Sequence[Run]]) -> System:
    """The particle filter (`pf`) or the output filter (`kf`) of `groups[run][recording]`."""
    tracks = tuple(tuple(getattr(run, kind) for run in runs) for runs in groups)
    begins = tuple(tuple(run.on_poles_from_s() for run in runs) for runs in groups)
    return System(name, kind, setting, tracks, begins if kind == "kf" else ())


def _judge(recordings: Sequence[Recording]) -> tuple[str, Sequence[Trajectory]]:
    """The system that tells how the car was driven: the truth, the reference, else the output."""
    for kind in ("truth", "reference"):
        track = _tracks(recordings, kind)
        if track is not None:
            return kind, track
    return "kf", [recording.guide for recording in recordings]


def _tracks(recordings: Sequence[Recording], kind: str) -> tuple[Trajectory, ...] | None:
    tracks = [getattr(recording, kind) for recording in recordings]
    return None if any(track is None for track in tracks) else tuple(tracks)


def _exclusions(
    route: Route,
    stretches: Sequence[Stretch],
    crossed: Sequence[Sequence[Crossing]],
    localized: Sequence[Sequence[Crossing]],
    intervals: Sequence[UserInterval],
) -> list[Exclusion]:
    """All that is left out; `crossed` is the judge's view and `localized` the output filter's."""
    found = user_exclusions(stretches, crossed, intervals, route.name)
    settled = [recording.settled_s for recording in route.recordings]
    found += start_up_exclusions(stretches, crossed, settled)
    for number, stretch in enumerate(stretches):
        found += [Exclusion(number, None, a, b, "U-turn") for a, b in u_turns(stretch.path)]
        if crossed[number] is not localized[number]:
            lanes = other_lanes(stretch, crossed[number], localized[number])
            found += [replace(one, stretch=number) for one in lanes]
        left = without(crossed[number], excluded_mask(stretch, number, found))
        evasive = evasive_manoeuvres(stretch, left)
        found += [replace(one, stretch=number) for one in evasive]
    return found


def _masks(
    stretches: Sequence[Stretch],
    crossed: Sequence[Sequence[Crossing]],
    exclusions: Sequence[Exclusion],
) -> list[NDArray[np.bool_]]:
    """What does not count: the exclusions, and where the judge did not see the pass.

    So every system is measured at the same places, and the share that it lacks is its own.
    """
    masks = []
    for number, stretch in enumerate(stretches):
        seen = np.zeros((len(stretch.passes), len(stretch.path.station_m)), dtype=bool)
        for row, one in enumerate(crossed[number]):
            seen[row, one.stations] = True
        masks.append(excluded_mask(stretch, number, exclusions) | ~seen)
    return masks


def _wander_note(route: str, judge: str, judges: Sequence[SystemResult]) -> list[str]:
    """Say so where the laps were not driven alike, as far as the judge can be believed."""
    if judge == "kf" or not judges or not judges[0].sd_m > USUAL_WANDER_M:
        return []
    return [
        f"{route}: by the {judge}, the laps differ by {judges[0].sd_m:.2f} m; average drivers "
        f"wander by 0.10 to 0.27 m. Unless the {judge} itself drifts, this repeatability is that "
        "of the driver, and the error beside it tells about the localizer"
    ]


def _masked(
    stretches: Sequence[Stretch],
    tracks: Sequence[Trajectory],
    guides: Sequence[Sequence[Guide]],
    masks: Sequence[NDArray[np.bool_]],
) -> list[Deviations]:
    return [
        deviations(stretch, tracks, guide).masked(mask)
        for stretch, guide, mask in zip(stretches, guides, masks, strict=True)
    ]


def _evaluate(
    system: System,
    route: Route,
    stretches: Sequence[Stretch],
    masks: Sequence[NDArray[np.bool_]],
    guides: Sequence[Sequence[Guide]],
    true_parts: Sequence[Deviations] | None,
    against: str | None,
) -> SystemResult:
    repeated, lost, example, squares, weights, true_rms = [], [], [], [], [], []
    wanted = sum(int((~mask).sum()) for mask in masks)
    for number, tracks in enumerate(system.tracks):
        parts = _masked(stretches, tracks, guides, masks)
        repeated.append(repeatability(parts))
        there = sum(int(part.counted.sum()) for part in parts)
        lost.append(1.0 - there / wanted if wanted else float("nan"))
        square, weight = _road_blocks(parts)
        squares.append(square)
        weights.append(weight)
        if number == 0:
            example = parts
        if true_parts is not None and system.kind != against:
            true_rms.append(
                _rms([p.lateral_m - t.lateral_m for p, t in zip(parts, true_parts, strict=True)])
            )
    goals = _tracks(route.recordings, against) if against else None
    per_run: list[list[Errors]] = []
    starts: list[list[Errors]] = []
    if goals is not None and system.kind != against:
        for run, tracks in enumerate(system.tracks):
            begins = system.counts_from_s[run] if system.counts_from_s else (-inf,) * len(tracks)
            parts_of = [
                errors_against(track, goal).split(begin)
                for track, goal, begin in zip(tracks, goals, begins, strict=True)
            ]
            starts.append([start for start, _ in parts_of])
            per_run.append([counted for _, counted in parts_of])
    guides_s = [one.guide.stamp_s for one in route.recordings]
    spans = [(float(stamps[0]), float(stamps[-1])) for stamps in guides_s] if per_run else []
    return SystemResult(
        system=system,
        repeatability=tuple(repeated),
        lost_share=tuple(lost),
        example=tuple(example),
        blocks=Blocks(np.array(squares), np.array(weights)),
        true_lateral_rms_m=tuple(true_rms),
        accuracy=tuple(starmap(summary_and_start, zip(per_run, starts, strict=True))),
        errors=tuple(per_run[0]) if per_run else (),
        error_blocks=all_blocks(per_run, spans),
    )


def _road_blocks(parts: Sequence[Deviations]) -> tuple[Floats, Floats]:
    """Squares and degrees of freedom over `BLOCK_M` of road, stretch after stretch."""
    squares, weights = [np.zeros(0)], [np.zeros(0)]
    for part in parts:
        block = (part.stretch.path.station_m / BLOCK_M).astype(np.int64)
        centred = np.nan_to_num(part.centred())
        freedom = np.maximum(part.counted - 1, 0)
        squares.append(np.bincount(block, (centred**2).sum(axis=0)).astype(np.float64))
        weights.append(np.bincount(block, freedom).astype(np.float64))
    return np.concatenate(squares), np.concatenate(weights)


def _rms(parts: Sequence[Floats]) -> float:
    values = np.concatenate([part[np.isfinite(part)] for part in parts]) if parts else np.empty(0)
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
