"""What building without a reference found out, in figures and in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.constants import SUBMAP_M
from polemap.build.slam.motion import CALIBRATION, SLIP

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AlongRoute:
    """What is expected along one drive, and how its fixes fit.

    Attributes:
        way_m, east_m, north_m, absolute_sd_m, relative_sd_m: `(n,)` at stations along the way, in
            the map's frame; sd an axis.
        fix_way_m, fix_residual_m, fix_weight: `(c,)` of the fixes that are used: distance from the
            solved antenna, and what the robust kernel leaves of each, 0 to 1.
    """

    way_m: tuple[float, ...]
    east_m: tuple[float, ...]
    north_m: tuple[float, ...]
    absolute_sd_m: tuple[float, ...]
    relative_sd_m: tuple[float, ...]
    fix_way_m: tuple[float, ...]
    fix_residual_m: tuple[float, ...]
    fix_weight: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class LoopFigures:
    """One place that was seen again, or was thought to be.

    Attributes:
        first_drive, second_drive, first_way_m, second_way_m: where it was seen.
        poles: how many were matched; log_odds: against being elsewhere.
        strain: how far the solved graph leaves what was matched, a chi-square of three degrees of
            freedom where the loop is right.
        taken_back: whether the rest contradicted it.
    """

    first_drive: str
    first_way_m: float
    second_drive: str
    second_way_m: float
    poles: int
    log_odds: float
    strain: float
    taken_back: bool


@dataclass(frozen=True, slots=True)
class DriveSummary:
    """Figures of one drive.

    Attributes:
        way_m: length; fixes, fixes_left_out: used, and given no weight as outliers.
        fix_residual_m: median distance of a fix from the solved antenna, NaN without fixes.
        absolute_sd_m, relative_sd_m: expected, an axis: median and largest along the route.
        calibration: found for the odometry, mean over the drive, by name.
        along: what is expected along the route.
    """

    drive: str
    way_m: float
    fixes: int
    fixes_left_out: int
    fix_residual_m: float
    absolute_sd_m: tuple[float, float]
    relative_sd_m: tuple[float, float]
    calibration: dict[str, float]
    along: AlongRoute


@dataclass(frozen=True, slots=True)
class SlamSummary:
    """Figures of the whole.

    Attributes:
        loops, loops_taken_back, loops_ambiguous: places seen again, those that the rest
            contradicted, and matches that were left as two places would have served.
        detection_residual_m: median distance of a detection from its pole.
        links, links_given_up: passes that were joined to poles, and those that did not fit.
        gnss_sd_m, gnss_correlation_s: of the fixes at HDOP 1, as measured.
        absolute: whether fixes tie the map to the earth.
        places: the loops, those taken back last.
    """

    drives: tuple[DriveSummary, ...]
    loops: int
    loops_taken_back: int
    loops_ambiguous: int
    detection_residual_m: float
    links: int
    links_given_up: int
    gnss_sd_m: float
    gnss_correlation_s: float
    absolute: bool
    places: tuple[LoopFigures, ...]

    def as_dict(self) -> dict[str, object]:
        """The figures for a JSON file; NaN is null."""
        return _plain(asdict(self))  # type: ignore[return-value]


def once_m(summary: SlamSummary) -> float:
    """Way of all drives of which no place was seen again, so that its fixes alone say where it is.

    A loop vouches for the way of a local map before and after it.
    """
    total = 0.0
    for part in summary.drives:
        loops = [
            way
            for one in summary.places
            if not one.taken_back
            for drive, way in (
                (one.first_drive, one.first_way_m),
                (one.second_drive, one.second_way_m),
            )
            if drive == part.drive
        ]
        way = np.asarray(part.along.way_m, dtype=np.float64)
        gap = np.full(len(way), np.inf)
        if loops:
            gap = np.abs(way[:, None] - np.array(loops)).min(axis=1)
        # stations stand for half of the way to their neighbours
        share = np.gradient(way) if len(way) > 1 else np.zeros(len(way))
        if len(way) > 1:
            share[0], share[-1] = share[0] / 2.0, share[-1] / 2.0
        total += float(np.sum(share[gap > SUBMAP_M]))
    return total


def once_sentence(summary: SlamSummary) -> str | None:
    """What is not stated of way that was driven once; None where there is none, or no fix."""
    alone = once_m(summary)
    if not summary.absolute or alone < SUBMAP_M:
        return None
    whole = sum(part.way_m for part in summary.drives)
    return (
        f"{alone:.0f} m of {whole:.0f} m were seen once only, tied to the earth by the fixes of "
        "that one pass: fixes that are wrong alike for a minute bend such a stretch unseen, by "
        "several times what is stated to the earth; drive it again, at another time"
    )


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return round(value, 6) if np.isfinite(value) else None
    return value


def sentences(summary: SlamSummary) -> tuple[str, ...]:
    """The section "built without reference" for a terminal."""
    lines = ["built without reference:"]
    for part in summary.drives:
        fixes = (
            f"{part.fixes} fixes, {part.fix_residual_m:.2f} m from them (median), "
            f"{part.fixes_left_out} left out"
            if part.fixes
            else "no fixes"
        )
        lines.append(f"  {part.drive}: {part.way_m:.0f} m, {fixes}")
        lines.append(
            f"    expected: to the poles beside it {_pair(part.relative_sd_m)}"
            + (f", to the earth {_pair(part.absolute_sd_m)}" if summary.absolute else "")
            + " (1 sd an axis, median and largest)"
        )
        lines.append("    odometry: " + _calibration(part.calibration))
    strain = [one.strain for one in summary.places if not one.taken_back]
    lines.append(
        f"  {summary.loops} loops closed, {summary.loops_taken_back} taken back, "
        f"{summary.loops_ambiguous} left as ambiguous; detections "
        f"{summary.detection_residual_m:.2f} m from their poles (median); "
        f"{summary.links_given_up} of {summary.links} passes of poles given up"
    )
    if strain:
        lines.append(
            f"  strain of the loops (chi-square of 3, 2.4 expected in the middle): "
            f"{np.median(strain):.1f} median, {max(strain):.1f} largest"
        )
    if summary.absolute:
        lines.append(
            f"  GNSS as measured: {summary.gnss_sd_m:.2f} m an axis at HDOP 1, lasting "
            f"{summary.gnss_correlation_s:.0f} s"
        )
        once = once_sentence(summary)
        if once is not None:
            lines.append(f"  {once}")
    else:
        lines.append("  no drive has a fix: the map stands in a local frame that begins at the car")
    return tuple(lines)


def _pair(values: Sequence[float]) -> str:
    return f"{values[0]:.2f} and {values[1]:.2f} m"


def _calibration(found: dict[str, float]) -> str:
    scale, turn, rate, curvature, yaw, slip = (found[name] for name in CALIBRATION)
    return (
        f"speed {100.0 * scale:+.2f} %, yaw rate {100.0 * turn:+.2f} % {np.degrees(rate):+.3f} "
        f"deg/s, curvature {curvature:+.5f} 1/m, detector's yaw to the way "
        f"{np.degrees(-yaw):+.2f} deg, slip {SLIP + slip:.4f} rad per m/s^2"
    )
