"""Writes the plain drive folder of docs/drives.md: drive.yaml, CSV files, PNGs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_folder
from polemap.drivelog.detections import Detections, VisibleRegion, pole_view
from polemap.drivelog.drive import Drive, Lap
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.drivelog.samples import Image
from polemap.drivelog.streams import GnssStream, OdometryStream, ReferenceStream
from polemap.drivelog.writers.scan_tables import Columns, lines_text, point_columns, write_columns
from polemap.stereo.rig import StereoRig
from polemap.vehicle.io import dump_car
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]
CAR_FILE = "car.yaml"


class FolderWriter:
    """Fills a drive folder piece by piece; made by `folder_writer`."""

    def __init__(self, folder: Path, frame: EarthFrame) -> None:
        self._folder = folder
        self._frame = frame
        self._frames: list[tuple[float, str, str, float]] = []

    @property
    def folder(self) -> Path:
        """Where the files lie until the drive is whole; for what has no method of its own here."""
        return self._folder

    def frame(self, stamp_s: float, arrival_s: float, left: Image, right: Image) -> None:
        """Append a stereo pair; stamps must rise.

        Raises:
            InputError: a stamp that does not follow the one before, or images that cannot be
                encoded.
        """
        if self._frames and stamp_s <= self._frames[-1][0]:
            raise InputError(f"frame at {stamp_s:.6f} s does not follow {self._frames[-1][0]:.6f}")
        names = []
        for side, image in (("left", left), ("right", right)):
            name = f"{side}/{len(self._frames):06d}.png"
            target = self._folder / name
            target.parent.mkdir(exist_ok=True)
            done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            if not done:
                raise InputError(f"{name}: image {image.shape} {image.dtype} cannot be encoded")
            target.write_bytes(data.tobytes())
            names.append(name)
        self._frames.append((stamp_s, names[0], names[1], arrival_s))

    def odometry(self, stream: OdometryStream) -> None:
        """Write odometry.csv."""
        self._table(
            "odometry",
            {
                "stamp_s": (stream.stamp_s, "%.6f"),
                "speed_mps": (stream.speed_mps, "%.6f"),
                "yaw_rate_radps": (stream.yaw_rate_radps, "%.8f"),
                "arrival_s": (stream.arrival_s, "%.6f"),
            },
        )

    def gnss(self, stream: GnssStream) -> None:
        """Write gnss.csv, in degrees for a UTM frame."""
        points = np.stack([stream.east_m, stream.north_m], axis=1)
        if self._frame.is_utm:
            place = geographic_from_grid(self._frame, points)
            where = {
                "latitude_deg": (place[:, 0], "%.10f"),
                "longitude_deg": (place[:, 1], "%.10f"),
            }
        else:
            where = {"east_m": (points[:, 0], "%.4f"), "north_m": (points[:, 1], "%.4f")}
        self._table(
            "gnss",
            {
                "stamp_s": (stream.stamp_s, "%.6f"),
                **where,
                # a receiver that states centimetres has a small one
                "hdop": (stream.hdop, "%.4g"),
                "arrival_s": (stream.arrival_s, "%.6f"),
            },
        )

    def reference(self, stream: ReferenceStream) -> None:
        """Write reference.csv."""
        self._table(
            "reference",
            {
                "stamp_s": (stream.stamp_s, "%.6f"),
                "east_m": (stream.poses[:, 0], "%.5f"),
                "north_m": (stream.poses[:, 1], "%.5f"),
                "yaw_rad": (stream.poses[:, 2], "%.7f"),
                "sd_m": (stream.sd_m, "%.4f"),
            },
        )

    def scans(self, scans: Sequence[Detections]) -> None:
        """Write poles.csv and scans.csv, and lines.csv where a detector looked for lines."""
        looked = [scan for scan in scans if scan.view is None or not scan.view.sees_nothing]
        if looked:
            self._table("scans", {"stamp_s": (np.array([s.stamp_s for s in looked]), "%.6f")})
            self._table("poles", point_columns(looked))
        if any(scan.lines is not None for scan in scans):
            (self._folder / "lines.csv").write_text(lines_text(scans), encoding="utf-8")

    def laps(self, laps: Iterable[Lap]) -> None:
        """Write laps.csv."""
        (self._folder / "laps.csv").write_text(laps_text(laps), encoding="utf-8")

    def finish(self) -> None:
        """Write what needs all frames."""
        if self._frames:
            lines = [f"{s:.6f},{left},{right},{a:.6f}" for s, left, right, a in self._frames]
            text = "\n".join(["stamp_s,left,right,arrival_s", *lines]) + "\n"
            (self._folder / "frames.csv").write_text(text, encoding="utf-8")

    def _table(self, name: str, columns: Columns) -> None:
        write_columns(self._folder / f"{name}.csv", columns)


def laps_text(laps: Iterable[Lap]) -> str:
    """The content of laps.csv.

    Raises:
        InputError: a name that a table cannot hold.
    """
    lines = ["lap,start_s,end_s"]
    for lap in laps:
        if any(character in lap.name for character in ',"\n\r'):
            raise InputError(f"lap name '{lap.name}' may not hold commas, quotes or line ends")
        lines.append(f"{lap.name},{lap.start_s:.6f},{lap.end_s:.6f}")
    return "\n".join(lines) + "\n"


def drive_head(
    *,
    name: str,
    frame: EarthFrame,
    wheelbase_m: float,
    car_file: str | None = None,
    rig: StereoRig | None = None,
    gnss_antenna_m: Floats | None = None,
    pole_view: VisibleRegion | None = None,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """The keys of drive.yaml."""
    head: dict[str, Any] = {
        "format_version": 1,
        "name": name,
        "frame": frame.to_dict(),
        "vehicle": {"wheelbase_m": float(wheelbase_m)},
    }
    if car_file is not None:
        head["vehicle"]["car"] = car_file
    if rig is not None:
        mount = rig.vehicle_from_camera
        head["camera"] = {
            key: getattr(rig, key)
            for key in ("width_px", "height_px", "focal_px", "cx_px", "cy_px", "baseline_m")
        }
        head["camera"]["vehicle_from_camera"] = {
            key: getattr(mount, key)
            for key in ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
        }
    if gnss_antenna_m is not None and np.any(gnss_antenna_m):
        head["gnss_antenna"] = {"x_m": float(gnss_antenna_m[0]), "y_m": float(gnss_antenna_m[1])}
    if pole_view is not None:
        head["pole_detector"] = {
            "x_m": float(pole_view.origin_vehicle_m[0]),
            "y_m": float(pole_view.origin_vehicle_m[1]),
            "bearing_min_rad": float(pole_view.bearing_min_rad),
            "bearing_max_rad": float(pole_view.bearing_max_rad),
            "range_min_m": float(pole_view.range_min_m),
            "range_max_m": float(np.max(pole_view.free_range_m)),
        }
    if notes:
        head["notes"] = list(notes)
    return head


@contextmanager
def folder_writer(
    path: Path,
    *,
    name: str,
    frame: EarthFrame,
    wheelbase_m: float,
    car: Car | None = None,
    rig: StereoRig | None = None,
    gnss_antenna_m: Floats | None = None,
    pole_view: VisibleRegion | None = None,
    notes: Sequence[str] = (),
) -> Iterator[FolderWriter]:
    """A writer whose folder appears under `path` when the block ends well.

    Raises:
        InputError: the place cannot be written to.
    """
    head = drive_head(
        name=name,
        frame=frame,
        wheelbase_m=wheelbase_m,
        car_file=CAR_FILE if car is not None else None,
        rig=rig,
        gnss_antenna_m=gnss_antenna_m,
        pole_view=pole_view,
        notes=notes,
    )
    with atomic_folder(Path(path), "drive") as folder:
        text = yaml.safe_dump(head, sort_keys=False, allow_unicode=True)
        (folder / "drive.yaml").write_text(text, encoding="utf-8")
        if car is not None:
            (folder / CAR_FILE).write_text(dump_car(car), encoding="utf-8")
        writer = FolderWriter(folder, frame)
        yield writer
        writer.finish()


def write_drive(drive: Drive, path: Path, advance: Callable[[int], None] | None = None) -> None:
    """Write any drive as a plain drive folder, images included.

    Args:
        advance: called with 1 after every pair of pictures.

    Raises:
        InputError: the place cannot be written to, or an image cannot be read.
    """
    with folder_writer(
        path,
        name=drive.name,
        frame=drive.frame,
        wheelbase_m=drive.wheelbase_m,
        car=drive.car,
        rig=drive.rig,
        gnss_antenna_m=drive.gnss_antenna_m,
        pole_view=pole_view(drive.scans),
        notes=drive.notes,
    ) as writer:
        if drive.has_frames:
            for row in range(len(drive.frame_stamps_s)):
                frame = drive.read_frame(row)
                writer.frame(frame.stamp_s, frame.arrival_s, frame.left, frame.right)
                if advance is not None:
                    advance(1)
        if drive.odometry is not None:
            writer.odometry(drive.odometry)
        if drive.gnss is not None:
            writer.gnss(drive.gnss)
        if drive.reference is not None:
            writer.reference(drive.reference)
        if drive.scans:
            writer.scans(drive.scans)
        if drive.laps:
            writer.laps(drive.laps)
