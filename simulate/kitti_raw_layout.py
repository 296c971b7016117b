"""A drive in the layout of the KITTI raw recordings: a folder of a day with one drive in it.

As in the synchronised drives, every picture has one row of the OXTS unit. That unit is the drive's
reference (place, heading) and its odometry (speed, yaw rate), so GNSS of a cheap receiver is not
in it. The unit stands where KITTI's does: 1.03 m and 0.05 m behind the left camera.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_folder
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import ConfigError
from polemap.drivelog.frames import convergence_rad, geographic_from_grid
from polemap.drivelog.readers.kitti import CAMERA_AHEAD_M, OXTS_BEHIND_M
from polemap.drivelog.writers.kitti_odometry import picture_poses, write_pairs
from polemap.map.io import write_map
from polemap.map.pole_map import PoleMap
from polemap.stereo.rig import StereoRig
from polemap.vehicle.pose import rotate, wrap_angle

Floats = NDArray[np.float64]
DAY = datetime(2011, 9, 26, 12, tzinfo=UTC)
_OXTS_ABOVE_M = 0.93
_FIELDS = 30
_LATITUDE, _LONGITUDE, _ALTITUDE, _YAW, _FORWARD_MPS, _UP_RADPS, _ACCURACY_M = 0, 1, 2, 5, 8, 22, 23


def write_kitti_raw(drive: Drive, root: Path, pole_map: PoleMap | None = None) -> Path:
    """Writes a drive as the only one of a new folder `root` of a day; returns the drive's folder.

    A map of its poles goes beside it as `poles.geojson`, since the layout has no place for one.

    Raises:
        ConfigError: the drive lacks images, odometry, a reference or a place on the earth, or its
            pictures are not 8 bit.
        InputError: the place cannot be written to.
    """
    poses = picture_poses(drive)
    if drive.odometry is None or not drive.frame.is_utm or drive.rig is None:
        raise ConfigError(f"drive {drive.name}: the KITTI raw layout needs odometry in a utm frame")
    name = f"{DAY:%Y_%m_%d}_drive_0001_sync"
    stamps = drive.frame_stamps_s - drive.frame_stamps_s[0]
    lines = "".join(f"{_moment(float(stamp))}\n" for stamp in stamps)
    with atomic_folder(root, "drive") as folder:
        place = folder / name
        sides = (place / "image_00", place / "image_01")
        write_pairs(drive, (sides[0] / "data", sides[1] / "data"), digits=10)
        (place / "oxts" / "data").mkdir(parents=True)
        for part in (*sides, place / "oxts"):
            (part / "timestamps.txt").write_text(lines, encoding="utf-8")
        for number, row in enumerate(_oxts_rows(drive, poses, drive.rig)):
            text = " ".join(f"{value:.13g}" for value in row) + " 4 10 6 6 6\n"
            (place / "oxts" / "data" / f"{number:010d}.txt").write_text(text, encoding="utf-8")
        for file, entries in _calibration(drive.rig).items():
            text = "".join(
                f"{key}: " + " ".join(f"{value:.12e}" for value in np.ravel(values)) + "\n"
                for key, values in entries.items()
            )
            (folder / file).write_text(text, encoding="utf-8")
        if pole_map is not None:
            write_map(pole_map, folder / "poles.geojson")
    return Path(root) / name


def _moment(stamp_s: float) -> str:
    whole, nanoseconds = divmod(round(stamp_s * 1e9), 1_000_000_000)
    return f"{DAY + timedelta(seconds=whole):%Y-%m-%d %H:%M:%S}.{nanoseconds:09d}"


def _oxts_rows(drive: Drive, poses: Floats, rig: StereoRig) -> Floats:
    """The first 25 fields of every row; what the simulator does not know is 0."""
    mount, odometry = rig.vehicle_from_camera, drive.odometry
    if odometry is None:
        raise ConfigError(f"drive {drive.name}: no odometry")
    ahead, left = mount.x_m - CAMERA_AHEAD_M - OXTS_BEHIND_M, mount.y_m
    unit = poses[:, :2] + rotate([ahead, left], poses[:, 2])
    rows = np.zeros((len(poses), _FIELDS - 5))
    rows[:, [_LATITUDE, _LONGITUDE]] = geographic_from_grid(drive.frame, unit)
    rows[:, _ALTITUDE] = _OXTS_ABOVE_M
    rows[:, _YAW] = wrap_angle(poses[:, 2] - convergence_rad(drive.frame, unit))
    rate = np.interp(drive.frame_stamps_s, odometry.stamp_s, odometry.yaw_rate_radps)
    speed = np.interp(drive.frame_stamps_s, odometry.stamp_s, odometry.speed_mps)
    # the forward part of the unit's speed: it stands beside the middle of the axle
    rows[:, _FORWARD_MPS], rows[:, _UP_RADPS] = speed - rate * left, rate
    rows[:, _ACCURACY_M] = 0.05
    return rows


def _calibration(rig: StereoRig) -> dict[str, dict[str, Floats]]:
    """Entries of the three calibration files; the "Velodyne" sits in the OXTS unit."""
    oxts_from_camera = rig.vehicle_from_camera.rotation()
    position = np.array([CAMERA_AHEAD_M + OXTS_BEHIND_M, 0.0, rig.vehicle_from_camera.z_m])
    position[2] -= _OXTS_ABOVE_M
    cameras: dict[str, Floats] = {}
    for number, shift in (("00", 0.0), ("01", -rig.focal_px * rig.baseline_m)):
        cameras[f"S_rect_{number}"] = np.array([rig.width_px, rig.height_px], dtype=np.float64)
        cameras[f"R_rect_{number}"] = np.eye(3)
        cameras[f"P_rect_{number}"] = np.array(
            [[rig.focal_px, 0, rig.cx_px, shift], [0, rig.focal_px, rig.cy_px, 0], [0, 0, 1.0, 0]]
        )
    return {
        "calib_cam_to_cam.txt": cameras,
        "calib_imu_to_velo.txt": {"R": np.eye(3), "T": np.zeros(3)},
        "calib_velo_to_cam.txt": {"R": oxts_from_camera.T, "T": -oxts_from_camera.T @ position},
    }
