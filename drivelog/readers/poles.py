"""poles.csv and scans.csv: points that were detected elsewhere, and when the detector looked."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.landmark_kind import POINT_KINDS, LandmarkKind
from polemap.drivelog.readers.crowd import check_crowd
from polemap.drivelog.readers.drive_yaml_parts import DetectorPart
from polemap.drivelog.readers.given import is_given, row_findings
from polemap.drivelog.readers.lines import add_lines, kind_names, named_values
from polemap.drivelog.stamps import in_order
from polemap.drivelog.tables import Table, read_table
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

_COLUMNS = ("stamp_s", "x_m", "y_m", "var_x_m2", "var_y_m2", "cov_xy_m2")
_OPTIONAL = ("width_m", "arrival_s", "probability", "facing_rad")
_FEW = 200  # fewer poles than this do not show the outline of a sensor's view


def read_scans(
    folder: Path,
    detector: DetectorPart | None,
    problems: Counter[str],
    findings: list[Finding],
) -> tuple[tuple[Detections, ...], str | None]:
    """All scans of a folder, lines included, and a note where their view had to be estimated.

    Rows with numbers that are not finite or a covariance that is not positive are left out and
    counted.

    Raises:
        InputError: see `drivelog.tables`.
    """
    poles_path, scans_path = folder / "poles.csv", folder / "scans.csv"
    has_poles, has_scans = is_given(poles_path), is_given(scans_path)
    if not has_poles and not has_scans:
        return add_lines(folder, (), problems, findings), None
    scan_stamps = np.empty(0)
    if has_scans:
        table = in_order(read_table(scans_path, ("stamp_s",)), findings, duplicates="drop")
        findings += row_findings(table)
        _count(table, problems)
        scan_stamps = table["stamp_s"]
    poles = _read_poles(poles_path, problems, findings) if has_poles else None
    stamps = np.unique(np.concatenate([scan_stamps, poles["stamp_s"]])) if poles else scan_stamps
    if poles and len(scan_stamps):
        unlisted = len(stamps) - len(scan_stamps)
        if unlisted:
            problems["poles_stamp_not_in_scans"] += unlisted
    view, note = _view(detector, poles)
    return add_lines(folder, _scans(stamps, poles, view), problems, findings), note


def _count(table: Table, problems: Counter[str]) -> None:
    for reason, count in table.dropped.items():
        problems[f"{table.path.stem}_{reason}"] += count


def _read_poles(path: Path, problems: Counter[str], findings: list[Finding]) -> Table:
    table = read_table(path, _COLUMNS, optional=_OPTIONAL, optional_texts=("kind",))
    table = in_order(table, findings, duplicates="allow")
    check_crowd(table, "poles", "keep the surest")
    var_x, var_y = table["var_x_m2"], table["var_y_m2"]
    if "arrival_s" in table and (early := table["arrival_s"] < table["stamp_s"]).any():
        problems["poles_arrival_before_stamp"] += int(np.count_nonzero(early))
    positive = (var_x > 0) & (var_y > 0) & (var_x * var_y > table["cov_xy_m2"] ** 2)
    table = table.keep(positive, "covariance_not_positive")
    table = table.keep(_first_of_each(table), "same_pole_twice_in_a_scan")
    findings += row_findings(table)
    _check_facing(table)
    _count(table, problems)
    return table


def _check_facing(table: Table) -> None:
    """Free sides are radians: more than a turn is degrees.

    Raises:
        InputError: the first that is.
    """
    if "facing_rad" not in table:
        return
    beyond = np.flatnonzero(np.abs(table["facing_rad"]) > 2.0 * pi + 0.01)
    if len(beyond):
        row = int(beyond[0])
        raise InputError(
            f"{table.path}, line {table.lines[row]}: facing_rad is {table['facing_rad'][row]:g}, "
            "more than a turn; write radians, counter-clockwise from forward"
        )


def _first_of_each(table: Table) -> NDArray[np.bool_]:
    """Rows `(n,)` but for those that repeat a pole of the same scan, to the millimetre.

    Twice the same error is no second measurement of a pole.
    """
    x, y = (np.round(table[name], 3) for name in ("x_m", "y_m"))
    order = np.lexsort((y, x, table["stamp_s"]))
    keys = np.stack([table["stamp_s"], x, y], axis=1)[order]
    first = np.ones(len(table), dtype=np.bool_)
    # a stable order: of rows that are alike the first in the file comes first
    first[order[1:]] = (keys[1:] != keys[:-1]).any(axis=1)
    return first


def _scans(
    stamps: Floats, poles: Table | None, view: VisibleRegion | None
) -> tuple[Detections, ...]:
    if poles is None:
        return tuple(
            pole_detections(float(t), float(t), np.empty((0, 2)), np.empty((0, 2, 2)), view=view)
            for t in stamps
        )
    n = len(poles)
    points = np.stack([poles["x_m"], poles["y_m"]], axis=1)
    covariance = np.empty((n, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = poles["var_x_m2"], poles["var_y_m2"]
    covariance[:, 0, 1] = covariance[:, 1, 0] = poles["cov_xy_m2"]
    width = poles["width_m"] if "width_m" in poles else np.full(n, np.nan)
    probability = poles["probability"] if "probability" in poles else np.ones(n)
    arrival = poles["arrival_s"] if "arrival_s" in poles else poles["stamp_s"]
    arrival = np.where(arrival >= poles["stamp_s"], arrival, poles["stamp_s"])
    kind, facing = _kinds(poles)
    first = np.searchsorted(poles["stamp_s"], stamps, side="left")
    last = np.searchsorted(poles["stamp_s"], stamps, side="right")
    scans = []
    for stamp, a, b in zip(stamps, first, last, strict=True):
        rows = slice(int(a), int(b))
        seen = float(arrival[rows].max()) if b > a else float(stamp)
        scan = pole_detections(
            float(stamp),
            seen,
            points[rows],
            covariance[rows],
            width_m=width[rows],
            probability=probability[rows],
            view=view,
        )
        scans.append(replace(scan, kind=kind[rows], facing_rad=facing[rows]))
    return tuple(scans)


def _kinds(poles: Table) -> tuple[NDArray[np.int8], Floats]:
    """Kind and free side `(n,)` of every row."""
    n = len(poles)
    kind = np.full(n, LandmarkKind.POLE, dtype=np.int8)
    if "kind" in poles.texts:
        kind = named_values(poles, "kind", kind_names(POINT_KINDS), empty=LandmarkKind.POLE)
    facing = poles["facing_rad"] if "facing_rad" in poles else np.full(n, np.nan)
    return kind, np.where(kind == LandmarkKind.CORNER, wrap_angle(facing), np.nan)


def _view(
    detector: DetectorPart | None, poles: Table | None
) -> tuple[VisibleRegion | None, str | None]:
    """What the detector could see: as drive.yaml says, else the outline of what it did see."""
    if detector is not None:
        return stated_view(detector), None
    if poles is None or len(poles) < _FEW:
        return None, None
    region = estimate_view(np.stack([poles["x_m"], poles["y_m"]], axis=1))
    return region, (
        "drive.yaml has no pole_detector: its field of view was estimated from poles.csv "
        f"({np.degrees(region.bearing_min_rad):.0f} to {np.degrees(region.bearing_max_rad):.0f} "
        f"degrees, to {region.free_range_m[0]:.0f} m)"
    )


def stated_view(detector: DetectorPart) -> VisibleRegion:
    """What the detector could see, as drive.yaml says."""
    return VisibleRegion(
        np.array([detector.x_m, detector.y_m]),
        detector.bearing_min_rad,
        detector.bearing_max_rad,
        detector.range_min_m,
        np.array([detector.range_max_m]),
    )


def estimate_view(points_vehicle_m: Floats) -> VisibleRegion:
    """The sector that holds nearly all of the points `(n, 2)`, seen from the rear axle.

    A sensor at the front that looks to both sides would fill more than half a turn from there;
    then its place is taken as the hindmost point, from which the points span half a turn.
    """
    points = np.asarray(points_vehicle_m, dtype=np.float64)
    origin = np.zeros(2)
    low, high = _bearings(points)
    if high - low > np.radians(150.0):
        hindmost = float(np.quantile(points[:, 0], 0.001))
        if hindmost > 0.5:
            origin = np.array([hindmost, 0.0])
            low, high = _bearings(points - origin)
    distance = np.hypot(*(points - origin).T)
    return VisibleRegion(
        origin,
        max(low, -pi),
        min(high, pi),
        float(np.quantile(distance, 0.002)),
        np.array([float(np.quantile(distance, 0.95))]),
    )


def _bearings(points: Floats) -> tuple[float, float]:
    bearing = np.arctan2(points[:, 1], points[:, 0])
    return float(np.quantile(bearing, 0.005)), float(np.quantile(bearing, 0.995))
