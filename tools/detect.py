"""`polemap detect`: disparity, hypotheses and tracks of the frames of a drive."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from polemap.detect.corners import StereoCorners
from polemap.detect.models.io import read_classifier, read_corner_classifier
from polemap.drivelog.atomic import atomic_folder, check_folder
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.landmark_kind import LINE_KINDS
from polemap.evaluation.detections import FrameRecord, Score, record, score_frames, score_tracks
from polemap.map.io import read_map
from polemap.map.pole_map import PoleMap
from polemap.perception import PerceivedFrame, PolePerception, perceive_drive
from polemap.settings import Settings, load_settings
from polemap.tools.detect_lines import COLUMNS as LINE_COLUMNS
from polemap.tools.detect_lines import CountedLines, line_rows
from polemap.tools.detect_pictures import write_overlay
from polemap.tools.drive_detection import Source
from polemap.tools.findings import require_plausible
from polemap.tools.option_types import (
    ConfigOption,
    ForceOption,
    OdometryOption,
    SetOption,
    TopicsOption,
    frame_range,
)
from polemap.tools.plausible import find
from polemap.tools.progress import progress
from polemap.vehicle.pose import inverse_transform_points

_COLUMNS = (
    *("frame", "stamp_s", "left_px", "right_px", "top_px", "bottom_px", "disparity_px"),
    *("x_m", "y_m", "width_m", "height_m", "probability", "track"),
)
_KIND_COLUMNS = ("kind", "facing_rad")
KIND = "detection folder"
_BANDS_M = ((5.0, 20.0), (5.0, 10.0), (10.0, 15.0), (15.0, 20.0), (20.0, 25.0))


def command(
    drive: Annotated[Path, typer.Argument(help="Drive with stereo images.")],
    out: Annotated[Path, typer.Option("--out", help="Folder that appears.")],
    frames: Annotated[
        str, typer.Option("--frames", help="A:B, rows of the drive from A up to but without B.")
    ] = ":",
    pictures: Annotated[bool, typer.Option("--pictures", help="Write overlay pictures.")] = False,
    evaluate: Annotated[
        Path | None, typer.Option("--evaluate", help="Score against this pole map.")
    ] = None,
    unmapped: Annotated[
        Path | None, typer.Option("--unmapped", help="Map of true poles that that map lacks.")
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="Of sensors that have to be derived.")
    ] = 0,
    topics: TopicsOption = None,
    odometry: OdometryOption = "auto",
    force: ForceOption = False,
    config: ConfigOption = None,
    set_values: SetOption = None,
) -> None:
    """Find the poles in the frames of a drive.

    Examples:
      polemap detect drive --out found --frames 0:50 --pictures
      polemap detect kitti/sequences/03 --out found --evaluate kitti/poles/03.csv
      polemap detect drive --out found --set polemap.detection.probability_min=0.7
      polemap detect drive --out found --set polemap.detection.kinds=[pole,corner,kerb]

    detections.csv has a row for every hypothesis with its probability; `track` is -1 where it
    belongs to none. Where detection.kinds names corner, the columns `kind` and `facing_rad` follow,
    of a corner the direction into its free side, counter-clockwise from forward. lines.csv, where
    it names lane_marking or kerb, has a row for every piece of a line. Pictures show depth edges,
    hypotheses (green: a pole), track ids and the disparity, and from above the view, the
    uncertainties and the map.
    """
    check_folder(out, KIND, (drive, evaluate, unmapped, config, topics))
    settings = load_settings(config, set_values)
    mapping = None if topics is None else str(topics)
    opened = Source(str(drive), None, mapping, odometry).open(seed)
    if opened.rig is None or not opened.has_frames:
        raise InputError(f"drive {opened.name}: it has no stereo images to detect poles in")
    wanted = frame_range(frames, len(opened.frame_stamps_s))
    known = read_map(evaluate, opened.frame) if evaluate else None
    lacking = read_map(unmapped, opened.frame).points_m if unmapped else None
    if evaluate and opened.reference is None:
        raise InputError(f"drive {opened.name}: it has no reference to place a map by")
    # a name that is none is told before pictures are read
    read_classifier(settings.polemap.detection.model)
    if "corner" in settings.polemap.detection.kinds:
        read_corner_classifier(settings.polemap.detection.corner_model)
    require_plausible(opened.name, find(opened), force=force)
    with atomic_folder(out, KIND) as folder:
        records, counted = _detect_frames(opened, wanted, settings, folder, pictures, known)
    if known is not None:
        config_min = settings.polemap.detection
        scores = score_frames(records, known, _BANDS_M, lacking)
        tracks = score_tracks(records, known, _BANDS_M[0], lacking)
        _tell(scores, tracks, config_min.probability_min)
    for note in opened.notes:
        typer.echo(f"note: {note}")
    typer.echo("\n".join(counted.lines(drive, out, pictures)))


@dataclass(slots=True)
class _Counted:
    """What was found in all frames."""

    frames: int = 0
    hypotheses: int = 0
    poles: int = 0
    corners: int | None = None
    tracks: set[int] = field(default_factory=set)
    distances_m: list[float] = field(default_factory=list)
    lines_of: CountedLines | None = None

    def add(self, perceived: PerceivedFrame, probability_min: float) -> None:
        found = perceived.view.detections
        sure = found.probability >= probability_min
        self.frames += 1
        if self.lines_of is not None:
            self.lines_of.add(perceived)
        self.hypotheses += len(found)
        self.poles += int(np.count_nonzero(sure))
        self.tracks |= set(perceived.tracks.ids[perceived.tracks.confirmed].tolist())
        corners = perceived.view.corners
        if corners is not None:
            sure_corners = np.count_nonzero(corners.probability >= probability_min)
            self.corners = (self.corners or 0) + int(sure_corners)
        self.distances_m += np.hypot(*found.points_vehicle_m[sure].T).tolist()

    def lines(self, drive: Path, out: Path, pictures: bool) -> list[str]:
        """A summary, and what to do next."""
        told = [] if self.lines_of is None else [self.lines_of.told()]
        also = "" if self.lines_of is None else " and lines.csv"
        middle_m = np.median(self.distances_m) if self.poles else 0.0
        where = f", half of them nearer than {middle_m:.0f} m" if self.poles else ""
        frames = f"{self.frames} frame" + ("s" if self.frames != 1 else "")
        corners = ""
        if self.corners is not None:
            corners = f", {self.corners} corners ({self.corners / max(self.frames, 1):.1f} a frame)"
        return [
            f"{frames}: {self.hypotheses} hypotheses, {self.poles} called poles "
            f"({self.poles / max(self.frames, 1):.1f} a frame{where}){corners}; "
            f"{len(self.tracks)} confirmed tracks",
            *told,
            f"wrote {out / 'detections.csv'}{also}"
            + (f" and {frames} as pictures" if pictures else "; --pictures shows what was seen"),
            f"next: polemap map {drive} --out poles.gpkg",
        ]


def _detect_frames(
    drive: Drive,
    wanted: range,
    settings: Settings,
    folder: Path,
    pictures: bool,
    known: PoleMap | None,
) -> tuple[list[FrameRecord], _Counted]:
    """Write the table and the pictures; the records are for scoring."""
    counted = _Counted()
    stamps = drive.frame_stamps_s
    last = np.nextafter(stamps[wanted[-1]], np.inf)
    part = drive.between(float(stamps[wanted[0]]), float(last))
    records: list[FrameRecord] = []
    rig = drive.rig
    if rig is None:
        return records, counted
    perception = PolePerception(rig, settings.polemap, stereo=settings.stereo)
    with_lines = bool(settings.polemap.detection.landmark_kinds & LINE_KINDS)
    counted.lines_of = CountedLines() if with_lines else None
    rows_of_lines: list[list[Any]] = []
    with (
        (folder / "detections.csv").open("w", newline="", encoding="utf-8") as file,
        progress(len(wanted), f"poles of {drive.name}") as advance,
    ):
        table = csv.writer(file)
        kinds = settings.polemap.detection.kinds
        table.writerow(_COLUMNS if _without_corners(kinds) else (*_COLUMNS, *_KIND_COLUMNS))
        for perceived in perceive_drive(part, perception):
            frame = perceived.frame
            table.writerows(_rows(perceived, kinds))
            rows_of_lines += line_rows(perceived)
            counted.add(perceived, settings.polemap.detection.probability_min)
            pose = drive.reference.at(np.array([frame.stamp_s]))[0] if drive.reference else None
            placed = pose is not None and bool(np.isfinite(pose).all())
            mapped = None
            if known is not None and pose is not None and placed:
                records.append(record(perceived, pose, known, rig, settings.polemap.detection))
                near = known.within(pose[:2], 40.0)
                mapped = inverse_transform_points(pose, known.points_m[near])
            if pictures:
                name = folder / f"{frame.index:06d}.png"
                sure = settings.polemap.detection.probability_min
                write_overlay(name, perceived, sure, mapped, rig if with_lines else None)
            advance(1)
    if with_lines:
        with (folder / "lines.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([LINE_COLUMNS, *rows_of_lines])
    return records, counted


def _rows(perceived: PerceivedFrame, kinds: Sequence[str]) -> list[list[Any]]:
    """A row for every hypothesis; `kind` and `facing_rad` only where corners are asked for."""
    found, corners = perceived.view.detections, perceived.view.corners
    track = np.full(len(perceived.view.landmarks), -1)
    taken = perceived.tracks.detection >= 0
    track[perceived.tracks.detection[taken]] = perceived.tracks.ids[taken]
    rows = _pole_rows(perceived, track)
    if _without_corners(kinds):
        return rows
    rows = [[*row, "pole", ""] for row in rows]
    return rows if corners is None else rows + _corner_rows(perceived, corners, track[len(found) :])


def _without_corners(kinds: Sequence[str]) -> bool:
    return "corner" not in kinds


def _corner_rows(
    perceived: PerceivedFrame, corners: StereoCorners, track: NDArray[np.int64]
) -> list[list[Any]]:
    """Both flanks of a corner are its edge at mid height; it has no width."""
    middle = corners.edge_px(0.5 * (corners.top_px + corners.bottom_px))
    return [
        [
            perceived.frame.index,
            f"{perceived.frame.stamp_s:.6f}",
            *(f"{value[row]:.2f}" for value in (middle, middle, corners.top_px, corners.bottom_px)),
            f"{corners.disparity_px[row]:.3f}",
            *(f"{value:.4f}" for value in corners.points_vehicle_m[row]),
            "",
            f"{corners.height_m[row]:.3f}",
            f"{corners.probability[row]:.4f}",
            int(track[row]),
            "corner",
            f"{corners.facing_rad[row]:.4f}",
        ]
        for row in range(len(corners))
    ]


def _pole_rows(perceived: PerceivedFrame, track: NDArray[np.int64]) -> list[list[Any]]:
    found = perceived.view.detections
    return [
        [
            perceived.frame.index,
            f"{perceived.frame.stamp_s:.6f}",
            *(
                f"{value[row]:.2f}"
                for value in (found.left_px, found.right_px, found.top_px, found.bottom_px)
            ),
            f"{found.disparity_px[row]:.3f}",
            *(f"{value:.4f}" for value in found.points_vehicle_m[row]),
            f"{found.width_m[row]:.4f}",
            f"{found.height_m[row]:.3f}",
            f"{found.probability[row]:.4f}",
            int(track[row]),
        ]
        for row in range(len(found))
    ]


def _tell(scores: list[Score], tracks: Score, probability_min: float) -> None:
    """The scores as a table on stdout."""
    table = Table(title=f"against the map (probability >= {probability_min:g}, match within 1 m)")
    heads = (
        "range m", "shown", "recall", "claims", "precision", "with unmapped",
        "across m", "(bias)", "along m", "(bias)",
    )  # fmt: skip
    for head in heads:
        table.add_column(head, justify="right")
    named = [(f"{s.range_min_m:g}-{s.range_max_m:g}", s) for s in scores]
    named.append((f"tracks {tracks.range_min_m:g}-{tracks.range_max_m:g}", tracks))
    for name, score in named:
        figures = score.figures()
        table.add_row(
            name,
            str(score.shown),
            f"{figures['recall']:.3f}",
            str(score.claims),
            f"{figures['precision']:.3f}",
            f"{figures['precision_with_unmapped']:.3f}",
            f"{figures['across_median_m']:.3f}",
            f"{figures['across_bias_m']:+.3f}",
            f"{figures['along_median_m']:.3f}",
            f"{figures['along_bias_m']:+.3f}",
        )
    Console(file=sys.stdout, width=110).print(table)
