"""The section "built without reference": how far a map may be believed that no survey made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polemap.build.slam.report import DriveSummary, LoopFigures, SlamSummary, once_sentence
from polemap.drivelog.errors import InputError
from polemap.evaluation.results import RouteResult
from polemap.tools.report.slam_pictures import expected_picture, fixes_picture, loops_picture
from polemap.tools.report.style import Picture
from polemap.tools.report.tables import Table, number
from polemap.tools.slam_file import SlamFigures, read_figures

_DRIVES_DRAWN = 6
_TAKEN_BACK_SHOWN = 20


@dataclass(frozen=True, slots=True)
class SlamSection:
    """One map that was built without a reference, on the page.

    Attributes:
        anchor: of the section; map: name of its file; sentences: what to make of it.
    """

    anchor: str
    map: str
    sentences: tuple[str, ...]
    tables: tuple[Table, ...]
    pictures: tuple[Picture, ...]
    summary: SlamSummary


def slam_sections(results: Sequence[RouteResult]) -> tuple[tuple[SlamSection, ...], list[str]]:
    """A section for each such map that the runs used, and notes on what could not be read."""
    mains = [recording.main for result in results for recording in result.route.recordings]
    maps = list(dict.fromkeys(main.map for main in mains if main.map is not None))
    sections: list[SlamSection] = []
    notes: list[str] = []
    for path in maps:
        try:
            found = read_figures(path)
        except InputError as error:
            notes.append(f"how the map was built is not shown: {error}")
            continue
        if found is not None:
            sections.append(_section(path, found, f"slam-{len(sections) + 1}"))
    return tuple(sections), notes


def _section(path: Path, found: SlamFigures, anchor: str) -> SlamSection:
    summary = found.summary
    said = list(_sentences(summary))
    if not found.is_of_this_map:
        said.append(
            "The map has been changed since (brought up to date, or edited): these are the figures "
            "of what it was built from."
        )
    drawn = summary.drives[:_DRIVES_DRAWN]
    if len(drawn) < len(summary.drives):
        said.append(f"Pictures show the first {len(drawn)} of {len(summary.drives)} drives.")
    tables = (
        _drives_table(summary.drives, anchor),
        _calibration_table(summary.drives, anchor),
        _loops_table(summary.places, anchor),
    )
    pictures = [loops_picture(summary, drawn, f"{anchor}-loops")]
    pictures += [expected_picture(summary, drawn, f"{anchor}-expected")]
    pictures += [fixes_picture(drawn, f"{anchor}-fixes")]
    return SlamSection(
        anchor,
        path.name,
        tuple(said),
        tuple(table for table in tables if table.rows),
        tuple(picture for picture in pictures if picture is not None),
        summary,
    )


def _sentences(summary: SlamSummary) -> tuple[str, ...]:
    relative = [part.relative_sd_m for part in summary.drives]
    absolute = [part.absolute_sd_m for part in summary.drives]
    middle = float(np.median([pair[0] for pair in relative]))
    expected = (
        f"No survey made this map: where the car was has been solved for from odometry, poles and "
        f"GNSS. To the poles beside it a pose is expected to be known to {middle:.2f} m (1 sd an "
        f"axis, median; largest {max(pair[1] for pair in relative):.2f} m), which is what "
        "localizing in the map rests on"
    )
    if summary.absolute:
        far = float(np.median([pair[0] for pair in absolute]))
        place = (
            f"; to the earth {far:.2f} m (largest {max(pair[1] for pair in absolute):.2f} m), by "
            f"fixes that were measured to err by {summary.gnss_sd_m:.2f} m an axis at HDOP 1 for "
            f"{summary.gnss_correlation_s:.0f} s at a time."
        )
    else:
        place = "; no drive has a fix, so the map lies in a local frame that begins at the car."
    loops = (
        f"Loops closed where a place was seen again: {summary.loops}; taken back, as the rest "
        f"contradicted them: {summary.loops_taken_back}; left open, as two places would have "
        f"served: {summary.loops_ambiguous}. {_strain(summary.places)}Detections lie "
        f"{number(summary.detection_residual_m, 2)} m from their poles (median); of "
        f"{summary.links} passes of poles {summary.links_given_up} did not fit their pole and were "
        "given up."
    )
    once = once_sentence(summary)
    return (expected + place, loops) if once is None else (expected + place, f"{once}.", loops)


def _strain(places: Sequence[LoopFigures]) -> str:
    strain = [one.strain for one in places if not one.taken_back]
    if not strain:
        return ""
    return (
        f"Their strain, a chi-square of three degrees of freedom where loops are right, is "
        f"{np.median(strain):.1f} in the middle (2.4 expected), the largest {max(strain):.1f}. "
    )


def _drives_table(drives: Sequence[DriveSummary], anchor: str) -> Table:
    rows = tuple(
        (
            part.drive,
            f"{part.way_m:.0f}",
            str(part.fixes),
            str(part.fixes_left_out),
            number(part.fix_residual_m, 2),
            number(part.relative_sd_m[0], 2),
            number(part.relative_sd_m[1], 2),
            number(part.absolute_sd_m[0], 2),
            number(part.absolute_sd_m[1], 2),
        )
        for part in drives
    )
    return Table(
        f"{anchor}-drives",
        "Drives that the map was built from",
        (
            "drive", "way [m]", "fixes", "left out", "off a fix, median [m]",
            "sd to the poles, median [m]", "largest [m]", "sd to the earth, median [m]",
            "largest, earth [m]",
        ),
        rows,
        "1 sd an axis. A fix that is left out was given no weight by the robust kernel.",
    )  # fmt: skip


def _calibration_table(drives: Sequence[DriveSummary], anchor: str) -> Table:
    rows = []
    for part in drives:
        found = part.calibration
        rows.append(
            (
                part.drive,
                f"{100.0 * found['speed_scale']:+.2f}",
                f"{100.0 * found['yaw_rate_scale']:+.2f}",
                f"{np.degrees(found['yaw_rate_offset_radps']):+.3f}",
                f"{found['curvature_offset_radpm']:+.5f}",
                f"{np.degrees(-found['sideslip_rad']):+.2f}",
            )
        )
    return Table(
        f"{anchor}-odometry",
        "Calibration of the odometry as found",
        (
            "drive", "speed [%]", "yaw rate [%]", "offset [deg/s]", "curvature [1/m]",
            "detector's yaw [deg]",
        ),
        tuple(rows),
    )  # fmt: skip


def _loops_table(places: Sequence[LoopFigures], anchor: str) -> Table:
    back = [one for one in places if one.taken_back]
    rows = tuple(
        (
            f"{one.first_drive}, {one.first_way_m:.0f} m",
            f"{one.second_drive}, {one.second_way_m:.0f} m",
            str(one.poles),
            f"{one.log_odds:.1f}",
            f"{one.strain:.1f}",
        )
        for one in back[:_TAKEN_BACK_SHOWN]
    )
    more = len(back) - len(rows)
    note = "Strain: squared distance, in deviations, of the solved poses from what was matched."
    note += f" {more} more are in report.json." if more > 0 else ""
    return Table(
        f"{anchor}-loops",
        "Loops that were taken back",
        ("seen", "and again", "poles matched", "log odds", "strain"),
        rows,
        note,
        text_columns=2,
    )
