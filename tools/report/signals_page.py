"""The page of signals: its sections, and that of an estimate, in one HTML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap import __version__
from polemap.electric.gaps import find_gaps
from polemap.electric.signals import Played, SignalLog
from polemap.electric.watched import Fault, Record
from polemap.tools.report.page import page_environment, style_sheet
from polemap.tools.report.style import (
    COLOURS,
    Picture,
    drawing,
    finish,
    legend_above,
    thin,
    tidy,
)
from polemap.tools.report.tables import Table, number

Floats = NDArray[np.float64]
BAND_POINTS = 1200
# a reference column of the log for a field of the estimate
REFERENCES = {"vx_mps": "vx_reference_mps", "heading_rad": "", "lateral_offset_m": ""}
LABELS = {
    "sideslip_rad": ("side-slip, degrees", 180.0 / np.pi),
    "yaw_rate_radps": ("yaw rate, degrees/s", 180.0 / np.pi),
    "heading_rad": ("heading, degrees", 180.0 / np.pi),
    "lateral_offset_m": ("lateral offset, m", 1.0),
    "vx_mps": ("forward velocity, m/s", 1.0),
    "vy_mps": ("lateral velocity, m/s", 1.0),
    "bank_rad": ("bank of the road, degrees", 180.0 / np.pi),
    "grade_rad": ("grade of the road, degrees", 180.0 / np.pi),
}


@dataclass(frozen=True, slots=True)
class Headline:
    """A figure that stands large."""

    value: str
    label: str


@dataclass(frozen=True, slots=True)
class SignalSection:
    """One estimate or one study on the page."""

    anchor: str
    name: str
    title: str
    tables: tuple[Table, ...]
    pictures: tuple[Picture, ...]
    figures: tuple[Headline, ...] = ()
    notes: tuple[str, ...] = ()


def render_signals(title: str, sections: Sequence[SignalSection]) -> str:
    """The HTML text; what comes from logs passes through the template's escaping."""
    template = page_environment().get_template("signals.html.j2")
    return template.render(
        title=title, version=__version__, css=style_sheet(), sections=list(sections)
    )


def estimate_section(
    name: str,
    log: SignalLog,
    played: Played,
    at_reference: Floats | None,
    record: Record,
    scores: Mapping[str, object],
) -> SignalSection:
    """Time histories with bands, errors, innovations and faults of one estimate.

    `at_reference` `(n,)` is the side-slip at the reference's place, None without a reference.
    """
    gaps = [Fault("log", "no row", gap.from_s, gap.to_s, 0) for gap in find_gaps(log)]
    faults = sorted([*record.faults, *gaps], key=lambda one: one.from_s)
    pictures = [
        _history(name, field, log, played, at_reference, faults)
        for field in played.fields
        if field in LABELS
    ]
    if at_reference is not None:
        pictures.insert(1, _error(log, played, at_reference, faults))
    if record.innovations:
        pictures.append(_innovations(record, faults))
    pictures.append(_inputs(log, faults))
    return SignalSection(
        "estimate", name, f"Estimate of {name}", (_fault_table(faults),), tuple(pictures),
        tuple(_headlines(scores, record, faults)),
    )  # fmt: skip


def _headlines(
    scores: Mapping[str, object], record: Record, faults: Sequence[Fault]
) -> list[Headline]:
    found = []
    for key, label, unit in (
        ("sideslip_rmse_deg", "side-slip, RMSE", "°"),
        ("sideslip_p95_deg", "side-slip, p95", "°"),
        ("sideslip_nees", "side-slip, NEES (1 where honest)", ""),
        ("vx_rmse_mps", "forward velocity, RMSE", " m/s"),
        ("vy_rmse_mps", "lateral velocity, RMSE", " m/s"),
    ):
        value = scores.get(key)
        if isinstance(value, int | float):
            found.append(Headline(f"{value:.3f}{unit}", label))
    for signal, one in record.innovations.items():
        off = np.abs(one.normalised()[1])
        label = f"of {_plain(signal)} innovations within two deviations (95 where honest)"
        found.append(Headline(f"{100.0 * float(np.mean(off < 2.0)):.0f} %", label))
    found.append(Headline(str(len(faults)), "faults and gaps found"))
    return found


def _fault_table(faults: Sequence[Fault]) -> Table:
    rows = tuple(
        (one.sensor.replace("_", " "), one.what, number(one.from_s, 2), number(one.to_s, 2),
         str(one.count) if one.count else "–")
        for one in faults[:200]
    )  # fmt: skip
    note = "" if rows else "No value was refused and the log has no gap."
    if len(faults) > 200:
        note = f"The first 200 of {len(faults)}."
    columns = ("sensor", "what", "from, s", "to, s", "values")
    return Table("faults", "Faults found", columns, rows, note, text_columns=2)


def _band_rows(count: int) -> NDArray[np.int64]:
    return np.unique(np.linspace(0, count - 1, min(count, BAND_POINTS)).astype(np.int64))


def _shade(axes: object, faults: Sequence[Fault]) -> None:
    for one in faults[:200]:
        width = max(one.to_s - one.from_s, 1e-3)
        axes.axvspan(  # type: ignore[attr-defined]
            one.from_s, one.from_s + width, color=COLOURS["shade"], lw=1.0, zorder=0
        )


def _history(
    name: str,
    field: str,
    log: SignalLog,
    played: Played,
    at_reference: Floats | None,
    faults: Sequence[Fault],
) -> Picture:
    label, scale = LABELS[field]
    stamps = played.stamp_s
    mean, sd = scale * played.column(field), scale * played.sd_of(field)
    if field == "sideslip_rad" and at_reference is not None:
        mean = scale * at_reference
    reference = REFERENCES.get(field, field)
    truth = log.columns.get(reference) if reference else None
    # where there is an offset, headings are in the lane
    seen = field in ("heading_rad", "lateral_offset_m") and "lateral_offset_m" in played.fields
    measured = log.columns.get(field) if seen else None
    with drawing(9.0, 2.9) as figure:
        axes = figure.subplots()
        _shade(axes, faults)
        rows = _band_rows(len(stamps))
        axes.fill_between(
            stamps[rows], (mean - 2 * sd)[rows], (mean + 2 * sd)[rows], color=COLOURS["kf"],
            alpha=0.18, lw=0, label="two deviations",
        )  # fmt: skip
        shown = "reference" if field != "yaw_rate_radps" else "gyro"
        if truth is not None and np.isfinite(truth).any():
            known = np.isfinite(truth)
            x, y = thin(log.stamp_s[known], scale * truth[known])
            axes.plot(x, y, color=COLOURS["truth"], lw=1.0, label=shown)
        if measured is not None and np.isfinite(measured).any():
            known = np.isfinite(measured)
            x, y = thin(log.stamp_s[known], scale * measured[known])
            axes.plot(x, y, ".", ms=2, color=COLOURS["pf"], label="camera")
        axes.plot(*thin(stamps, mean), color=COLOURS["kf"], label=name)
        tidy(axes, "time, s", label)
        legend_above(axes)
        caption = "The band is two stated deviations; shaded: faults found and gaps."
        return finish(figure, f"history_{field}", label.split(",")[0].capitalize(), caption)


def _error(
    log: SignalLog, played: Played, at_reference: Floats, faults: Sequence[Fault]
) -> Picture:
    scale = 180.0 / np.pi
    truth = log.columns["sideslip_rad"]
    known = np.isfinite(truth)
    stamps = played.stamp_s[known]
    error, sd = scale * (at_reference - truth)[known], scale * played.sd_of("sideslip_rad")[known]
    with drawing(9.0, 2.6) as figure:
        axes = figure.subplots()
        _shade(axes, faults)
        rows = _band_rows(len(stamps))
        axes.fill_between(
            stamps[rows], -2 * sd[rows], 2 * sd[rows], color=COLOURS["kf"], alpha=0.18, lw=0,
            label="two deviations",
        )  # fmt: skip
        axes.plot(*thin(stamps, error), color=COLOURS["kf"], lw=0.9, label="error")
        tidy(axes, "time, s", "side-slip error, degrees")
        legend_above(axes)
        inside = 100.0 * float(np.mean(np.abs(error) < 2.0 * sd)) if len(error) else 0.0
        caption = f"{inside:.0f} % of the errors lie within two stated deviations."
        return finish(figure, "error_sideslip", "Error of the side-slip", caption)


def _innovations(record: Record, faults: Sequence[Fault]) -> Picture:
    count = len(record.innovations)
    with drawing(9.0, 0.6 + 1.7 * count) as figure:
        plots = np.atleast_1d(figure.subplots(count, 1, sharex=True))
        for axes, (signal, one) in zip(plots, record.innovations.items(), strict=True):
            _shade(axes, faults)
            stamps, off = one.normalised()
            axes.axhspan(-2.0, 2.0, color=COLOURS["kf"], alpha=0.12, lw=0)
            x, y = thin(stamps, off)
            axes.plot(x, y, ".", ms=2, color=COLOURS["kf"])
            axes.set_ylim(-6.0, 6.0)
            tidy(axes, "", _plain(signal))
        plots[-1].set_xlabel("time, s")
        caption = (
            "What was measured less what was expected, over the deviation of that; values beyond "
            "six lie outside the picture. Of the gyro every so manyth value."
        )
        return finish(figure, "innovations", "Innovations", caption)


def _inputs(log: SignalLog, faults: Sequence[Fault]) -> Picture:
    scale = 180.0 / np.pi
    inputs = [
        (name, label, factor)
        for name, label, factor in (
            ("vx_mps", "speed, m/s", 1.0),
            ("road_wheel_angle_rad", "steering, degrees", scale),
            ("ay_mps2", "lateral acc., m/s²", 1.0),
            ("road_curvature_per_m", "curvature, 1/m", 1.0),
        )
        if log.has(name)
    ] or [("", "no inputs", 1.0)]
    with drawing(9.0, 0.6 + 1.4 * len(inputs)) as figure:
        plots = np.atleast_1d(figure.subplots(len(inputs), 1, sharex=True))
        for axes, (name, label, factor) in zip(plots, inputs, strict=True):
            _shade(axes, faults)
            if name:
                known = np.isfinite(log.columns[name])
                x, y = thin(log.stamp_s[known], factor * log.columns[name][known])
                axes.plot(x, y, color=COLOURS["reference"], lw=0.9)
            tidy(axes, "", label)
        plots[-1].set_xlabel("time, s")
        return finish(figure, "inputs", "Inputs", "What the estimator was driven by.")


def _plain(signal: str) -> str:
    stem, _, _ = signal.rpartition("_")
    return stem.replace("_", " ")
