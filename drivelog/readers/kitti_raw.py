"""A KITTI raw drive (`_sync` or `_extract`), calibration in the folder of its day.

The pictures of `_extract` are not rectified; their size tells, and they are, as they are read.

Numbers of files are kept: line i of a timestamps file belongs to file i, and where files are
missing there is a gap. OXTS gives speed, yaw rate, GNSS and the reference, all moved from the
unit to the rear axle; the reference is in the UTM zone of the first fix, its heading turned by the
meridian convergence.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive, FrameSource
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, grid_from_geographic, grid_yaw, utm_frame
from polemap.drivelog.images import ImagePairs, RectifiedPairs, read_grey
from polemap.drivelog.readers.kitti import (
    CAMERA_ABOVE_M,
    CAMERA_AHEAD_M,
    OXTS_BEHIND_M,
    WHEELBASE_M,
    entry,
    read_calibration,
    read_text,
    rig_of,
    rigid,
)
from polemap.drivelog.readers.kitti_clock import gap_note, read_timestamps
from polemap.drivelog.readers.kitti_pictures import NumberedPairs, find_pairs
from polemap.drivelog.source_names import CalibrationNames, SourceNames
from polemap.drivelog.streams import GnssStream, OdometryStream, ReferenceStream
from polemap.stereo.errors import StereoError
from polemap.stereo.io import read_kitti_calibration
from polemap.stereo.rectify import Rectifier
from polemap.stereo.rig import Mounting, StereoRig
from polemap.vehicle.pose import rotate

Floats = NDArray[np.float64]

_PAIRS = (("00", "01"), ("02", "03"))  # grey, else colour
_CAMERAS = "calib_cam_to_cam.txt"
_NAMES = SourceNames(
    frames="the pictures",
    odometry="oxts (vf, wu)",
    gnss="oxts (lat, lon)",
    reference="oxts (lat, lon, yaw)",
    head=_CAMERAS,
)
_LATITUDE, _LONGITUDE, _YAW, _FORWARD_MPS, _UP_RADPS, _ACCURACY_M = 0, 1, 5, 8, 22, 23
_FIELDS = 30


class KittiRawReader:
    """Reads `DATE/DATE_drive_NNNN_sync` and `DATE/DATE_drive_NNNN_extract`."""

    name = "kitti_raw"

    def can_read(self, path: Path) -> bool:
        return (
            any((path / f"image_{left}" / "data").is_dir() for left, _ in _PAIRS)
            or (path / "oxts" / "timestamps.txt").is_file()
        )

    def read(self, path: Path, *, seed: int = 0) -> Drive:
        """The drive; everything in it was measured, so that `seed` changes nothing.

        Raises:
            InputError: a file that is missing or holds something else than it should.
        """
        path = path.resolve()
        problems: Counter[str] = Counter()
        notes: list[str] = []
        lidar_from_oxts, camera_from_lidar = _lever_arms(path.parent)
        oxts_from_camera: Floats = np.linalg.inv(camera_from_lidar @ lidar_from_oxts).astype(float)
        antenna = np.array([-OXTS_BEHIND_M, -oxts_from_camera[1, 3]])
        numbers, stamps, images, rig = _frames(path, oxts_from_camera, notes, problems)
        frame, odometry, gnss, reference = _oxts(path, antenna, notes, problems)
        return Drive(
            name=path.name,
            path=path,
            frame=frame,
            wheelbase_m=WHEELBASE_M,
            rig=rig,
            gnss_antenna_m=antenna,
            frame_stamps_s=stamps,
            frame_arrivals_s=stamps,
            frame_numbers=numbers,
            images=images,
            odometry=odometry,
            gnss=gnss,
            reference=reference,
            notes=tuple(notes),
            problems=dict(problems),
            names=replace(_NAMES, calibration=_calibration_names(path)),
        )


def _calibration_names(path: Path) -> CalibrationNames:
    """The entries of the day's files; the mounting is that of the camera against the OXTS unit."""
    left, right = next(
        (pair for pair in _PAIRS if (path / f"image_{pair[0]}" / "data").is_dir()), _PAIRS[0]
    )
    chain = "by calib_velo_to_cam.txt and calib_imu_to_velo.txt"
    car = "of KITTI's car, which is known to this reader"
    return CalibrationNames(
        wheelbase=f"the wheelbase {car}",
        focal=f"P_rect_{left}[0,0] of {_CAMERAS}",
        centre_x=f"P_rect_{left}[0,2] of {_CAMERAS}",
        centre_y=f"P_rect_{left}[1,2] of {_CAMERAS}",
        baseline=f"(P_rect_{left}[0,3] - P_rect_{right}[0,3]) / P_rect_{left}[0,0] of {_CAMERAS}",
        height=f"the camera's height {car}",
        pitch=f"the pitch {chain}",
        yaw=f"the yaw {chain}",
    )


def _lever_arms(day: Path) -> tuple[Floats, Floats]:
    """LiDAR from OXTS and rectified left grey camera from LiDAR, `(4, 4)` each."""
    motions = []
    for name in ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt"):
        file = day / name
        calibration = read_calibration(file)
        motions.append(
            rigid(entry(calibration, "R", (3, 3), file), entry(calibration, "T", (3,), file))
        )
    file = day / _CAMERAS
    rectify = entry(read_calibration(file), "R_rect_00", (3, 3), file)
    return motions[0], rigid(rectify, np.zeros(3)) @ motions[1]


def _frames(
    path: Path, oxts_from_camera: Floats, notes: list[str], problems: Counter[str]
) -> tuple[NDArray[np.int64], Floats, FrameSource | None, StereoRig | None]:
    found = find_pairs(path, _PAIRS, "data")
    if found is None:
        notes.append("the drive has no stereo images")
        return np.empty(0, dtype=np.int64), np.empty(0), None, None
    times = read_timestamps(path / f"image_{found.cameras[0]}" / "timestamps.txt", problems)
    if found.one_sided:
        problems["frames_one_side_missing"] += found.one_sided
    known = [k for k, number in enumerate(found.numbers) if number in times]
    if len(known) < len(found.numbers):
        problems["frames_without_time"] += len(found.numbers) - len(known)
    if not known:
        raise InputError(
            f"{path}: none of the pictures {found.numbers[0]} to {found.numbers[-1]} has a time in "
            f"image_{found.cameras[0]}/timestamps.txt ({len(times)} times): keep that of the whole "
            "drive"
        )
    found = found.take(known)
    if found.cameras != _PAIRS[0]:
        notes.append("no grey pictures: the colour pair 02, 03 is taken, turned to grey")
    if note := gap_note("frames", list(found.numbers), max(times) + 1):
        notes.append(note)
    numbers = np.array(found.numbers, dtype=np.int64)
    stamps = np.array([times[number] for number in found.numbers])
    rig, images = _cameras(path.parent / _CAMERAS, found, oxts_from_camera, notes)
    return numbers, stamps, images, rig


def _cameras(
    file: Path, found: NumberedPairs, oxts_from_camera: Floats, notes: list[str]
) -> tuple[StereoRig, FrameSource]:
    """The rig of a pair and its pictures, rectified here where they are those of `_extract`.

    The axes of the cameras relative to the car are those relative to the OXTS unit.
    """
    calibration = read_calibration(file)
    left, right = (entry(calibration, f"P_rect_{name}", (3, 4), file) for name in found.cameras)
    rotation = oxts_from_camera[:3, :3]
    # P = K [I | t]: the camera of a pair stands at -t in the frame of camera 00
    shift = -np.linalg.inv(left[:, :3]) @ left[:, 3]
    position = np.array([CAMERA_AHEAD_M, 0.0, CAMERA_ABOVE_M]) + rotation @ shift
    mount = Mounting.from_rotation(rotation, position)
    image = found.paths[0][0]
    first = read_grey(image)
    size = (first.shape[1], first.shape[0])
    sizes = {}
    for kind in ("S_rect", "S"):
        if f"{kind}_{found.cameras[0]}" in calibration:
            width, height = entry(calibration, f"{kind}_{found.cameras[0]}", (2,), file)
            sizes[kind] = (int(width), int(height))
    # sizes that are equal leave the name to tell
    named_raw = size == sizes.get("S") and image.parents[2].name.endswith("_extract")
    if size == sizes.get("S_rect", size) and not named_raw:
        return rig_of(left, right, size, mount, file), ImagePairs(found.paths, size)
    if size != sizes.get("S"):
        known = " and ".join(f"{w}x{h} ({kind})" for kind, (w, h) in sizes.items())
        raise InputError(
            f"{image}: {size[0]}x{size[1]} pixels, but {file.name} knows pictures of {known}: take "
            "the calibration of the drive's day"
        )
    try:
        rectifier = Rectifier(read_kitti_calibration(file, *found.cameras), mount)
    except StereoError as error:
        raise InputError(str(error)) from error
    notes.append(f"the pictures are not rectified: they are, as they are read, with {file.name}")
    return rectifier.rig, RectifiedPairs(ImagePairs(found.paths, size), rectifier)


def _oxts(
    path: Path, antenna: Floats, notes: list[str], problems: Counter[str]
) -> tuple[EarthFrame, OdometryStream | None, GnssStream | None, ReferenceStream | None]:
    folder = path / "oxts"
    numbers, rows = _oxts_rows(folder, problems)
    clock = folder / "timestamps.txt"
    if numbers and not clock.is_file():
        notes.append(f"{len(numbers)} OXTS rows have no times ({clock} is missing)")
        numbers = []
    times = read_timestamps(clock, problems, leave_out="oxts_time_runs_back") if numbers else {}
    known = [i for i, number in enumerate(numbers) if number in times]
    if not known:
        notes.append("the drive has no OXTS data: no odometry, GNSS or reference")
        return EarthFrame("local", name=path.name), None, None, None
    if note := gap_note("OXTS rows", [numbers[i] for i in known], max(times) + 1):
        notes.append(note)
    notes.append(
        "GNSS is the position of the OXTS unit, as good as the reference: a cheap receiver's fixes "
        "are not part of the recording"
    )
    data = rows[known]
    stamps = np.array([times[numbers[i]] for i in known])
    frame = utm_frame(float(data[0, _LATITUDE]), float(data[0, _LONGITUDE]))
    fixes = grid_from_geographic(frame, data[:, _LATITUDE], data[:, _LONGITUDE])
    yaw = grid_yaw(frame, data[:, _YAW], fixes)
    rear = fixes[:, :2] - rotate(antenna, yaw)
    # v_axle = v_unit + w x (axle - unit); forward part: -w * (-antenna_y)
    speed = data[:, _FORWARD_MPS] + data[:, _UP_RADPS] * antenna[1]
    return (
        frame,
        OdometryStream(stamps, stamps, speed, data[:, _UP_RADPS]),
        GnssStream(stamps, stamps, fixes[:, 0], fixes[:, 1], np.ones(len(stamps))),
        ReferenceStream(stamps, np.column_stack([rear, yaw]), data[:, _ACCURACY_M]),
    )


def _oxts_rows(folder: Path, problems: Counter[str]) -> tuple[list[int], Floats]:
    numbers, rows = [], []
    for file in sorted((folder / "data").glob("*.txt")):
        try:
            values = [float(word) for word in read_text(file).split()]
        except ValueError:
            values = []
        usable = len(values) >= _FIELDS - 5 and bool(np.isfinite(values[:25]).all())
        if not file.stem.isdigit() or not usable or abs(values[_LATITUDE]) > 90:
            problems["oxts_unusable_rows"] += 1
            continue
        numbers.append(int(file.stem))
        rows.append(values[:25])
    return numbers, np.array(rows, dtype=np.float64).reshape(-1, 25)


reader = KittiRawReader()
