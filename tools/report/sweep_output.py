"""What a sweep says: a table, a picture like the source paper's Figs 6 and 7, and values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from polemap.tools.report.style import COLOURS, INK, Picture, drawing, finish, legend_above, tidy
from polemap.tools.report.sweeps import SweptRoute, SweptValue
from polemap.tools.report.tables import Table, number, with_spread
from polemap.tools.report.write import SweepOutput

_NAMES = {"frame_rate": "frame rate [Hz]", "particles": "particles"}


def sweep_output(swept: Sequence[SweptRoute], notes: Sequence[str]) -> SweepOutput:
    """Tables, pictures and values of all sweeps."""
    values: dict[str, dict[str, Any]] = {}
    tables, pictures = [], []
    for one in swept:
        route = one.result.route.name
        values.setdefault(one.sweep.name, {})[route] = [_values(one, v) for v in one.values]
    for name in dict.fromkeys(one.sweep.name for one in swept):
        group = [one for one in swept if one.sweep.name == name]
        tables.append(_table(name, group))
        slug = "".join(letter if letter.isalnum() else "-" for letter in name)
        pictures += [_picture(one, f"sweep-{slug}-{i}") for i, one in enumerate(group)]
    return SweepOutput(values, tuple(tables), tuple(pictures), tuple(notes))


def _values(one: SweptRoute, swept: SweptValue) -> dict[str, Any]:
    reinitializations = swept.total("reinitializations")
    result: dict[str, Any] = {
        "value": swept.value.label,
        "runs": len(swept.runs),
        "pf_m": swept.pf.sd_m,
        "pf_spread_m": swept.pf.spread_m,
        "kf_m": swept.kf.sd_m,
        "kf_spread_m": swept.kf.spread_m,
        "reinitializations": reinitializations,
        "reinitializations_by_cause": swept.causes(),
        "reinitializations_mean": float(np.mean(reinitializations)),
        "exploration_events_mean": float(np.mean(swept.total("exploration_events"))),
        "kf_lateral_rmse_m": _accuracy(swept, "lateral_rmse_m")[0],
        "kf_lateral_rmse_spread_m": _accuracy(swept, "lateral_rmse_m")[1],
    }
    if one.sweep.name == "frame_rate":
        result["frame_rate_hz"] = one.frame_rate_hz / swept.value.every
    return result


def _table(name: str, group: Sequence[SweptRoute]) -> Table:
    rows = []
    for one in group:
        for swept in one.values:
            counts = swept.total("reinitializations")
            rows.append(
                (
                    one.result.route.name,
                    _label(one, swept),
                    str(len(swept.runs)),
                    with_spread(swept.pf.sd_m, swept.pf.spread_m),
                    with_spread(swept.kf.sd_m, swept.kf.spread_m),
                    with_spread(*_accuracy(swept, "lateral_rmse_m")),
                    number(float(np.mean(counts)), 2),
                    str(max(counts)),
                    ", ".join(f"{n} {cause}" for cause, n in swept.causes().items() if n) or "–",
                )
            )
    return Table(
        f"sweep-{''.join(c if c.isalnum() else '-' for c in name)}",
        f"Sweep: {_NAMES.get(name, name)}",
        (
            "Route",
            _NAMES.get(name, name),
            "Runs",
            "PF repeatability [m]",
            "KF repeatability [m]",
            "KF lateral RMSE [m]",
            "Re-initializations per run",
            "most",
            "causes",
        ),
        tuple(rows),
        "Mean ± standard deviation over the runs; same laps, stations and exclusions as above. The "
        "lateral error is that of the output filter every 0.1 m, so that standing does not count.",
    )


def _picture(one: SweptRoute, key: str) -> Picture:
    numbers = [_place(one, swept) for swept in one.values]
    ordered = all(n is not None for n in numbers)
    places = [float(n) for n in numbers if n is not None] if ordered else list(range(len(numbers)))
    order = np.argsort(places)
    x = np.array(places, dtype=np.float64)[order]
    values = [one.values[i] for i in order]
    with drawing(5.4, 4.2) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1.3))
        for kind in ("pf", "kf"):
            systems = [getattr(v, kind) for v in values]
            mean = 100 * np.array([s.sd_m for s in systems])
            spread = 100 * np.nan_to_num([s.spread_m for s in systems])
            upper.errorbar(
                x, mean, spread, color=COLOURS[kind], marker="o", ms=4, capsize=3, label=kind
            )
        errors = 100 * np.array([_accuracy(v, "lateral_rmse_m") for v in values])
        if np.isfinite(errors[:, 0]).all():
            label = f"kf against the {one.result.against}"
            upper.errorbar(
                x, errors[:, 0], np.nan_to_num(errors[:, 1]), color=COLOURS["kf"], ls="--",
                marker="s", mfc="none", ms=4, capsize=3, label=label,
            )  # fmt: skip
        upper.set_ylim(bottom=0.0)
        legend_above(upper)
        tidy(upper, "", "lateral sd or rms [cm]", one.result.route.name)
        counts = [v.total("reinitializations") for v in values]
        for place, runs in zip(x, counts, strict=True):
            lower.plot([place] * len(runs), runs, ".", color=COLOURS["pf"], ms=4, mew=0)
        lower.plot(x, [np.mean(runs) for runs in counts], color=INK, lw=1.0)
        most = max(max(runs) for runs in counts)
        lower.set_ylim(-0.1 * max(most, 1), 1.1 * max(most, 1))
        lower.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=4))
        tidy(lower, _NAMES.get(one.sweep.name, one.sweep.name), "re-init. per run")
        if ordered and len(x) > 2 and x[0] > 0 and x[-1] / x[0] > 8:
            lower.set_xscale("log")
        if len(x) <= 9:
            labels = [_label(one, v) for v in values]
            lower.set_xticks(x, labels)
            lower.xaxis.set_minor_formatter(NullFormatter())
        else:
            lower.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        caption = (
            f"Repeatability of both filters, and lateral error where it is known; "
            f"{len(values[0].runs)} runs a value, bars: one standard deviation."
        )
        title = f"Sweep of {_NAMES.get(one.sweep.name, one.sweep.name)}"
        return finish(figure, key, title, caption)


def _place(one: SweptRoute, swept: SweptValue) -> float | None:
    if one.sweep.name == "frame_rate":
        return one.frame_rate_hz / swept.value.every
    return swept.value.number


def _label(one: SweptRoute, swept: SweptValue) -> str:
    if one.sweep.name == "frame_rate":
        return f"{one.frame_rate_hz / swept.value.every:.1f}"
    return swept.value.label


def _accuracy(swept: SweptValue, key: str) -> tuple[float, float]:
    values = [run[key] for run in swept.kf.accuracy if key in run]
    if not values:
        return float("nan"), float("nan")
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")
    return float(np.mean(values)), spread
