"""The plain drive folder: drive.yaml, CSV files, PNGs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive, FrameSource, Lap
from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import EarthFrame, grid_from_geographic
from polemap.drivelog.readers.drive_yaml import LONGEST_NAME, VehiclePart, read_drive_yaml
from polemap.drivelog.readers.folder_camera import FolderCamera, read_camera
from polemap.drivelog.readers.given import is_given, row_findings
from polemap.drivelog.readers.poles import read_scans
from polemap.drivelog.stamps import in_order, in_seconds
from polemap.drivelog.streams import GnssStream, OdometryStream, ReferenceStream
from polemap.drivelog.tables import Table, read_table
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.io import car_names, load_car
from polemap.vehicle.parameters import Car
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]
# a typed wheelbase is rounded to centimetres
_WHEELBASE_TOLERANCE_M = 0.02


class FolderReader:
    """Reads the plain drive folder of docs/drives.md."""

    name = "folder"

    def can_read(self, path: Path) -> bool:
        return (path / "drive.yaml").is_file() or (path.name == "drive.yaml" and path.is_file())

    def read(self, path: Path, *, seed: int = 0) -> Drive:
        """The drive; nothing is derived here, so that `seed` changes nothing.

        Raises:
            InputError: see `drivelog.tables` and `drivelog.readers.drive_yaml`.
        """
        folder = path.parent if path.is_file() else path
        head = read_drive_yaml(folder / "drive.yaml")
        try:
            frame = EarthFrame.from_dict(head.frame)
        except InputError as error:
            raise InputError(f"{folder / 'drive.yaml'}: {error}") from error
        problems: Counter[str] = Counter()
        findings: list[Finding] = []
        camera = read_camera(folder, head.camera) if head.camera else None
        frames = _frames(folder, camera, findings)
        scans, view_note = read_scans(folder, head.pole_detector, problems, findings)
        notes = list(head.notes)
        notes += [f"drive.yaml: unknown key '{key}' is ignored" for key in head.unknown_keys()]
        notes += [view_note] if view_note else []
        antenna = head.gnss_antenna
        car, wheelbase_m = _car(folder, head.vehicle)
        return Drive(
            name=head.name,
            path=folder,
            frame=frame,
            wheelbase_m=wheelbase_m,
            car=car,
            rig=camera.rig if camera else None,
            gnss_antenna_m=np.array([antenna.x_m, antenna.y_m]) if antenna else np.zeros(2),
            frame_stamps_s=frames[0],
            frame_arrivals_s=frames[1],
            frame_numbers=np.arange(len(frames[0]), dtype=np.int64),
            images=frames[2],
            odometry=_odometry(folder, problems, findings),
            gnss=_gnss(folder, frame, problems, findings),
            reference=_reference(folder, problems, findings),
            scans=scans,
            laps=_laps(folder, findings),
            notes=tuple(notes),
            problems=dict(problems),
            findings=tuple(findings),
        )


def _car(folder: Path, vehicle: VehiclePart) -> tuple[Car | None, float]:
    """The car file, looked for in the folder, and the wheelbase."""
    place = folder / "drive.yaml"
    if vehicle.car is None:
        assert vehicle.wheelbase_m is not None  # the model sees to that
        return None, vehicle.wheelbase_m
    known = vehicle.car in car_names()
    try:
        car = load_car(vehicle.car if known else folder / vehicle.car)
    except VehicleError as error:
        raise InputError(f"{place}: vehicle.car: {error}") from error
    stated = vehicle.wheelbase_m
    if stated is not None and abs(stated - car.wheelbase_m) > _WHEELBASE_TOLERANCE_M:
        raise InputError(
            f"{place}: vehicle.wheelbase_m is {stated} m, car {car.name} has "
            f"{car.wheelbase_m:.3f} m; leave one of them out, or correct it"
        )
    return car, car.wheelbase_m


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
    findings += row_findings(table)
    return count_problems(table, problems)


def _frames(
    folder: Path, camera: FolderCamera | None, findings: list[Finding]
) -> tuple[Floats, Floats, FrameSource | None]:
    path = folder / "frames.csv"
    if not is_given(path):
        return np.empty(0), np.empty(0), None
    if camera is None:
        raise InputError(f"{path}: there are images, but drive.yaml describes no camera")
    # a frame that cannot be placed in time is no sensor noise but a broken index: no dropping
    table = read_table(
        path, ("stamp_s",), optional=("arrival_s",), texts=("left", "right"), drop_not_finite=False
    )
    table = in_order(table, findings, duplicates="error")
    pairs = tuple(
        (_inside(folder, left, path), _inside(folder, right, path))
        for left, right in zip(table.texts["left"], table.texts["right"], strict=True)
    )
    images = camera.pairs(pairs)
    return table["stamp_s"], arrivals(table, Counter()), images


def _inside(folder: Path, text: object, index: Path) -> Path:
    """A path that frames.csv names; it must not lead out of the drive."""
    path = folder / str(text).strip()
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{index}: '{text}' leads out of the drive folder")
    return path


def _odometry(
    folder: Path, problems: Counter[str], findings: list[Finding]
) -> OdometryStream | None:
    path = folder / "odometry.csv"
    if not is_given(path):
        return None
    table = _sensor(path, ("speed_mps", "yaw_rate_radps"), ("arrival_s",), problems, findings)
    return OdometryStream(
        table["stamp_s"], arrivals(table, problems), table["speed_mps"], table["yaw_rate_radps"]
    )


def _gnss(
    folder: Path, frame: EarthFrame, problems: Counter[str], findings: list[Finding]
) -> GnssStream | None:
    path = folder / "gnss.csv"
    if not is_given(path):
        return None
    if frame.is_utm:
        table = _sensor(
            path, ("latitude_deg", "longitude_deg"), ("hdop", "arrival_s"), problems, findings
        )
        latitude, longitude = table["latitude_deg"], table["longitude_deg"]
        bad = np.flatnonzero((np.abs(latitude) > 90) | (np.abs(longitude) > 180))
        if len(bad):
            row = int(bad[0])
            raise InputError(
                f"{path}, line {table.lines[row]}: {latitude[row]}, {longitude[row]} is no "
                "latitude and longitude in degrees"
            )
        points = grid_from_geographic(frame, latitude, longitude)
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


def _reference(
    folder: Path, problems: Counter[str], findings: list[Finding]
) -> ReferenceStream | None:
    path = folder / "reference.csv"
    if not is_given(path):
        return None
    table = _sensor(path, ("east_m", "north_m", "yaw_rad"), ("sd_m",), problems, findings)
    poses = np.stack([table["east_m"], table["north_m"], wrap_angle(table["yaw_rad"])], axis=1)
    sd = table["sd_m"] if "sd_m" in table else np.full(len(table), np.nan)
    return ReferenceStream(table["stamp_s"], poses, sd)


def _laps(folder: Path, findings: list[Finding]) -> tuple[Lap, ...]:
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


reader = FolderReader()
