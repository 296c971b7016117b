"""The pictures of one route."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.evaluation.exclusions import excluded_mask
from polemap.evaluation.results import RouteResult, SystemResult
from polemap.tools.background import Background, draw_background
from polemap.tools.report.filter_figures import (
    consistency,
    errors_over_time,
    localizability_picture,
    poles_along_route,
    timing_picture,
)
from polemap.tools.report.route_tables import KIND_NAMES
from polemap.tools.report.style import (
    COLOURS,
    FAINT,
    INK,
    LAPS,
    Picture,
    drawing,
    finish,
    legend_above,
    shade_runs,
    thin,
    tidy,
)

Floats = NDArray[np.float64]

CLOSE_UP_M = 60.0


def route_pictures(
    result: RouteResult, slug: str, background: Background | None = None
) -> list[Picture]:
    """Every picture that the route has data for, in the order of the page."""
    makers = (
        close_up,
        lateral_along_route,
        monte_carlo,
        errors_over_time,
        consistency,
        poles_along_route,
        localizability_picture,
        timing_picture,
    )
    made = [maker(result, f"{slug}-{maker.__name__.replace('_', '-')}") for maker in makers]
    made.insert(0, map_picture(result, f"{slug}-map-picture", background))
    return [picture for picture in made if picture is not None]


def map_picture(
    result: RouteResult, key: str, background: Background | None = None
) -> Picture | None:
    """All laps of the first run on the pole map, over what lies under it."""
    with drawing(8.0, 6.0) as figure:
        axes = figure.add_subplot()
        axes.set_aspect("equal", adjustable="datalim")
        if background is not None:
            draw_background(axes, background, np.zeros(2))
            axes.grid(visible=False)
        poles = result.route.pole_map
        if poles is not None and len(poles):
            points = near_points(poles.points_m, result)
            axes.plot(*points.T, "o", ms=2.5, color=COLOURS["pole"], label="mapped poles", mew=0)
        for one in drawn_systems(result):
            for number, track in enumerate(one.system.tracks[0]):
                line = track.thinned(0.5).poses
                label = one.system.name if number == 0 else None
                axes.plot(line[:, 0], line[:, 1], color=colour_of(one), lw=0.9, label=label)
        tidy(axes, "east [m]", "north [m]")
        axes.ticklabel_format(useOffset=False, style="plain")
        legend_above(axes)
        return finish(
            figure, key, "Map and trajectories", "All laps of the first run, and the map's poles."
        )


def close_up(result: RouteResult, key: str) -> Picture | None:
    """The source paper's Fig. 8: jitter of the particle filter against the smooth output."""
    pf, kf = result.of_kind("pf"), result.of_kind("kf")
    if pf is None or kf is None or not kf.example:
        return None
    path = kf.example[0].stretch.path
    difference = np.nan_to_num(pf.example[0].lateral_m - kf.example[0].lateral_m)
    difference[:, kf.example[0].counted < min(2, len(difference))] = 0.0
    window = max(min(int(CLOSE_UP_M / path.station_m[1]), len(path.station_m) - 1), 2)
    power = np.cumsum(np.concatenate([[0.0], (difference**2).sum(axis=0)]))
    first = int(np.argmax(power[window:] - power[:-window]))
    part = slice(first, first + window)
    shown = list(range(min(len(kf.example[0].lateral_m), 3)))
    with drawing(8.0, 3.4) as figure:
        axes = figure.add_subplot()
        for row in shown:
            colour = LAPS[row % len(LAPS)]
            name = kf.example[0].stretch.passes[row].name
            station = path.station_m[part]
            axes.plot(station, 100 * pf.example[0].lateral_m[row, part], ".", ms=3, color=colour)
            axes.plot(station, 100 * kf.example[0].lateral_m[row, part], color=colour, label=name)
        tidy(axes, "station [m]", "to the left of the mean path [cm]")
        legend_above(axes)
        return finish(
            figure,
            key,
            "Close-up: particle filter (dots) and output filter (lines)",
            f"The {CLOSE_UP_M:.0f} m where the two differ most; {len(shown)} laps of one run.",
        )


def lateral_along_route(result: RouteResult, key: str) -> Picture | None:
    """Deviation of every lap from the mean of the laps, for every system."""
    shown = [one for one in result.systems if one.example and np.isfinite(one.sd_m)]
    if not shown:
        return None
    stretch = result.stretches[0]
    mask = excluded_mask(stretch, 0, result.exclusions)
    with drawing(8.0, 1.2 + 1.6 * len(shown)) as figure:
        all_axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
        for axes, one in zip(all_axes, shown, strict=True):
            values = 100 * one.example[0].centred()
            for row in range(len(values)):
                name = stretch.passes[row].name
                axes.plot(
                    *thin(stretch.path.station_m, values[row]),
                    color=LAPS[row % len(LAPS)], lw=0.9, label=name,
                )  # fmt: skip
            shade_runs(axes, stretch.path.station_m, np.asarray(mask.any(axis=0)))
            axes.axhline(0.0, color=FAINT, lw=0.6)
            tidy(axes, "", "[cm]", f"{one.system.name}: {100 * one.sd_m:.1f} cm")
        all_axes[-1].set_xlabel("station [m]")
        if len(stretch.passes) <= 10:
            legend_above(all_axes[0], 6)
        place = "" if len(result.stretches) == 1 else " Longest of the roads driven repeatedly."
        return finish(
            figure,
            key,
            "Lateral deviation along the route, per lap",
            f"From the mean of the laps, first run; shaded: something is left out.{place}",
        )


def monte_carlo(result: RouteResult, key: str) -> Picture | None:
    """The figure of every run beside its interval."""
    shown = [one for one in result.systems if one.repeatability and np.isfinite(one.sd_m)]
    if not shown or max(len(one.repeatability) for one in shown) < 2:
        return None
    with drawing(8.0, 0.9 + 0.42 * len(shown)) as figure:
        axes = figure.add_subplot()
        for place, one in enumerate(reversed(shown)):
            values = 100 * np.array([run.sd_m for run in one.repeatability])
            low, high = one.interval_m()
            axes.plot([100 * low, 100 * high], [place, place], color=FAINT, lw=1.0)
            shift = 0.28 * (np.arange(len(values)) % 7 - 3) / 3
            axes.plot(values, place + shift, ".", ms=4, color=colour_of(one), mew=0)
            axes.plot(values.mean(), place, "|", ms=16, mew=1.6, color=INK)
        axes.set_yticks(range(len(shown)), [one.system.name for one in reversed(shown)])
        axes.grid(visible=False, axis="y")
        tidy(axes, "repeatability [cm]", "")
        return finish(
            figure,
            key,
            "Monte Carlo runs",
            "Dots: runs; bar: their mean; line: 95 % interval for the laps as a sample.",
        )


def drawn_systems(result: RouteResult) -> list[SystemResult]:
    """Systems of the first setting, output filter last so that it lies on top."""
    shown = [one for one in result.systems if one.system.setting == ""]
    order = ("reference", "truth", "added", "pf", "kf")
    return sorted(shown, key=lambda one: order.index(one.system.kind))


def colour_of(one: SystemResult) -> str:
    """The colour of a kind of system."""
    return COLOURS[one.system.kind]


def system_label(one: SystemResult) -> str:
    """`kf (output filter)`, or the name that the user gave."""
    if one.system.kind == "added":
        return one.system.name
    return f"{one.system.name} ({KIND_NAMES[one.system.kind]})"


def near_points(points_m: Floats, result: RouteResult, margin_m: float = 60.0) -> Floats:
    """The poles around the route, so that a city map does not shrink it to a dot."""
    line = np.concatenate([one.guide.poses[:, :2] for one in result.route.recordings])
    low, high = line.min(axis=0) - margin_m, line.max(axis=0) + margin_m
    return points_m[np.all((points_m >= low) & (points_m <= high), axis=1)]
