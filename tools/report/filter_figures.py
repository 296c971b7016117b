"""Pictures of the filters at work: errors, consistency, poles, time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from polemap.drivelog.landmark_kind import LandmarkKind, kind_name
from polemap.evaluation.localizability import HELD_SD_M, Localizability
from polemap.evaluation.results import RouteResult, SystemResult
from polemap.tools.report.route_bound import PRIOR_SD, STEP_M, route_bound
from polemap.tools.report.run_tables import STAGE_NAMES, runs_of
from polemap.tools.report.style import (
    COLOURS,
    FAINT,
    INK,
    LAPS,
    SHADE,
    Picture,
    drawing,
    finish,
    legend_above,
    plain_log,
    thin,
    tidy,
)
from polemap.vehicle.pose import rotate, rotate_covariance

Floats = NDArray[np.float64]

CHI2_99 = 11.345
LEAST_SHOWN = 1e-3
# recordings that a legend has room to name
_NAMED = 10


def errors_over_time(result: RouteResult, key: str) -> Picture | None:
    """Errors of the first run over time; of one recording with the filter's own 3-sigma band."""
    kf, pf = result.of_kind("kf"), result.of_kind("pf")
    if kf is None or pf is None or not any(len(one.stamp_s) for one in kf.errors):
        return None
    several = len(kf.errors) > 1
    band = None if several else _output_sds(result, kf)
    names = [recording.name for recording in result.route.recordings]
    with drawing(8.0, 4.6) as figure:
        all_axes = figure.subplots(3, 1, sharex=True)
        panels = (("lateral_m", "lateral [m]", 1.0), ("longitudinal_m", "longitudinal [m]", 1.0),
                  ("yaw_rad", "yaw [°]", float(np.degrees(1.0))))  # fmt: skip
        for row, (axes, (kind, label, scale)) in enumerate(zip(all_axes, panels, strict=True)):
            if band is not None:
                begin = float(kf.errors[0].stamp_s[0])
                late = band[0] >= begin
                time, width = thin(band[0][late] - begin, 3.0 * scale * band[1][late, row])
                axes.fill_between(time, -width, width, color=SHADE, lw=0, label="3σ of the kf")
            for number, (ours, theirs) in enumerate(zip(kf.errors, pf.errors, strict=True)):
                if not len(ours.stamp_s):
                    continue
                colour = LAPS[number % len(LAPS)]
                begin = float(ours.stamp_s[0])
                for one, errors, width_pt in ((pf, theirs, 0.5), (kf, ours, 0.9)):
                    time, values = thin(errors.stamp_s - begin, scale * getattr(errors, kind))
                    if several:
                        name = names[number] if one is kf and len(names) <= _NAMED else None
                        style = {"color": colour, "alpha": 1.0 if one is kf else 0.4}
                    else:
                        name, style = one.system.name, {"color": COLOURS[one.system.kind]}
                    axes.plot(time, values, lw=width_pt, label=name, **style)
            limit = _robust_limit(
                [scale * getattr(one, kind) for one in (*pf.errors, *kf.errors) if len(one.stamp_s)]
            )
            axes.set_ylim(-limit, limit)
            tidy(axes, "", label)
        legend_above(all_axes[0])
        all_axes[-1].set_xlabel("time [s]")
        told = (
            f"First run of each of the {len(kf.errors)} recordings, each from its first pose on "
            "poles: output filter, and particle filter pale."
            if several
            else "First run, from its first pose on poles. Band: three standard deviations that "
            "the output filter states, in the direction of the error."
        )
        return finish(figure, key, f"Errors against the {result.against}", told)


def _output_sds(result: RouteResult, kf: SystemResult) -> tuple[Floats, Floats] | None:
    """Stamps `(n,)` and lateral, longitudinal and yaw sd `(n, 3)` of the first run's output."""
    run = runs_of(result, kf.system.setting)[0][0]
    kept = run.output_covariance()
    if kept is None:
        return None
    stamps, covariance = kept
    yaw = run.kf.at(stamps)[:, 2]
    own = rotate_covariance(covariance, -yaw)
    variances = np.stack([own[:, 1, 1], own[:, 0, 0], own[:, 2, 2]], axis=1)
    return stamps, np.sqrt(np.maximum(np.nan_to_num(variances), 0.0))


def consistency(result: RouteResult, key: str) -> Picture | None:
    """NIS of the particle filter's poses at the gate, and NEES of the output, over time."""
    kf = result.of_kind("kf")
    if kf is None:
        return None
    series = [s for s in (_nis(result, kf), _nees(result, kf)) if s is not None]
    if not series:
        return None
    begin = min(float(stamps[0]) for _, stamps, _ in series)
    with drawing(8.0, 0.8 + 1.7 * len(series)) as figure:
        all_axes = figure.subplots(len(series), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (name, stamps, values) in zip(all_axes, series, strict=True):
            time, shown = thin(stamps - begin, values)
            axes.plot(time, shown, ".", ms=2.5, color=COLOURS["pf"], mew=0)
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
            for level, style in ((3.0, "-"), (CHI2_99, "--")):
                axes.axhline(level, color=INK, lw=0.8, ls=style)
            above = 100.0 * float(np.mean(values > CHI2_99))
            tidy(axes, "", "", f"{name}: mean {np.mean(values):.2f}, {above:.1f} % above 99 %")
        all_axes[-1].set_xlabel("time [s]")
        return finish(
            figure,
            key,
            "Consistency",
            "Three degrees of freedom: line at the expected mean of 3, dashed at the 99 % "
            "quantile. NIS: particle-filter pose against prediction; NEES: output against the "
            f"{result.against}. First run.",
        )


def _nis(result: RouteResult, kf: SystemResult) -> tuple[str, Floats, Floats] | None:
    run = runs_of(result, kf.system.setting)[0][0]
    stamps, values = run.health_numbers("stamp_s"), run.health_numbers("nis", "gate_nis")
    if stamps is None or values is None:
        return None
    good = np.isfinite(values) & (values > 0.0)
    return (
        ("NIS at the gate", stamps[good], np.maximum(values[good], LEAST_SHOWN))
        if good.any()
        else None
    )


def _nees(result: RouteResult, kf: SystemResult) -> tuple[str, Floats, Floats] | None:
    sds = _output_sds(result, kf)
    run = runs_of(result, kf.system.setting)[0][0]
    kept = run.output_covariance()
    if sds is None or kept is None or not kf.errors or len(kf.errors[0].stamp_s) < 2:
        return None
    stamps, covariance = kept
    goals = kf.errors[0]
    # Back from the vehicle's axes to the map's, at the stamps that have a reference.
    rows = np.clip(np.searchsorted(stamps, goals.stamp_s), 0, len(stamps) - 1)
    yaw = run.kf.at(goals.stamp_s)[:, 2] - goals.yaw_rad
    along_across = np.stack([goals.longitudinal_m, goals.lateral_m], axis=1)
    error = np.column_stack([rotate(along_across, yaw), goals.yaw_rad])
    known = np.isfinite(error).all(axis=1) & np.isfinite(covariance[rows]).all(axis=(1, 2))
    error, chosen = error[known], covariance[rows][known]
    definite = np.linalg.eigvalsh(chosen)[:, 0] > 0.0
    error, chosen = error[definite], chosen[definite]
    if len(error) == 0:
        return None
    values = np.sum(error * np.linalg.solve(chosen, error[..., None])[..., 0], axis=1)
    return (
        "NEES of the output filter",
        goals.stamp_s[known][definite],
        np.maximum(values, LEAST_SHOWN),
    )


def poles_along_route(result: RouteResult, key: str) -> Picture | None:
    """Poles seen, matched and expected at every update of the first run."""
    kf = result.of_kind("kf")
    if kf is None:
        return None
    run = runs_of(result, kf.system.setting)[0][0]
    stamp = run.health_numbers("stamp_s", "stamp")
    columns = (
        (
            "in view of the map",
            FAINT,
            run.health_numbers("in_view", "map_in_view", "map_poles_in_view"),
        ),
        ("seen", COLOURS["pf"], run.health_numbers("seen", "seen_poles")),
        ("matched", COLOURS["kf"], run.health_numbers("matched", "matched_poles")),
    )
    if stamp is None or all(values is None for _, _, values in columns):
        return None
    track = run.kf
    place = np.interp(stamp, track.stamp_s, track.travelled_m())
    with drawing(8.0, 2.6) as figure:
        axes = figure.add_subplot()
        for name, colour, values in columns:
            if values is not None:
                distance, mean = binned(place, values, 10.0)
                axes.plot(distance, mean, color=colour, label=name, drawstyle="steps-mid")
        axes.set_ylim(bottom=0.0)
        tidy(axes, "distance driven [m]", "poles per update")
        legend_above(axes)
        return finish(
            figure, key, "Pole observations along the route", "Means over 10 m, first run."
        )


def localizability_picture(result: RouteResult, key: str) -> Picture | None:
    """What the map's poles allow along the first recording, in one look."""
    found = route_bound(result)
    if found is None:
        return None
    bound = found.bound
    kinds = list(bound.by_kind) if set(bound.by_kind) - {LandmarkKind.POLE} else []
    extra = [0.2 + 0.25 * len(kinds)] if kinds else []
    with drawing(8.0, 3.6 + sum(extra)) as figure:
        upper, lower, *strip = figure.subplots(
            2 + len(extra), 1, sharex=True, height_ratios=(2.0, 1.0, *extra)
        )
        if kinds:
            _draw_holders(strip[0], bound, kinds)
        for name, values, colour in (
            ("lateral", bound.lateral_sd_m, COLOURS["kf"]),
            ("longitudinal", bound.longitudinal_sd_m, COLOURS["pf"]),
        ):
            upper.plot(bound.distance_m, values, color=colour, label=name, lw=0.9)
        upper.set_yscale("log")
        upper.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        upper.yaxis.set_minor_formatter(NullFormatter())
        legend_above(upper)
        tidy(upper, "", "sd [m]")
        lower.plot(
            bound.distance_m, bound.poles_in_view, color=COLOURS["pole"], drawstyle="steps-mid"
        )
        lower.set_ylim(bottom=0)
        tidy(lower, "" if kinds else "distance driven [m]", "poles expected")
        return finish(
            figure,
            key,
            "Localizability",
            f"Position standard deviation that one look at the mapped poles allows (Cramér–Rao "
            f"bound, errors of {found.errors_of}, {found.range_m:.0f} m of view, heading known to "
            f"{PRIOR_SD[1]} rad before); a filter gathers many looks. Poles expected: sightings, "
            "with the probabilities that a mapped pole stands and is seen."
            + (
                f" Bars: where one kind alone holds the pose to {HELD_SD_M} m, aside (upper half) "
                "and along the street (lower half)."
                if kinds
                else ""
            ),
        )


def _draw_holders(axes: Any, bound: Localizability, kinds: list[LandmarkKind]) -> None:
    """Where each kind alone holds the pose, a row of bars each."""
    at, step = bound.distance_m, np.diff(bound.distance_m, append=bound.distance_m[-1] + STEP_M)
    for row, kind in enumerate(kinds):
        for held, up, colour in zip(
            bound.holding(kind), (0.02, -0.38), (COLOURS["kf"], COLOURS["pf"]), strict=True
        ):
            spans = np.column_stack([at, step])[held]
            axes.broken_barh([tuple(s) for s in spans.tolist()], (up - row, 0.36), color=colour)
    names = [kind_name(kind) for kind in kinds]
    axes.set_yticks([-row for row in range(len(kinds))], names)
    axes.set_ylim(-len(kinds) + 0.5, 0.5)
    axes.grid(visible=False, axis="y")
    tidy(axes, "distance driven [m]", "held by")


def timing_picture(result: RouteResult, key: str) -> Picture | None:
    """Histogram of the time an update takes by stage, or its quantiles where only they exist."""
    runs = [run for group in runs_of(result, result.route.setting_names[0]) for run in group]
    columns = [name for name in runs[0].timings if name.endswith("_ms")]
    if columns:
        with drawing(8.0, 3.0) as figure:
            axes = figure.add_subplot()
            for number, name in enumerate(columns):
                good = np.concatenate([r.timings[name] for r in runs if name in r.timings])
                good = good[np.isfinite(good) & (good > 0)]
                if len(good) == 0:
                    continue
                bins = np.geomspace(max(good.min(), 1e-3), good.max() * 1.01, 60)
                label = STAGE_NAMES.get(name[:-3], name[:-3])
                colour = LAPS[number % len(LAPS)]
                axes.hist(good, bins.tolist(), histtype="step", color=colour, label=label)
            plain_log(axes)
            tidy(axes, "time of an update [ms]", "updates")
            legend_above(axes)
            return finish(figure, key, "Processing time", "All runs.")
    stages = [
        (n, f) for n, f in runs[0].metrics.get("timing_ms", {}).items() if isinstance(f, dict)
    ]
    if not stages:
        return None
    with drawing(8.0, 1.0 + 0.35 * len(stages)) as figure:
        axes = figure.add_subplot()
        for place, (_, figures) in enumerate(reversed(stages)):
            marks = [float(figures.get(q) or np.nan) for q in ("median", "p95", "p99")]
            axes.plot([marks[0], marks[2]], [place, place], color=FAINT, lw=1.0)
            for value, mark in zip(marks, ("o", "|", "|"), strict=True):
                axes.plot(value, place, mark, color=COLOURS["kf"], ms=7 if mark == "|" else 5)
        axes.set_yticks(range(len(stages)), [name for name, _ in reversed(stages)])
        plain_log(axes)
        tidy(axes, "time [ms]", "")
        return finish(figure, key, "Processing time", "Median (dot), p95 and p99, first run.")


def binned(place: Floats, values: Floats, width: float) -> tuple[Floats, Floats]:
    """Means of `values` over bins of `place`, at the middles of the bins."""
    good = np.isfinite(place) & np.isfinite(values)
    row = (place[good] / width).astype(np.int64)
    count = np.bincount(row)
    filled = count > 0
    mean = np.bincount(row, values[good])[filled] / count[filled]
    middle = (np.flatnonzero(filled) + 0.5) * width
    return np.asarray(middle, dtype=np.float64), mean


def _robust_limit(series: Sequence[Floats]) -> float:
    """Axis limit that one excursion does not blow up: 1.5 times the 99.5 % quantile."""
    largest = max((float(np.quantile(np.abs(v), 0.995)) for v in series if len(v)), default=1.0)
    return max(1.5 * largest, 1e-3)
