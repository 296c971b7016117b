"""A sequence of the KITTI odometry benchmark, with the poses that lie beside the sequences.

The local frame of sequence SS is "kitti_odometry_SS": x forward and y left of the first Velodyne
frame (`Tr` of calib.txt leads from there to the first camera), so that maps labelled in LiDAR fit
as they are. The poses of the left grey camera become poses of the rear axle on the ground.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.images import ImagePairs, read_grey
from polemap.drivelog.readers import derived
from polemap.drivelog.readers.kitti import (
    CAMERA_ABOVE_M,
    CAMERA_AHEAD_M,
    WHEELBASE_M,
    entry,
    read_calibration,
    read_numbers,
    rig_of,
    rigid,
)
from polemap.drivelog.streams import ReferenceStream
from polemap.stereo.rig import Mounting, StereoRig

Floats = NDArray[np.float64]

# the makers of the benchmark give no figure for single poses; neighbouring frames agree to this
POSE_SD_M = 0.05
# cameras give ten pictures a second; times a hundred times as far apart are in another unit
_STEP_MAX_S = 10.0


class KittiOdometryReader:
    """Reads `sequences/SS` with `poses/SS.txt` beside `sequences`."""

    name = "kitti_odometry"

    def can_read(self, path: Path) -> bool:
        return (path / "times.txt").is_file() and (path / "calib.txt").is_file()

    def read(self, path: Path, *, seed: int = 0) -> Drive:
        """The drive; `seed` draws the noise of the derived odometry and GNSS.

        Raises:
            InputError: a file that is missing or holds something else than it should.
        """
        path = path.resolve()
        stamps = _times(path / "times.txt")
        pairs, notes = _pairs(path, len(stamps))
        stamps = stamps[: len(pairs)]
        calibration = read_calibration(path / "calib.txt")
        p0, p1 = (entry(calibration, name, (3, 4), path / "calib.txt") for name in ("P0", "P1"))
        camera_from_lidar = np.vstack(
            [entry(calibration, "Tr", (3, 4), path / "calib.txt"), [0.0, 0.0, 0.0, 1.0]]
        )
        camera_poses, pose_notes = _camera_poses(path, len(stamps))
        vehicle_from_camera = _vehicle_from_camera(camera_from_lidar, camera_poses)
        left = read_grey(pairs[0][0])
        mount = Mounting.from_rotation(vehicle_from_camera[:3, :3], vehicle_from_camera[:3, 3])
        rig = rig_of(p0, p1, (left.shape[1], left.shape[0]), mount, path / "calib.txt")
        drive = _drive(
            path,
            stamps,
            rig,
            ImagePairs(pairs, (rig.width_px, rig.height_px)),
            (*notes, *pose_notes),
        )
        if camera_poses is None:
            return drive
        poses = _rear_axle_poses(camera_poses, camera_from_lidar, vehicle_from_camera)
        return _with_sensors(drive, poses, seed)


def _drive(
    path: Path, stamps: Floats, rig: StereoRig, images: ImagePairs, notes: tuple[str, ...]
) -> Drive:
    name = f"kitti_odometry_{path.name}"
    return Drive(
        name=name,
        path=path,
        frame=EarthFrame("local", name=name),
        wheelbase_m=WHEELBASE_M,
        rig=rig,
        frame_stamps_s=stamps,
        frame_arrivals_s=stamps,
        frame_numbers=np.arange(len(stamps), dtype=np.int64),
        images=images,
        notes=notes,
    )


def _with_sensors(drive: Drive, poses: Floats, seed: int) -> Drive:
    stamps = drive.frame_stamps_s
    reference = ReferenceStream(stamps, poses, np.full(len(stamps), POSE_SD_M))
    if len(stamps) < 4:
        return replace(drive, reference=reference)
    odometry_rng, gnss_rng = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2)
    )
    return replace(
        drive,
        reference=reference,
        odometry=derived.derived_odometry(stamps, poses, odometry_rng),
        gnss=derived.derived_gnss(stamps, poses, gnss_rng),
        notes=(*drive.notes, *derived.NOTES),
    )


def _times(path: Path) -> Floats:
    stamps = read_numbers(path, 1)[:, 0]
    if not len(stamps):
        raise InputError(f"{path}: holds no times")
    if len(stamps) > 1 and float(np.median(np.diff(stamps))) > _STEP_MAX_S:
        raise InputError(
            f"{path}: times {stamps[0]:.6g}, {stamps[1]:.6g} … are no seconds: a frame every "
            f"{float(np.median(np.diff(stamps))):.4g}; write seconds from the first frame"
        )
    back = np.flatnonzero(np.diff(stamps) <= 0)
    if len(back):
        row = int(back[0]) + 1
        raise InputError(
            f"{path}: time {stamps[row]:.6f} of frame {row} does not follow {stamps[row - 1]:.6f}"
        )
    return stamps


def _pairs(path: Path, count: int) -> tuple[tuple[tuple[Path, Path], ...], list[str]]:
    """Image paths of the frames; an excerpt may end early, but it may not have holes."""
    pairs = tuple(
        (path / "image_0" / f"{i:06d}.png", path / "image_1" / f"{i:06d}.png") for i in range(count)
    )
    there = [left.is_file() and right.is_file() for left, right in pairs]
    length = count - there[::-1].index(True) if any(there) else 0
    if not length:
        raise InputError(f"{path}: image_0 and image_1 hold no pair of grey images (000000.png …)")
    if not all(there[:length]):
        pair = pairs[there.index(False)]
        missing = next(image for image in pair if not image.is_file())
        raise InputError(f"{missing}: image is missing, but the drive goes on after it")
    notes = [f"only {length} of {count} frames have images"] if length < count else []
    return pairs[:length], notes


def _camera_poses(path: Path, count: int) -> tuple[Floats | None, list[str]]:
    """Poses `(n, 4, 4)` of the left camera in the first one's frame, or None without a file."""
    file = path.parent.parent / "poses" / f"{path.name}.txt"
    if not file.is_file():
        note = "no poses lie beside the sequence: no reference, wheel odometry or GNSS"
        return None, [note]
    rows = read_numbers(file, 12).reshape(-1, 3, 4)
    if len(rows) < count:
        raise InputError(f"{file}: {len(rows)} poses for {count} frames")
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3] = rows[:count]
    return poses, []


def _vehicle_from_camera(camera_from_lidar: Floats, camera_poses: Floats | None) -> Floats:
    """Mounting `(4, 4)` of the left camera: how the rear axle moves shows where "ahead" is.

    The rear axle moves along the car. In these recordings that is 0.4 to 0.8 degrees to the left
    of where camera and LiDAR look, and the LiDAR hangs a degree out of the plane of motion. With
    too few poses the heading comes from the LiDAR and the pitch is taken to be level.
    """
    forward = camera_from_lidar[:3, 0]  # the LiDAR's x axis in camera axes
    yaw, pitch = float(np.arctan2(forward[0], forward[2])), 0.0
    if camera_poses is not None:
        yaw, pitch = _motion_axis(camera_poses) or (yaw, pitch)
    position = np.array([CAMERA_AHEAD_M, 0.0, CAMERA_ABOVE_M])
    return rigid(Mounting(yaw_rad=yaw, pitch_rad=pitch).rotation(), position)


def _motion_axis(camera_poses: Floats, step: int = 5) -> tuple[float, float] | None:
    """Yaw and pitch of the camera against the motion, from the straight parts; None if too few."""
    if len(camera_poses) <= step:
        return None
    first, last = camera_poses[:-step], camera_poses[step:]
    moved = np.einsum("nji,nj->ni", first[:, :3, :3], last[:, :3, 3] - first[:, :3, 3])
    ahead, left, up = moved[:, 2], -moved[:, 0], -moved[:, 1]
    turned = np.einsum("nji,njk->nik", first[:, :3, :3], last[:, :3, :3])
    turn = -np.arctan2(turned[:, 0, 2], turned[:, 2, 2])
    straight = (ahead > 0.5) & (np.abs(turn) < 0.01 * ahead)
    if np.count_nonzero(straight) < 10:
        return None
    # over an arc the camera moves along the mean heading, and sideways by lever arm times turn
    sideways = left - ahead * turn / 2.0 - CAMERA_AHEAD_M * turn
    yaw = -float(np.median((sideways / ahead)[straight]))
    return yaw, float(np.median((up / ahead)[straight]))


def _rear_axle_poses(
    camera_poses: Floats, camera_from_lidar: Floats, vehicle_from_camera: Floats
) -> Floats:
    """Rear-axle poses `(n, 3)` in the plane of the first LiDAR frame."""
    lidar_from_vehicle = (
        np.linalg.inv(camera_from_lidar) @ camera_poses @ np.linalg.inv(vehicle_from_camera)
    )
    yaw = np.arctan2(lidar_from_vehicle[:, 1, 0], lidar_from_vehicle[:, 0, 0])
    return np.column_stack([lidar_from_vehicle[:, 0, 3], lidar_from_vehicle[:, 1, 3], yaw])


reader = KittiOdometryReader()
