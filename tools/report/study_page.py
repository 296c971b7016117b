"""The section of a study on the page of signals: its table, curves and remarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.figure import Figure

from polemap.electric.studies.study import Panel, Shown, Study, sideslip_panels
from polemap.tools.report.signals_page import SignalSection
from polemap.tools.report.style import (
    COLOURS,
    LAPS,
    Picture,
    drawing,
    finish,
    legend_above,
    plain_log,
    thin,
    tidy,
)
from polemap.tools.report.tables import Table

# letters of a legend's line
_LEGEND_LETTERS = 120
# curves that all others are held against
_WANTED = ("truth", "reference", "wanted")


def study_section(study: Study, seeds: int) -> SignalSection:
    """A study's table, curves and remarks."""
    rows = tuple((x.name, x.ours, x.expected, x.claim) for x in study.lines)
    table = Table(
        f"{study.name.lower()}_table",
        f"{seeds} seed" + ("s" if seeds != 1 else ""),
        ("figure", *study.headings),
        rows,
        text_columns=1,
    )
    panels = study.panels or sideslip_panels(study.curves)
    # a curve keeps its colour from picture to picture
    labels = dict.fromkeys(curve.label for panel in panels for curve in panel.curves)
    others = (label for label in labels if label not in _WANTED)
    colours = dict.fromkeys(_WANTED, COLOURS["ink"])
    colours |= dict(zip(others, cycle(LAPS), strict=False))
    pictures = tuple(
        _panel(study.name, number, panel, colours) for number, panel in enumerate(panels)
    )
    if study.shown:
        pictures = (*pictures, _strip(study))
    return SignalSection(
        study.name.lower(),
        study.name,
        f"{study.name}: {study.title}",
        (table,),
        pictures,
        (),
        study.remarks,
    )


def _panel(name: str, place: int, panel: Panel, colours: Mapping[str, str]) -> Picture:
    with drawing(9.0, 3.1) as figure:
        axes = figure.subplots()
        for curve in panel.curves:
            x, y = curve.stamp_s, curve.value
            if len(x) > 1 and bool((np.diff(x) > 0.0).all()) and not panel.log_x:
                x, y = thin(x, y)
            axes.plot(x, y, color=colours[curve.label], label=curve.label, lw=1.1)
        for mark in panel.marks:
            axes.axhline(mark, color=COLOURS["faint"], lw=0.8, ls="--")
        tidy(axes, panel.x_label, panel.label)
        if panel.log_x:
            plain_log(axes)
        if len(panel.curves) > 1:
            longest = max(len(curve.label) for curve in panel.curves)
            legend_above(axes, max(1, min(4, _LEGEND_LETTERS // (longest + 6))))
        title = panel.label.split(",")[0].capitalize()
        drive = ", first drive" if panel.x_label.startswith("time") else ""
        return finish(figure, f"{name}_{place}", title, f"{name}{drive}.")


def _strip(study: Study) -> Picture:
    with drawing(9.0, 2.0 * -(-len(study.shown) // 3)) as figure:
        draw_shown(figure, study.shown)
        caption = f"{study.name}, first drive: left pictures with the poles that were tracked then."
        return finish(figure, f"{study.name}_pictures", "What the car saw", caption)


def draw_shown(figure: Figure, shown: Sequence[Shown]) -> None:
    """Pictures in rows of three, their lines over them."""
    for place, one in enumerate(shown):
        axes = figure.add_subplot(-(-len(shown) // 3), 3, place + 1)
        rows, columns = one.image.shape
        axes.imshow(one.image, cmap="gray", interpolation="antialiased")
        for line in one.lines_px:
            axes.plot(*line.T, color=COLOURS["kf"], lw=1.5)
        axes.set(xlim=(0, columns), ylim=(rows, 0), xticks=[], yticks=[])
        axes.set_title(one.label, fontsize=9)
