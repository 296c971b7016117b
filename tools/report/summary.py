"""How a report begins: whether the runs may be trusted, and how far off they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from polemap.evaluation.results import RouteResult
from polemap.evaluation.runs.io import Run
from polemap.tools.report.run_tables import runs_of
from polemap.tools.report.tables import number

_WORST_FIRST = ("not", "partly", "trustworthy")
_WORDS = {
    "trustworthy": "Trustworthy",
    "partly": "Partly trustworthy",
    "not": "Not trustworthy",
    "": "Without a verdict",
}
_NOT_STATED = "its runs are of an earlier polemap, which stated none"


@dataclass(frozen=True, slots=True)
class Figure:
    """A number that stands out, and what it is."""

    value: str
    label: str


@dataclass(frozen=True, slots=True)
class RouteSummary:
    """One route at a glance.

    Attributes:
        trust: `trustworthy`, `partly` or `not` of the worst run; empty where none says it.
        verdict: the same in words, with the reason.
    """

    name: str
    trust: str
    verdict: str
    figures: tuple[Figure, ...]


def summarise(results: Sequence[RouteResult]) -> tuple[RouteSummary, ...]:
    """Every route at a glance."""
    return tuple(_route(result) for result in results)


def _route(result: RouteResult) -> RouteSummary:
    runs = [run for group in runs_of(result, result.route.setting_names[0]) for run in group]
    trust, reason = _worst(runs)
    return RouteSummary(
        result.route.name,
        trust,
        f"{_WORDS[trust]}: {reason}",
        (*_accuracy(result, runs), *_from_runs(runs), *_repeatability(result)),
    )


def _worst(runs: Sequence[Run]) -> tuple[str, str]:
    """Trust and reason of the run that deserves the least."""
    found = [verdict for run in runs if (verdict := _verdict(run))]
    if not found:
        return "", _NOT_STATED
    worst = min(found, key=lambda one: _WORST_FIRST.index(one["trust"]))
    reason = str(worst.get("sentence", "")).partition(": ")[2] or "no reason is stated"
    if len(runs) > 1:
        alike = sum(one["trust"] == worst["trust"] for one in found)
        reason += f" ({alike} of {len(runs)} runs)"
    return str(worst["trust"]), reason


def _verdict(run: Run) -> Mapping[str, Any]:
    verdict = run.metrics.get("verdict")
    known = isinstance(verdict, Mapping) and verdict.get("trust") in _WORST_FIRST
    return verdict if known and isinstance(verdict, Mapping) else {}


def _accuracy(result: RouteResult, runs: Sequence[Run]) -> Iterator[Figure]:
    """Errors of the output as `localize` states them: from its first pose on poles on."""
    stated = [kf for run in runs if isinstance(kf := run.metrics.get("kf"), Mapping)]
    if not stated:
        yield Figure("–", "accuracy: the drive has no reference to hold the poses against")
        return
    against = f" (rms, against the {result.against})" if result.against else " (rms)"
    for key, name, scale, unit in (
        ("lateral_rmse_m", "lateral error of the output", 1.0, " m"),
        ("longitudinal_rmse_m", "error along", 1.0, " m"),
        ("yaw_rmse_rad", "error of the yaw", float(np.degrees(1.0)), "°"),
    ):
        value = _mean([one.get(key) for one in stated])
        if np.isfinite(value):
            yield Figure(number(scale * value, 2) + unit, name + against)
            against = ""


def _from_runs(runs: Sequence[Run]) -> Iterator[Figure]:
    grounds = [verdict for run in runs if (verdict := _verdict(run))]
    healthy = _mean([one.get("healthy_share") for one in grounds])
    if np.isfinite(healthy):
        yield Figure(f"{100 * healthy:.0f} %", "of the output was called healthy")
    stated = _mean([one.get("position_sd_m") for one in grounds])
    if np.isfinite(stated):
        yield Figure(f"{stated:.2f} m", "position deviation that the output states (median)")
    factor = _mean([run.metrics.get("real_time_factor") for run in runs])
    if np.isfinite(factor):
        # a busy machine or large pictures may take seconds a frame
        shown = f"{factor:.1f}" if factor >= 1.0 else f"{factor:.2g}"
        yield Figure(f"{shown} ×", "real time: seconds of driving in a second of computing")


def _repeatability(result: RouteResult) -> Iterator[Figure]:
    kf = result.of_kind("kf")
    if kf is not None and np.isfinite(kf.sd_m):
        yield Figure(
            f"{kf.sd_m:.2f} m", "repeatability over the laps; most of it is the driver's wander"
        )


def _mean(values: Sequence[Any]) -> float:
    known = [float(value) for value in values if isinstance(value, int | float)]
    known = [value for value in known if np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")
