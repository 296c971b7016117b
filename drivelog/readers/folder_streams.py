"""The CSV files of a plain drive folder as the streams of a drive."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Lap
from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import EarthFrame, grid_from_geographic
from polemap.drivelog.readers.drive_yaml import LONGEST_NAME
from polemap.drivelog.readers.given import (
    is_given,
    row_findings,
    without_repeated_places,
    without_zero_places,
)
from polemap.drivelog.stamps import in_order, in_seconds
from polemap.drivelog.streams import (
    GnssStream,
    OdometryCorrection,
    OdometryStream,
    ReferenceStream,
)
from polemap.drivelog.tables import Table, read_table
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]
# the poles are in no UTM zone; a receiver without a fix may say latitude 90
_UTM_LATITUDE_DEG = 85.0


def count_problems(table: Table, problems: Counter[str]) -> Table:
    """Add what was left out of a table to the drive's problems, under the file's name."""
    for reason, count in table.dropped.items():
        problems[f"{table.path.stem}_{reason}"] += count
    return table


def arrivals(table: Table, problems: Counter[str]) -> Floats:
    """Times of arrival `(n,)`: the stamps where the file has none or one before its stamp."""
    stamps = table["stamp_s"]
    if "arrival_s" not in table:
        return stamps
    given = table["arrival_s"]
    usable = np.isfinite(given) & (given >= stamps)
    lost = int(np.count_nonzero(np.isfinite(given) & (given < stamps)))
    if lost:
        problems[f"{table.path.stem}_arrival_before_stamp"] += lost
    return np.asarray(np.where(usable, given, stamps))


def _sensor(
    path: Path,
    columns: tuple[str, ...],
    optional: tuple[str, ...],
    problems: Counter[str],
    findings: list[Finding],
) -> Table:
    table = read_table(path, ("stamp_s", *columns), optional=optional)
    table = in_order(table, findings, duplicates="drop")
    if path.name in ("gnss.csv", "reference.csv"):
        table = without_zero_places(table, columns[:2])
    if path.name == "gnss.csv":
        table = without_repeated_places(table, columns)
    if columns[0] == "latitude_deg":
        _check_degrees(table)
        beyond = np.abs(table["latitude_deg"]) > _UTM_LATITUDE_DEG
        table = table.keep(~beyond, "latitude_beyond_utm")
    findings += row_findings(table)
    return count_problems(table, problems)


def _check_degrees(table: Table) -> None:
    latitude, longitude = table["latitude_deg"], table["longitude_deg"]
    bad = np.flatnonzero((np.abs(latitude) > 90) | (np.abs(longitude) > 180))
    if len(bad):
        row = int(bad[0])
        raise InputError(
            f"{table.path}, line {table.lines[row]}: {latitude[row]}, {longitude[row]} is no "
            "latitude and longitude in degrees"
        )


def read_odometry(
    folder: Path,
    correction: OdometryCorrection | None,
    problems: Counter[str],
    findings: list[Finding],
    notes: list[str],
) -> OdometryStream | None:
    """odometry.csv, corrected by what drive.yaml says; None without the file."""
    path = folder / "odometry.csv"
    if not is_given(path):
        return None
    table = _sensor(path, ("speed_mps", "yaw_rate_radps"), ("arrival_s",), problems, findings)
    stream = OdometryStream(
        table["stamp_s"], arrivals(table, problems), table["speed_mps"], table["yaw_rate_radps"]
    )
    if correction is None:
        return stream
    notes.append(
        f"odometry.csv is corrected by drive.yaml: speeds divided by {correction.speed_scale:g}, "
        f"stamps {correction.delay_s:g} s earlier"
    )
    return correction.apply(stream)


def read_gnss(
    folder: Path, frame: EarthFrame, problems: Counter[str], findings: list[Finding]
) -> GnssStream | None:
    """gnss.csv in the plane of the drive's frame; None without the file.

    Raises:
        InputError: a latitude or longitude that is none.
    """
    path = folder / "gnss.csv"
    if not is_given(path):
        return None
    if frame.is_utm:
        table = _sensor(
            path, ("latitude_deg", "longitude_deg"), ("hdop", "arrival_s"), problems, findings
        )
        points = grid_from_geographic(frame, table["latitude_deg"], table["longitude_deg"])
    else:
        table = _sensor(path, ("east_m", "north_m"), ("hdop", "arrival_s"), problems, findings)
        points = np.stack([table["east_m"], table["north_m"]], axis=1)
    hdop = table["hdop"] if "hdop" in table else np.ones(len(table))
    unusable = int(np.count_nonzero(~(np.isfinite(hdop) & (hdop > 0))))
    if unusable:
        problems["gnss_hdop_unusable"] += unusable
    return GnssStream(
        table["stamp_s"],
        arrivals(table, problems),
        points[:, 0],
        points[:, 1],
        np.where(np.isfinite(hdop) & (hdop > 0), hdop, 1.0),
    )


def read_reference(
    folder: Path, problems: Counter[str], findings: list[Finding]
) -> ReferenceStream | None:
    """reference.csv; None without the file."""
    path = folder / "reference.csv"
    if not is_given(path):
        return None
    table = _sensor(path, ("east_m", "north_m", "yaw_rad"), ("sd_m",), problems, findings)
    poses = np.stack([table["east_m"], table["north_m"], wrap_angle(table["yaw_rad"])], axis=1)
    sd = table["sd_m"] if "sd_m" in table else np.full(len(table), np.nan)
    unusable = int(np.count_nonzero(sd <= 0.0))
    if unusable:
        problems["reference_sd_not_positive"] += unusable
        sd = np.where(sd > 0.0, sd, np.nan)
    return ReferenceStream(table["stamp_s"], poses, sd)


def read_laps(folder: Path, findings: list[Finding]) -> tuple[Lap, ...]:
    """laps.csv, in its order; none without the file.

    Raises:
        InputError: a name that cannot be shown or stands twice, a lap that ends before it starts.
    """
    path = folder / "laps.csv"
    if not is_given(path):
        return ()
    table = read_table(path, ("start_s", "end_s"), texts=("lap",), drop_not_finite=False)
    table = in_seconds(table, findings, "start_s")
    laps = []
    for row, name in enumerate(table.texts["lap"]):
        start, end = float(table["start_s"][row]), float(table["end_s"][row])
        if not str(name).isprintable() or len(str(name)) > LONGEST_NAME:
            raise InputError(
                f"{path}, line {table.lines[row]}: lap {ascii(name)[:40]} is no name of up to "
                f"{LONGEST_NAME} printable characters"
            )
        if not start < end:
            raise InputError(f"{path}, line {table.lines[row]}: lap '{name}' ends before it starts")
        laps.append(Lap(str(name), start, end))
    if len({lap.name for lap in laps}) < len(laps):
        raise InputError(f"{path}: two laps have the same name")
    return tuple(laps)
