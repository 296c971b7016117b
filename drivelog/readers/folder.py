"""The plain drive folder: drive.yaml, CSV files, PNGs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive, FrameSource
from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.problems import Gathered
from polemap.drivelog.readers.columns import FILES, required_columns
from polemap.drivelog.readers.drive_yaml import DriveYaml, read_drive_yaml
from polemap.drivelog.readers.drive_yaml_parts import VehiclePart
from polemap.drivelog.readers.folder_camera import FolderCamera, read_camera
from polemap.drivelog.readers.folder_streams import (
    arrivals,
    read_gnss,
    read_laps,
    read_odometry,
    read_reference,
)
from polemap.drivelog.readers.given import is_given
from polemap.drivelog.readers.poles import read_scans
from polemap.drivelog.source_names import FOLDER
from polemap.drivelog.stamps import in_order
from polemap.drivelog.streams import (
    OdometryCorrection,
)
from polemap.drivelog.tables import check_header, read_table
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.io import car_names, load_car
from polemap.vehicle.parameters import Car

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
        odometry = gathered.attempt(read_odometry, folder, correction, problems, findings, notes)
        gnss = gathered.attempt(read_gnss, folder, frame, problems, findings)
        reference = gathered.attempt(read_reference, folder, problems, findings)
        laps = gathered.attempt(read_laps, folder, findings)
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
            names=camera.names() if camera else FOLDER,
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


reader = FolderReader()
