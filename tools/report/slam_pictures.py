"""Pictures of a map that was built without a reference."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import NullLocator

from polemap.build.slam.report import DriveSummary, SlamSummary
from polemap.tools.report.style import (
    COLOURS,
    FAINT,
    LAPS,
    Picture,
    drawing,
    finish,
    legend_above,
    thin,
    tidy,
)

_OUTLIER_WEIGHT = 0.1
_LONG_M = 1e4


def loops_picture(summary: SlamSummary, drawn: Sequence[DriveSummary], key: str) -> Picture | None:
    """The routes as solved, and which places were seen again."""
    if not drawn:
        return None
    by_name = {part.drive: part.along for part in drawn}
    with drawing(8.0, 6.0) as figure:
        axes = figure.add_subplot()
        axes.set_aspect("equal", adjustable="datalim")
        first = drawn[0].along
        corner = np.array([first.east_m[0], first.north_m[0]])
        # coordinates of a grid have six digits and more, of which the last three are wanted
        centre = np.round(corner, -1) if np.abs(corner).max() > _LONG_M else np.zeros(2)
        for number, part in enumerate(drawn):
            along = part.along
            east, north = (
                np.subtract(along.east_m, centre[0]),
                np.subtract(along.north_m, centre[1]),
            )
            axes.plot(east, north, color=LAPS[number % len(LAPS)], lw=0.9, label=part.drive)
        for back, colour, name in (
            (False, COLOURS["truth"], "seen again"),
            (True, COLOURS["added"], "taken back"),
        ):
            label: str | None = name
            for one in summary.places:
                ends = [(one.first_drive, one.first_way_m), (one.second_drive, one.second_way_m)]
                if one.taken_back is not back or any(drive not in by_name for drive, _ in ends):
                    continue
                points = np.array(
                    [
                        [np.interp(way, by_name[drive].way_m, axis) for axis in (
                            by_name[drive].east_m, by_name[drive].north_m)]
                        for drive, way in ends
                    ]
                ) - centre  # fmt: skip
                axes.plot(*points.T, color=colour, lw=0.6, marker="o", ms=2.0, label=label)
                label = None
        shift = [f" {-value:+.0f}" if value else "" for value in centre]
        tidy(axes, f"east{shift[0]} [m]", f"north{shift[1]} [m]")
        legend_above(axes)
        return finish(
            figure,
            key,
            "Routes and loops",
            "The routes as they were solved; lines join the two places that were taken for one.",
        )


def expected_picture(
    summary: SlamSummary, drawn: Sequence[DriveSummary], key: str
) -> Picture | None:
    """Expected relative and absolute precision along every route."""
    if not drawn:
        return None
    with drawing(8.0, 1.2 + 1.7 * len(drawn)) as figure:
        all_axes = figure.subplots(len(drawn), 1, squeeze=False)[:, 0]
        for axes, part in zip(all_axes, drawn, strict=True):
            along = part.along
            way = np.array(along.way_m)
            curves = [("to the poles beside it", along.relative_sd_m, COLOURS["kf"])]
            if summary.absolute:
                curves += [("to the earth", along.absolute_sd_m, COLOURS["pf"])]
            for name, values, colour in curves:
                axes.plot(*thin(way, np.array(values)), color=colour, label=name)
            axes.set_yscale("log")
            low, high = axes.get_ylim()
            steps = [digit * 10.0**power for power in range(-3, 4) for digit in (1, 2, 5)]
            shown = [step for step in steps if low <= step <= high]
            axes.set_yticks(shown, [f"{step:g}" for step in shown])
            axes.yaxis.set_minor_locator(NullLocator())
            tidy(axes, "", "sd [m]", part.drive)
        all_axes[-1].set_xlabel("distance driven [m]")
        legend_above(all_axes[0])
        return finish(
            figure,
            key,
            "Expected accuracy along the route",
            "Standard deviation an axis of the solved pose: against the nearest poles, and against "
            "the earth.",
        )


def fixes_picture(drawn: Sequence[DriveSummary], key: str) -> Picture | None:
    """How far fixes lie from where the antenna was found to be."""
    shown = [part for part in drawn if part.along.fix_way_m]
    if not shown:
        return None
    with drawing(8.0, 1.2 + 1.5 * len(shown)) as figure:
        all_axes = figure.subplots(len(shown), 1, squeeze=False)[:, 0]
        for axes, part in zip(all_axes, shown, strict=True):
            way = np.array(part.along.fix_way_m)
            off = np.array(part.along.fix_residual_m)
            out = np.array(part.along.fix_weight) < _OUTLIER_WEIGHT
            axes.plot(way[~out], off[~out], ".", ms=3, color=COLOURS["kf"], label="used")
            axes.plot(way[out], off[out], "x", ms=4, color=COLOURS["added"], label="left out")
            axes.axhline(float(np.median(off)), color=FAINT, lw=0.8)
            # an outlier of a kilometre would hide all others
            top = max(1.5 * float(np.quantile(off[~out], 0.99)) if (~out).any() else 1.0, 1.0)
            axes.set_ylim(0.0, top)
            above = int(np.count_nonzero(off > top))
            more = f" ({above} beyond the axis, up to {off.max():.0f} m)" if above else ""
            tidy(axes, "", "[m]", f"{part.drive}{more}")
        all_axes[-1].set_xlabel("distance driven [m]")
        legend_above(all_axes[0])
        return finish(
            figure,
            key,
            "GNSS residuals",
            "Distance of every fix from the solved antenna; the line is the median.",
        )
