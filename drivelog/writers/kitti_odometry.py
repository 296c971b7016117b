"""A drive in the layout of the KITTI odometry benchmark: sequences/SS, poses/SS.txt, poles/SS.csv.

That layout has neither odometry nor GNSS; whoever reads it derives them from the poses and says so.
A drive without a reference gets no poses.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_folder
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import ConfigError, InputError
from polemap.stereo.rig import StereoRig
from polemap.vehicle.pose import rotation

Floats = NDArray[np.float64]

# the "Velodyne" sits in the left camera: x forward, y left, z up to x right, y down, z forward
_CAMERA_FROM_LIDAR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def camera_poses(poses: Floats, rig: StereoRig) -> Floats:
    """Poses `(n, 4, 4)` of the left camera from rear-axle poses `(n, 3)`, on level ground."""
    mount = rig.vehicle_from_camera
    vehicle_from_camera = np.eye(4)
    vehicle_from_camera[:3, :3] = mount.rotation()
    vehicle_from_camera[:3, 3] = (mount.x_m, mount.y_m, mount.z_m)
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    out[:, :2, :2] = rotation(poses[:, 2])
    out[:, :2, 3] = poses[:, :2]
    return np.asarray(out @ vehicle_from_camera)


def write_kitti_odometry(
    drive: Drive,
    root: Path,
    sequence: str = "00",
    poles_m: Floats | None = None,
    advance: Callable[[int], None] | None = None,
) -> Path:
    """Writes a drive as sequence `sequence` under a new folder `root`; returns the sequence folder.

    Pairs at which the reference knows no pose are left out: KITTI has a pose for each.

    Args:
        poles_m: `(n, 2)` in the drive's frame, for poles/SS.csv; needs a reference.
        advance: called with 1 after every pair of pictures.

    Raises:
        ConfigError: the drive lacks images, its pictures are not 8 bit, or its reference covers
            less than two of them.
        OutputError: the place cannot be written to.
    """
    if drive.rig is None or not drive.has_frames:
        raise ConfigError(f"drive {drive.name}: the KITTI layout needs images; write a folder")
    rows = kept_rows(drive)
    stamps = drive.frame_stamps_s[rows]
    cameras = None
    if drive.reference is not None:
        cameras = camera_poses(drive.reference.at(stamps), drive.rig)
    with atomic_folder(root, "drive") as folder:
        place = folder / "sequences" / sequence
        write_pairs(drive, (place / "image_0", place / "image_1"), 6, advance, rows)
        np.savetxt(place / "times.txt", stamps - stamps[0], fmt="%.6e")
        (place / "calib.txt").write_text(_calibration(drive.rig), encoding="utf-8")
        if cameras is not None:
            (folder / "poses").mkdir()
            from_first = np.linalg.inv(cameras[0]) @ cameras
            np.savetxt(folder / "poses" / f"{sequence}.txt", from_first[:, :3].reshape(-1, 12))
            if poles_m is not None:
                (folder / "poles").mkdir()
                np.savetxt(
                    folder / "poles" / f"{sequence}.csv", _in_first_lidar(poles_m, cameras[0]),
                    fmt="%.4f", delimiter=",", header="x_m,y_m", comments="",
                )  # fmt: skip
    return Path(root) / "sequences" / sequence


def kept_rows(drive: Drive) -> NDArray[np.int64]:
    """Rows of the pairs that KITTI can hold: those with a pose, or all without a reference.

    Raises:
        ConfigError: fewer than two have a pose.
    """
    rows = np.arange(len(drive.frame_stamps_s))
    if drive.reference is None:
        return rows
    kept = rows[np.isfinite(drive.reference.at(drive.frame_stamps_s)).all(axis=1)]
    if len(kept) < 2:
        raise ConfigError(
            f"drive {drive.name}: the reference knows a pose at {len(kept)} of {len(rows)} "
            "pictures, and KITTI has one for each; check the stamps, or leave the reference away"
        )
    return kept


def picture_poses(drive: Drive) -> Floats:
    """Rear-axle poses `(n, 3)` of the reference at all pictures.

    Raises:
        ConfigError: there are no pictures, or no reference at some.
    """
    if drive.rig is None or not drive.has_frames or drive.reference is None:
        raise ConfigError(f"drive {drive.name}: the KITTI layout needs images and a reference")
    poses = drive.reference.at(drive.frame_stamps_s)
    if not np.isfinite(poses).all():
        without = int(np.count_nonzero(~np.isfinite(poses).all(axis=1)))
        raise ConfigError(
            f"drive {drive.name}: the reference does not cover every picture ({without} of "
            f"{len(poses)} are without), and KITTI has a pose for each; take a lap that it covers, "
            "or leave the reference away"
        )
    return poses


def write_pairs(
    drive: Drive,
    sides: tuple[Path, Path],
    digits: int,
    advance: Callable[[int], None] | None = None,
    rows: NDArray[np.int64] | None = None,
) -> None:
    """Writes pairs, all or those of some rows, as numbered PNGs into two new folders.

    Raises:
        ConfigError: the pictures are not 8 bit.
    """
    for side in sides:
        side.mkdir(parents=True)
    for number, row in enumerate(range(len(drive.frame_stamps_s)) if rows is None else rows):
        frame = drive.read_frame(int(row))
        for side, image in zip(sides, (frame.left, frame.right), strict=True):
            if image.dtype != np.uint8:
                raise ConfigError(
                    f"drive {drive.name}: the KITTI layout has 8-bit pictures, and these have "
                    f"{8 * image.dtype.itemsize}; write a folder or .mcap"
                )
            done, data = cv2.imencode(".png", image)
            if not done:
                raise InputError(f"{side}: picture {row} cannot be encoded")
            (side / f"{number:0{digits}d}.png").write_bytes(data.tobytes())
        if advance is not None:
            advance(1)


def _in_first_lidar(points_m: Floats, first_camera: Floats) -> Floats:
    count = len(points_m)
    ground = np.column_stack([points_m, np.zeros(count), np.ones(count)])
    lidar_from_map = np.linalg.inv(_CAMERA_FROM_LIDAR) @ np.linalg.inv(first_camera)
    return np.asarray((ground @ lidar_from_map.T)[:, :2])


def _calibration(rig: StereoRig) -> str:
    lines = []
    for name, shift in (("P0", 0.0), ("P1", -rig.focal_px * rig.baseline_m)):
        matrix = [rig.focal_px, 0, rig.cx_px, shift, 0, rig.focal_px, rig.cy_px, 0, 0, 0, 1, 0]
        lines.append(f"{name}: " + " ".join(f"{value:.12e}" for value in matrix))
    tr = _CAMERA_FROM_LIDAR[:3].ravel()
    lines.append("Tr: " + " ".join(f"{value:.12e}" for value in tr))
    return "\n".join(lines) + "\n"
