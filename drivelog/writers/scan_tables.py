"""Scans as tables of a plain drive folder: points in poles.csv, pieces of lines in lines.csv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.drivelog.line_detections import LineDetections

Floats = NDArray[np.float64]
Columns = Mapping[str, tuple[NDArray[np.generic], str]]

_LINES = "stamp_s,kind,x0_m,y0_m,x1_m,y1_m,offset_sd_m,direction_sd_rad,style,probability,arrival_s"


def write_columns(path: Path, columns: Columns) -> None:
    """Write a CSV file of columns, each with the format of its values."""
    data = np.column_stack([values for values, _ in columns.values()])
    formats = [fmt for _, fmt in columns.values()]
    np.savetxt(
        path, data, fmt=formats, delimiter=",", header=",".join(columns), comments=""
    )  # fmt: skip


def point_columns(scans: Sequence[Detections]) -> Columns:
    """poles.csv of scans; kind and free side only where not all points are poles."""
    counts = [len(scan) for scan in scans]
    points = _join([scan.points_vehicle_m for scan in scans], (0, 2))
    covariance = _join([scan.covariance_m2 for scan in scans], (0, 2, 2))
    columns: dict[str, tuple[NDArray[np.generic], str]] = {
        "stamp_s": (np.repeat([scan.stamp_s for scan in scans], counts), "%.6f"),
        "x_m": (points[:, 0], "%.5f"),
        "y_m": (points[:, 1], "%.5f"),
        "var_x_m2": (covariance[:, 0, 0], "%.9g"),
        "var_y_m2": (covariance[:, 1, 1], "%.9g"),
        "cov_xy_m2": (covariance[:, 0, 1], "%.9g"),
        "width_m": (_join([scan.width_m for scan in scans], (0,)), "%.4f"),
        "arrival_s": (np.repeat([scan.arrival_s for scan in scans], counts), "%.6f"),
        "probability": (_join([scan.probability for scan in scans], (0,)), "%.4f"),
    }
    kind = np.concatenate([np.empty(0, dtype=np.int8), *(scan.kind for scan in scans)])
    if not (kind == LandmarkKind.POLE).all():
        names = np.array([LandmarkKind(value).name.lower() for value in kind], dtype=object)
        columns = {name: (column.astype(object), fmt) for name, (column, fmt) in columns.items()}
        columns["kind"] = (names, "%s")
        facing = _join([scan.facing_rad for scan in scans], (0,))
        columns["facing_rad"] = (facing.astype(object), "%.6f")
    return columns


def lines_text(scans: Sequence[Detections]) -> str:
    """lines.csv of scans."""
    rows = [_LINES]
    for scan in scans:
        rows += _rows_of(scan.lines, scan.stamp_s, scan.arrival_s) if scan.lines else []
    return "\n".join(rows) + "\n"


def _rows_of(lines: LineDetections, stamp_s: float, arrival_s: float) -> list[str]:
    columns = (
        lines.kind.tolist(), lines.style.tolist(), lines.start_vehicle_m.tolist(),
        lines.end_vehicle_m.tolist(), lines.offset_sd_m.tolist(),
        lines.direction_sd_rad.tolist(), lines.probability.tolist(),
    )  # fmt: skip
    return [
        f"{stamp_s:.6f},{LandmarkKind(kind).name.lower()},{a[0]:.5f},{a[1]:.5f},{b[0]:.5f},"
        f"{b[1]:.5f},{offset:.6g},{turn:.6g},{LineStyle(style).name.lower()},{p:.4f},"
        f"{arrival_s:.6f}"
        for kind, style, a, b, offset, turn, p in zip(*columns, strict=True)
    ]


def _join(parts: list[Floats], empty_shape: tuple[int, ...]) -> Floats:
    return np.concatenate(parts) if parts else np.empty(empty_shape)
