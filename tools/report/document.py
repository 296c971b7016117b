"""`report.json`: the same numbers as the page, for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from polemap.evaluation.results import RouteResult, SystemResult
from polemap.parsing.json_text import plain_values
from polemap.tools.report.route_tables import passes_text, poles_per_km, route_type
from polemap.tools.report.run_tables import EVENTS, latency_ms, runs_of, whole_update_ms
from polemap.tools.report.tables import Table

FORMAT_VERSION = 1


def document(
    results: Sequence[RouteResult],
    head: Mapping[str, Any],
    comparison: Sequence[Mapping[str, Any]],
    sweeps: Mapping[str, Any],
    tables: Sequence[Table],
) -> dict[str, Any]:
    """The whole report as plain values; NaN becomes null."""
    content = {
        "format_version": FORMAT_VERSION,
        **head,
        "repeatability": {
            key: value for result in results for key, value in _repeatability(result).items()
        },
        "routes": {result.route.name: _route(result) for result in results},
        "accuracy": {result.route.name: _accuracy(result) for result in results if result.against},
        "timing": {result.route.name: _timing(result) for result in results},
        "events": {result.route.name: _events(result) for result in results},
        "comparison": list(comparison),
        "sweeps": dict(sweeps),
        "notes": [note for result in results for note in result.notes],
        "tables": {
            table.key: {"columns": list(table.columns), "rows": [list(r) for r in table.rows]}
            for table in tables
        },
    }
    cleaned: dict[str, Any] = plain_values(content)
    return cleaned


def document_text(content: Mapping[str, Any]) -> str:
    """JSON text without NaN."""
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _repeatability(result: RouteResult) -> dict[str, dict[str, Any]]:
    """One entry a route and setting, the documented keys first."""
    named = {one.system.name: one for one in result.systems}
    entries = {}
    for setting in result.route.setting_names:
        label = result.route.setting_mark(setting)
        pf, kf = named[f"pf{label}"], named[f"kf{label}"]
        systems = [pf, kf] + [one for one in result.systems if one.system.kind not in ("pf", "kf")]
        reference, truth = result.of_kind("reference"), result.of_kind("truth")
        entry: dict[str, Any] = {
            "pf_m": pf.sd_m,
            "kf_m": kf.sd_m,
            "reference_m": reference.sd_m if reference else None,
            "laps": max((len(s.passes) for s in result.stretches), default=1),
            "runs": len(pf.repeatability),
            "truth_m": truth.sd_m if truth else None,
            "laps_text": passes_text(result),
            "course_m": sum(s.path.length_m for s in result.stretches),
            "lap_times_s": [
                [{"name": p.name, "start_s": p.start_s, "end_s": p.end_s} for p in s.passes]
                for s in result.stretches
            ],
            "judged_by": result.judge,
            "excluded": [
                {
                    "road": one.stretch + 1,
                    "lap": None
                    if one.pass_row is None
                    else result.stretches[one.stretch].passes[one.pass_row].name,
                    "start_m": one.start_m,
                    "end_m": one.end_m,
                    "reason": one.reason,
                }
                for one in result.exclusions
            ],
            "systems": {one.system.name: _system(one) for one in systems},
        }
        entries[result.route.name + label] = entry
    return entries


def _system(one: SystemResult) -> dict[str, Any]:
    low, high = one.interval_m()

    def mean(name: str) -> float:
        return float(np.mean([getattr(run, name) for run in one.repeatability]))

    return {
        "mean_m": one.sd_m,
        "spread_m": one.spread_m,
        "low_m": low,
        "high_m": high,
        "unbiased_m": mean("unbiased_m"),
        "population_m": mean("population_m"),
        "effective_freedom": mean("freedom"),
        "stations_share": mean("share"),
        "lost_share": float(np.mean(one.lost_share)),
        "true_lateral_rms_m": float(np.mean(one.true_lateral_rms_m))
        if one.true_lateral_rms_m
        else None,
        "per_run_m": [run.sd_m for run in one.repeatability],
    }


def _route(result: RouteResult) -> dict[str, Any]:
    guides = [recording.guide for recording in result.route.recordings]
    poles = result.route.pole_map
    return {
        "type": route_type(result),
        "driven_m": sum(float(guide.travelled_m()[-1]) for guide in guides),
        "duration_s": sum(float(guide.stamp_s[-1] - guide.stamp_s[0]) for guide in guides),
        "poles_per_km": poles_per_km(result),
        "map_poles": None if poles is None else len(poles),
        "frame": None if poles is None else str(poles.frame),
        "recordings": [recording.name for recording in result.route.recordings],
        "settings": [n or result.route.recordings[0].main.name for n in result.route.setting_names],
    }


def _accuracy(result: RouteResult) -> dict[str, Any]:
    systems: dict[str, Any] = {}
    for one in result.systems:
        if one.accuracy and one.accuracy[0]:
            keys = one.accuracy[0].keys()
            values = {key: [run[key] for run in one.accuracy if key in run] for key in keys}
            systems[one.system.name] = {
                **{key: float(np.mean(v)) for key, v in values.items()},
                "per_run_position_rmse_m": values.get("position_rmse_m", []),
                "spread": {
                    key: float(np.std(v, ddof=1)) for key, v in values.items() if len(v) > 1
                },
            }
    own = [recording.reference_sd_m for recording in result.route.recordings]
    known = [sd for sd in own if math.isfinite(sd)]
    return {
        "against": result.against,
        "reference_sd_m": float(np.median(known)) if known else None,
        "systems": systems,
    }


def _timing(result: RouteResult) -> dict[str, Any]:
    runs = [run for group in runs_of(result, result.route.setting_names[0]) for run in group]
    stages: dict[str, dict[str, list[float]]] = {}
    for run in runs:
        for stage, figures in run.metrics.get("timing_ms", {}).items():
            if isinstance(figures, Mapping):
                for key, value in figures.items():
                    if isinstance(value, int | float):
                        stages.setdefault(stage, {}).setdefault(key, []).append(float(value))
    lag = latency_ms(runs)
    factors = [run.metrics.get("real_time_factor") for run in runs]
    known = [float(f) for f in factors if isinstance(f, int | float)]
    return {
        "stages_ms": {
            stage: {key: float(np.median(values)) for key, values in figures.items()}
            for stage, figures in stages.items()
        },
        "whole_update_ms": _quantiles(whole_update_ms(runs)),
        "latency_ms": _quantiles(lag),
        "real_time_factor": float(np.median(known)) if known else None,
    }


def _quantiles(values: tuple[float, float, float] | None) -> dict[str, float] | None:
    return None if values is None else dict(zip(("median", "p95", "p99"), values, strict=True))


def _events(result: RouteResult) -> dict[str, Any]:
    events = {}
    for setting in result.route.setting_names:
        groups = runs_of(result, setting)
        events[setting or result.route.recordings[0].main.name] = {
            key: [sum(int(run.metrics.get(key, 0)) for run in runs) for runs in groups]
            for key in EVENTS
        }
    return events
