"""Tables of the runs: errors, events, times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.evaluation.results import RouteResult, SystemResult
from polemap.evaluation.runs.io import Run
from polemap.tools.report.tables import Table, number, with_spread

# The stages of metrics.json and timing.csv, in the order of the data.
STAGE_NAMES = {
    "disparity": "disparity",
    "detection": "detection",
    "tracking": "tracking",
    "perception": "all of perception",
    "particle_filter": "particle filter, an update",
    "output_pose": "output filter, a pose taken in",
    "output_odometry": "output filter, an odometry sample",
    "output_tick": "output filter, a pose given out",
}
EVENTS = ("reinitializations", "exploration_events", "gate_rejections", "late_dropped")


def accuracy_table(results: Sequence[RouteResult]) -> Table:
    """Errors against the truth or the reference."""
    rows = []
    for result in results:
        for one in result.systems:
            if not one.accuracy or not one.accuracy[0]:
                continue
            rows.append(
                (
                    result.route.name,
                    one.system.name,
                    result.against or "–",
                    *(_over_runs(one, key) for key in ("lateral_rmse_m", "lateral_median_m")),
                    _over_runs(one, "lateral_p95_m"),
                    _over_runs(one, "longitudinal_rmse_m"),
                    _over_runs(one, "position_rmse_m"),
                    _over_runs(one, "position_p95_m"),
                    _over_runs(one, "yaw_rmse_rad", scale=float(np.degrees(1.0)), digits=2),
                    _over_runs(one, "start_position_rmse_m"),
                    _nees(result, one),
                )
            )
    sds = [r.reference_sd_m for result in results for r in result.route.recordings]
    known = [sd for sd in sds if np.isfinite(sd)]
    own = (
        f"The reference states a standard deviation of {np.median(known):.3f} m (median)."
        if known
        else "The reference does not state its own uncertainty."
    )
    return Table(
        "accuracy",
        "Accuracy",
        (
            "Route",
            "System",
            "Against",
            "Lateral RMSE [m]",
            "median [m]",
            "p95 [m]",
            "Longitudinal RMSE [m]",
            "Position RMSE [m]",
            "p95 [m]",
            "Yaw RMSE [°]",
            "Start: position RMSE [m]",
            "NEES / 3",
        ),
        tuple(rows),
        "At the stamps of the estimate, all recordings together; mean ± spread over runs. The "
        "output filter counts from its first pose on poles; what it gave before, from GNSS and "
        f"odometry, is its start. {own}",
        text_columns=3,
    )


def event_table(results: Sequence[RouteResult]) -> Table:
    """What happened to the filters, per run."""
    rows = []
    for result in results:
        for setting in result.route.setting_names:
            for_run = runs_of(result, setting)
            counts = {
                key: [sum(int(run.metrics.get(key, 0)) for run in runs) for runs in for_run]
                for key in EVENTS
            }
            label = result.route.setting_mark(setting)
            rows.append(
                (
                    result.route.name + label,
                    *(f"{np.mean(counts[key]):.2f} ({max(counts[key])})" for key in EVENTS),
                )
            )
    return Table(
        "events",
        "Events",
        ("Route", "Re-initializations", "Exploration events", "Gate rejections", "Late, dropped"),
        tuple(rows),
        "Mean per run, and in brackets the most in one run.",
    )


def kind_table(results: Sequence[RouteResult]) -> Table:
    """What was seen of every kind of landmarks, per run."""
    rows: list[tuple[str, ...]] = []
    for result in results:
        for setting in result.route.setting_names:
            found: dict[str, list[Mapping[str, Any]]] = {}
            for run in (run for group in runs_of(result, setting) for run in group):
                for kind, one in run.metrics.get("landmarks_by_kind", {}).items():
                    found.setdefault(str(kind), []).append(one)
            name = result.route.name + result.route.setting_mark(setting)
            rows += [(name, kind.replace("_", " "), *_of_kind(one)) for kind, one in found.items()]
    if not any(row[1] != "pole" for row in rows):
        rows = []  # of a map of poles alone the other tables tell
    return Table(
        "kinds",
        "Landmarks by kind",
        (
            "Route",
            "Kind",
            "In the map",
            "Seen",
            "Matched",
            "Matched [%]",
            "Suspended [times]",
            "Suspended [% of updates]",
            "Residual RMS [m]",
        ),
        tuple(rows),
        "Mean per recording and run; of lines, pieces are counted. A kind is suspended while "
        "its landmarks lie elsewhere than the map says. Residual: of those that match from their "
        "place in the map, of lines across.",
        text_columns=2,
    )


def _of_kind(found: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    def mean(key: str) -> float:
        values = [float(one[key]) for one in found if one.get(key) is not None]
        return float(np.mean(values)) if values else float("nan")

    seen, matched = mean("seen"), mean("matched")
    return (
        number(mean("in_map"), 0),
        number(seen, 0),
        number(matched, 0),
        number(100.0 * matched / seen if seen else float("nan"), 0),
        number(mean("suspensions"), 2),
        number(100.0 * mean("suspended_share"), 1),
        number(mean("residual_rms_m"), 3),
    )


def timing_table(results: Sequence[RouteResult], machine: str) -> Table:
    """The source paper's Table III with quantiles, and the latency of the pose."""
    rows: list[tuple[str, ...]] = []
    for result in results:
        setting = result.route.setting_names[0]
        runs = [run for group in runs_of(result, setting) for run in group]
        stages: dict[str, list[Mapping[str, float]]] = {}
        for run in runs:
            for stage, figures in run.metrics.get("timing_ms", {}).items():
                if isinstance(figures, Mapping):
                    stages.setdefault(stage, []).append(figures)
        for stage in [*(s for s in STAGE_NAMES if s in stages), *(stages.keys() - STAGE_NAMES)]:
            name = STAGE_NAMES.get(stage, stage)
            rows.append((result.route.name, name, *_quantiles(stages[stage])))
        for name, quantiles in (
            ("picture to pose, all stages", whole_update_ms(runs)),
            ("latency of the pose", latency_ms(runs)),
        ):
            if quantiles is not None:
                rows.append((result.route.name, name, *(number(v, 2) for v in quantiles)))
        factors = [
            run.metrics["real_time_factor"] for run in runs if "real_time_factor" in run.metrics
        ]
        if factors:
            text = number(float(np.median(factors)), 2)
            rows.append((result.route.name, "real-time factor", text, "–", "–"))
    machines = {
        str(run.metrics["machine"])
        for result in results
        for group in runs_of(result, result.route.setting_names[0])
        for run in group
        if "machine" in run.metrics
    }
    where = "; ".join(sorted(machines)) or f"{machine} (where this report was made)"
    return Table(
        "timing",
        "Processing times",
        ("Route", "Stage", "Median [ms]", "p95 [ms]", "p99 [ms]"),
        tuple(rows),
        "Quantiles over the calls of a run, median over the runs. Picture to pose: computing time "
        "of an update through all stages. Latency: age of a particle-filter pose when the output "
        f"filter gets it, by the stamps of the drive. Machine: {where}.",
        text_columns=2,
    )


def runs_of(result: RouteResult, setting: str) -> list[list[Run]]:
    """`[run][recording]` of one setting."""
    sets = [recording.settings[setting] for recording in result.route.recordings]
    return [[one.runs[number] for one in sets] for number in range(min(len(s.runs) for s in sets))]


def latency_ms(runs: Sequence[Run]) -> tuple[float, float, float] | None:
    """Median, p95 and p99 of the age of a pose when it reaches the output filter."""
    lags = [run.health_numbers("lag_s", "lag") for run in runs]
    return _pooled([1e3 * lag for lag in lags if lag is not None])


def whole_update_ms(runs: Sequence[Run]) -> tuple[float, float, float] | None:
    """Median, p95 and p99 of the computing time from the pictures to the pose taken in.

    Of updates that went through every stage of timing.csv.
    """
    kept = [run.timings for run in runs if run.timings]
    return _pooled([np.sum([v for n, v in t.items() if n.endswith("_ms")], axis=0) for t in kept])


def _pooled(values: Sequence[NDArray[np.float64]]) -> tuple[float, float, float] | None:
    joined = np.concatenate([one[np.isfinite(one)] for one in values] or [np.empty(0)])
    if len(joined) == 0:
        return None
    median, p95, p99 = (float(v) for v in np.quantile(joined, [0.5, 0.95, 0.99]))
    return (median, p95, p99)


def _over_runs(one: SystemResult, key: str, scale: float = 1.0, digits: int = 3) -> str:
    values = [scale * run[key] for run in one.accuracy if key in run]
    return with_spread(float(np.mean(values)), run_spread(values), digits) if values else "–"


def _nees(result: RouteResult, one: SystemResult) -> str:
    if one.system.kind not in ("pf", "kf"):
        return "–"
    values = []
    for runs in runs_of(result, one.system.setting):
        for run in runs:
            figures = run.metrics.get(one.system.kind)
            if isinstance(figures, Mapping) and figures.get("nees_mean") is not None:
                values.append(float(figures["nees_mean"]))
    return with_spread(float(np.mean(values)), run_spread(values), 2) if values else "–"


def run_spread(values: Sequence[float]) -> float:
    """Standard deviation over the runs; NaN for one."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")


def _quantiles(found: Sequence[Mapping[str, float]]) -> tuple[str, str, str]:
    def middle(key: str) -> str:
        values = [float(f[key]) for f in found if f.get(key) is not None]
        return number(float(np.median(values)), 2) if values else "–"

    return middle("median"), middle("p95"), middle("p99")
