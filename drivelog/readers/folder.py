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
from polemap.drivelog.problems import Gathered
from polemap.drivelog.readers.columns import FILES, required_columns
from polemap.drivelog.readers.drive_yaml import (
    LONGEST_NAME,
    DriveYaml,
    VehiclePart,
    read_drive_yaml,
)
from polemap.drivelog.readers.folder_camera import FolderCamera, read_camera
from polemap.drivelog.readers.given import is_given, row_findings, without_zero_fixes
from polemap.drivelog.readers.poles import read_scans
from polemap.drivelog.stamps import in_order, in_seconds
from polemap.drivelog.streams import (
    GnssStream,
    OdometryCorrection,
    OdometryStream,
    ReferenceStream,
)
from polemap.drivelog.tables import Table, check_header, read_table
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
        place = folder / "drive.yaml"
        gathered = Gathered()
        head = gathered.attempt(read_drive_yaml, place)
        if head is None:
            # told together with what drive.yaml lacks, so that all can be mended in one go
            for name in FILES:
                gathered.attempt(_check_columns, folder / f"{name}.csv", name)
            raise gathered.error(folder)
        frame = EarthFrame.from_dict(head.frame)
        problems: Counter[str] = Counter()
        findings: list[Finding] = []
        notes = list(head.notes)
        notes += [f"drive.yaml: unknown key '{key}' is ignored" for key in head.unknown_keys()]
        correction = None
        if head.odometry is not None:
            correction = OdometryCorrection(head.odometry.speed_scale, head.odometry.delay_s)
        car = gathered.attempt(_car, folder, head.vehicle)
        camera = gathered.attempt(_camera, folder, head)
        frames = None
        if camera is not None or head.camera is None:
            frames = gathered.attempt(_frames, folder, head, camera, problems, findings, notes)
        scans = gathered.attempt(read_scans, folder, head.pole_detector, problems, findings)
        odometry = gathered.attempt(_odometry, folder, correction, problems, findings, notes)
        gnss = gathered.attempt(_gnss, folder, frame, problems, findings)
        reference = gathered.attempt(_reference, folder, problems, findings)
        laps = gathered.attempt(_laps, folder, findings)
        if car is None or frames is None or scans is None or laps is None or gathered.errors:
            raise gathered.error(folder)
        notes += [scans[1]] if scans[1] else []
        antenna = head.gnss_antenna
        return Drive(
            name=head.name,
            path=folder,
            frame=frame,
            wheelbase_m=car[1],
            car=car[0],
            rig=camera.rig if camera else None,
            gnss_antenna_m=np.array([antenna.x_m, antenna.y_m]) if antenna else np.zeros(2),
            frame_stamps_s=frames[0],
            frame_arrivals_s=frames[1],
            frame_numbers=np.arange(len(frames[0]), dtype=np.int64),
            images=frames[2],
            odometry=odometry,
            odometry_correction=correction or OdometryCorrection(),
            gnss=gnss,
            reference=reference,
            scans=scans[0],
            laps=laps,
            notes=tuple(notes),
            problems=dict(problems),
            findings=tuple(findings),
        )


def _check_columns(path: Path, name: str) -> None:
    if is_given(path):
        check_header(path, required_columns(name))


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


def _camera(folder: Path, head: DriveYaml) -> FolderCamera | None:
    return read_camera(folder, head.camera, head.allow_links) if head.camera else None


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
    if path.name == "gnss.csv":
        table = without_zero_fixes(table, columns)
    findings += row_findings(table)
    return count_problems(table, problems)


def _frames(
    folder: Path,
    head: DriveYaml,
    camera: FolderCamera | None,
    problems: Counter[str],
    findings: list[Finding],
    notes: list[str],
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
    outside: list[Path] | None = [] if head.allow_links else None
    pairs = tuple(
        (_inside(folder, left, path, outside), _inside(folder, right, path, outside))
        for left, right in zip(table.texts["left"], table.texts["right"], strict=True)
    )
    if outside:
        notes.append(
            f"{len(outside)} pictures lie outside of the drive folder, which allow_links allows "
            f"(such as {str(outside[0])[-80:]})"
        )
    images = camera.pairs(pairs)
    if note := camera.note():
        notes.append(note)
    return table["stamp_s"], arrivals(table, problems), images


def _inside(folder: Path, text: object, index: Path, outside: list[Path] | None) -> Path:
    """A path that frames.csv names; it leads out of the drive only where that is allowed.

    Raises:
        InputError: it does, and drive.yaml does not allow it (`outside` is None).
    """
    path = folder / str(text).strip()
    if not path.resolve().is_relative_to(folder.resolve()):
        if outside is None:
            raise InputError(
                f"{index}: '{text}' leads out of the drive folder; put the picture inside, or "
                "write `allow_links: true` into drive.yaml"
            )
        outside.append(path)
    return path


def _odometry(
    folder: Path,
    correction: OdometryCorrection | None,
    problems: Counter[str],
    findings: list[Finding],
    notes: list[str],
) -> OdometryStream | None:
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
    unusable = int(np.count_nonzero(sd <= 0.0))
    if unusable:
        problems["reference_sd_not_positive"] += unusable
        sd = np.where(sd > 0.0, sd, np.nan)
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
