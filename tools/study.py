"""`polemap study`: a source paper's simulation again, our figures beside its claims."""

from __future__ import annotations

import json
import sys
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from polemap.drivelog.atomic import atomic_file, atomic_folder, check_file, check_folder
from polemap.drivelog.errors import ConfigError
from polemap.electric.studies.papers import STUDIES
from polemap.electric.studies.study import Study
from polemap.extras import check_installed, need
from polemap.parsing.json_text import plain_values
from polemap.simulate.closed_loop.registry import LOOP_STUDIES
from polemap.tools.option_types import PageOption, page_possible
from polemap.tools.progress import progress
from polemap.vehicle.io import load_car

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TABLE = "{:<62} {:>24} {:>20}  {}"
_STYLES = ("k-", "C0-", "C1-", "C2-", "C3-", "C4-", "C5-", "C6-", "C7--", "C8--", "C9--")


def command(
    name: Annotated[
        str,
        typer.Argument(
            help="Estimation: W12, W13, W14, N13. Closed loops: N13-slip, N13-cornering, "
            "W13-lane-keeping, W14-lane-change, W14-margins, path-following, full-loop. all runs "
            "all but the last."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for picture, table and figures.")
    ] = None,
    seeds: Annotated[int | None, typer.Option("--seeds", min=1, help="Simulated drives.")] = None,
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", help="Car, the study's own by default.")
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option("--estimator", help="Closed loops: close it behind this one; repeatable."),
    ] = None,
    page: PageOption = True,
) -> None:
    """Rerun a source paper's simulation and set our figures beside its claims.

    Ratios and orderings are compared, since the papers print no noise and no steering amplitude.
    The column errata holds what an independent simulation of the corrected equations gave. The
    closed loops run the controllers on a two-track car behind estimators, or a car that steers
    along a path by the localizer's pose: full-loop with pictures all the way, which takes half an
    hour. A page of tables and pictures is written: study.html in
    the folder of --out, or study_NAME.html here.

    Examples:
        polemap study W14
        polemap study W13 --seeds 20 --out w13
        polemap study N13-cornering --estimator two_layer --estimator stiffness
        polemap study path-following --seeds 5 --out following
        polemap study all --out studies
    """
    known = {each.lower(): each for each in (*STUDIES, *LOOP_STUDIES)}
    wanted = name.lower().replace("_", "-")
    if wanted != "all" and wanted not in known:
        raise ConfigError(f"no study {name}; there are {', '.join(known.values())} and all")
    together = [
        each for each in known.values() if each not in LOOP_STUDIES or not LOOP_STUDIES[each].apart
    ]
    chosen = together if wanted == "all" else [known[wanted]]
    if estimator and chosen[0] not in LOOP_STUDIES:
        raise ConfigError(f"--estimator: {name} is no closed loop, it compares all estimators")
    if out is not None:
        check_installed("matplotlib")
        check_folder(out, "study", (vehicle,))
    shown = page and page_possible()
    beside = Path(f"study_{name}.html") if shown and out is None else None
    if beside is not None:
        check_file(beside, (vehicle,))
    results, sections = [], []
    for each in chosen:
        result, count = _run(each, vehicle, seeds, tuple(estimator or ()))
        results.append(result)
        if shown:
            sections.append((result, count))
        sys.stdout.write(table(result, count) + "\n")
        sys.stdout.flush()
    if out is not None:
        with atomic_folder(out, "study") as folder:
            for result in results:
                write_study(result, folder)
            if sections:
                write_page(folder / "study.html", sections)
        if sections:
            sys.stderr.write(f"wrote {out / 'study.html'}\n")
    elif beside is not None:
        write_page(beside, sections)
        sys.stderr.write(f"wrote {beside}\n")


def write_page(out: Path, studies: list[tuple[Study, int]]) -> None:
    """Tables and pictures of studies with their seeds, in one page."""
    # matplotlib is an extra: only who wants the page imports it
    from polemap.tools.report.signals_page import render_signals
    from polemap.tools.report.study_page import study_section

    sections = [study_section(study, seeds) for study, seeds in studies]
    title = sections[0].title if len(sections) == 1 else "The papers' studies"
    with atomic_file(out) as part:
        part.write_text(render_signals(title, sections), encoding="utf-8")


def _run(
    name: str, vehicle: str | None, seeds: int | None, estimators: tuple[str, ...]
) -> tuple[Study, int]:
    with progress(None, f"study {name}") as advance:
        if name in LOOP_STUDIES:
            entry = LOOP_STUDIES[name]
            count = seeds or entry.seeds
            return entry.run(load_car(vehicle or entry.car), count, advance, estimators), count
        function, usual = STUDIES[name]
        count = seeds or usual
        return function(load_car(vehicle or "coms"), count, advance), count


def table(study: Study, seeds: int) -> str:
    """The study as text."""
    lines = [f"{study.name}: {study.title} ({seeds} seeds)"]
    lines.append(_TABLE.format("", *study.headings))
    lines += [_TABLE.format(x.name, x.ours, x.expected, x.claim).rstrip() for x in study.lines]
    lines += [f"  - {remark}" for remark in study.remarks]
    return "\n".join(lines) + "\n"


def write_study(study: Study, folder: Path) -> None:
    """`NAME.json` with the figures and `NAME.png` with the curves over time."""
    with atomic_file(folder / f"{study.name}.json") as part:
        # what never settles is null
        part.write_text(json.dumps(plain_values(study.figures), indent=1, allow_nan=False), "utf-8")
    figure = _panels(study) if study.panels else _side_slips(study)
    with atomic_file(folder / f"{study.name}.png") as part:
        figure.savefig(str(part), dpi=110)
    if study.shown:
        from polemap.tools.report.study_page import draw_shown

        strip: Figure = need("matplotlib.figure").Figure(figsize=(12, 5.4), layout="constrained")
        draw_shown(strip, study.shown)
        with atomic_file(folder / f"{study.name}_pictures.png") as part:
            strip.savefig(str(part), dpi=110)


def _panels(study: Study) -> Figure:
    """The study's own panels, one above the other."""
    figure: Figure = need("matplotlib.figure").Figure(
        figsize=(10, 3.1 * len(study.panels)), layout="constrained"
    )
    # a curve keeps its style from panel to panel
    labels = dict.fromkeys(curve.label for panel in study.panels for curve in panel.curves)
    styles = dict(zip(labels, cycle(_STYLES), strict=False))
    for row, panel in enumerate(study.panels):
        axes = figure.add_subplot(len(study.panels), 1, row + 1)
        for curve in panel.curves:
            axes.plot(curve.stamp_s, curve.value, styles[curve.label], lw=1.1, label=curve.label)
        for mark in panel.marks:
            axes.axhline(mark, color="0.5", lw=0.8, ls="--")
        axes.set_ylabel(panel.label)
        axes.set_xlabel(panel.x_label)
        if panel.log_x:
            axes.set_xscale("log")
        axes.grid(alpha=0.3)
        if row == 0:
            axes.set_title(f"{study.name}: {study.title}, first drive")
        if len(panel.curves) > 1:
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    return figure


def _side_slips(study: Study) -> Figure:
    """Side-slip over time, and what the estimates miss."""
    figure: Figure = need("matplotlib.figure").Figure(figsize=(10, 6.5), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    truth = study.curves[0]
    for curve, style in zip(study.curves, _STYLES, strict=False):
        upper.plot(curve.stamp_s, np.degrees(curve.value), style, lw=1.2, label=curve.label)
        if curve is not truth:
            error = np.degrees(curve.value - truth.value)
            lower.plot(curve.stamp_s, error, style, lw=1.0, label=curve.label)
    upper.set_ylabel("side-slip, degrees")
    lower.set_ylabel("error, degrees")
    lower.set_xlabel("time, s")
    upper.set_title(f"{study.name}: {study.title}, first seed")
    upper.legend(loc="upper right", ncols=2)
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    return figure
