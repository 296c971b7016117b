"""Figures 5 to 8 as pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import NullFormatter

from benchmarks.evaluate.report_routes import short_world
from benchmarks.figures.laps import CONFIGURATIONS, EASY, HARD
from benchmarks.figures.measure import (
    EVERY,
    PARTICLES,
    PRINTED_PARTICLES,
    rate_hz,
    run_of,
    scans_of,
)
from benchmarks.figures.street import street_extract
from benchmarks.figures.tables import Courses, Row, mean_of, of
from polemap.tools.background import draw_background, read_background
from polemap.tools.report.style import (
    COLOURS,
    INK,
    Picture,
    drawing,
    finish,
    legend_above,
    plain_log,
    tidy,
)

_COLOUR = {"as printed": COLOURS["pf"], "ours": COLOURS["kf"]}
# of Figure 8: what is shown around the place where the particle filter jitters most
_CLOSE_M = 12.0
_REPEATABILITY_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


def draw(rows: list[Row], courses: Courses, routes: list[str], out: Path) -> None:
    """Write what there are rows for as `figure_5` to `figure_8`, .svg and .png."""
    swept = routes[0]
    pictures = [figure_5(courses, routes, out)]
    pictures += [
        sweep(rows, swept, "figure_6", "every", [(e, rate_hz(e)) for e in EVERY],
              "frames a second"),
        sweep(rows, swept, "figure_7", "particles", [(p, p) for p in PARTICLES], "particles"),
        figure_8(courses, swept),
    ]  # fmt: skip
    for picture in pictures:
        (out / f"{picture.key}.svg").write_text(picture.svg, encoding="utf-8")
        (out / f"{picture.key}.png").write_bytes(picture.png)


def figure_5(courses: Courses, routes: list[str], out: Path) -> Picture:
    """The map of every route over an extract of its street."""
    with drawing(3.2 * len(routes), 3.4) as figure:
        for axes, route in zip(np.atleast_1d(figure.subplots(1, len(routes))), routes, strict=True):
            laps = courses.laps(route, EASY, "ours")
            points = laps.pole_map.points_m
            under = street_extract(short_world(route), laps.drive.frame, out / f"{route}.osm")
            centre = points.mean(axis=0).round()
            background = read_background(under, laps.drive.frame, points)
            draw_background(axes, background, centre, "streets and houses of the simulator")
            axes.plot(*(laps.stretch.path.points_m - centre).T, color=COLOURS["kf"], lw=0.8)
            axes.plot(*(points - centre).T, "o", ms=3, color=COLOURS["pole"], mew=0)
            axes.set_aspect("equal")
            axes.grid(visible=False)
            tidy(axes, "m", "", f"{route}: {len(points)} poles")
        return finish(figure, "figure_5", "Maps of one lap", "")


def sweep(
    rows: list[Row], route: str, key: str, swept: str, values: list[tuple[int, float]], label: str
) -> Picture:
    """Repeatability and lost shares over one setting."""
    panels: tuple[tuple[str, Callable[[list[Row]], float]], ...] = (
        ("repeatability, m", lambda r: mean_of(r, "pf", "repeatability_m")),
        ("particle filter over 2 m off, %", lambda r: 100.0 * mean_of(r, "pf", "lost")),
        ("output over 2 m off, %", lambda r: 100.0 * mean_of(r, "kf", "lost")),
    )
    fixed: dict[str, Any] = {"particles": PRINTED_PARTICLES} if swept == "every" else {"every": 1}
    with drawing(9.0, 2.9) as figure:
        all_axes = figure.subplots(1, len(panels))
        for axes, (title, value) in zip(all_axes, panels, strict=True):
            for condition, line in ((EASY, "-"), (HARD, "--")):
                for name in CONFIGURATIONS:
                    chosen = [
                        (shown, found)
                        for v, shown in values
                        if (found := of(rows, route=route, condition=condition,
                                        configuration=name, **fixed, **{swept: v}))
                    ]  # fmt: skip
                    axes.plot(
                        [shown for shown, _ in chosen], [value(found) for _, found in chosen],
                        f"o{line}", ms=3.5, color=_COLOUR[name], label=f"{name}, {condition}",
                    )  # fmt: skip
            plain_log(axes)
            axes.set_xticks([round(shown, 1) for _, shown in values])
            axes.tick_params(axis="x", labelrotation=45)
            tidy(axes, label, "", title)
        all_axes[0].set_yscale("log")
        all_axes[0].set_yticks(_REPEATABILITY_M, [f"{tick:g}" for tick in _REPEATABILITY_M])
        all_axes[0].yaxis.set_minor_formatter(NullFormatter())
        for axes in all_axes[1:]:
            axes.set_ylim(bottom=-0.02 * max(1.0, axes.get_ylim()[1]))
        legend_above(all_axes[0], 4)
        return finish(figure, key, f"Particle filter over {label}", "")


def figure_8(courses: Courses, route: str) -> Picture:
    """Laps as seen by both filters and the reference, and a close-up of each configuration."""
    with drawing(9.0, 3.6) as figure:
        all_axes = figure.subplots(1, 1 + len(CONFIGURATIONS))
        for axes, name in zip(all_axes[1:], CONFIGURATIONS, strict=True):
            laps, settings = courses.laps(route, EASY, name), CONFIGURATIONS[name]()
            run = run_of(laps, settings, scans_of(laps, settings, 1), PRINTED_PARTICLES, 0)
            tracks = {"reference": laps.reference, "pf": run.pf, "kf": run.kf}
            path = laps.stretch.path.points_m
            at = path[len(path) // 3]
            for span in laps.stretch.passes:
                for kind, track in tracks.items():
                    line = track.between(span.start_s, span.end_s).poses[:, :2] - at
                    near = np.abs(line).max(axis=1) < _CLOSE_M
                    style = "." if kind == "pf" else "-"
                    axes.plot(*line[near].T, style, ms=2, lw=0.9, color=COLOURS[kind])
                    if name == "ours":
                        all_axes[0].plot(*(line + at - path.mean(axis=0)).T, lw=0.7,
                                         color=COLOURS[kind])  # fmt: skip
            axes.set_xlim(-_CLOSE_M, _CLOSE_M)
            axes.set_ylim(-_CLOSE_M, _CLOSE_M)
            axes.set_aspect("equal")
            tidy(axes, "m", "", f"close-up, {name}")
        for kind, label in (("reference", "reference that drifts"), ("pf", "particle filter"),
                            ("kf", "output filter")):  # fmt: skip
            all_axes[0].plot([], [], color=COLOURS[kind], label=label)
        marked = path[len(path) // 3] - path.mean(axis=0)
        all_axes[0].plot(*marked, "s", ms=9, mfc="none", mec=INK)
        all_axes[0].set_aspect("equal", adjustable="datalim")
        tidy(all_axes[0], "m", "", f"{route}, ours")
        legend_above(all_axes[0], 3)
        return finish(figure, "figure_8", "Laps of one drive", "")
