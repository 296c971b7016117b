"""A sequence of the KITTI odometry benchmark, with the poses that lie beside the sequences.

The local frame of sequence SS is "kitti_odometry_SS": x forward and y left of the first Velodyne
frame (`Tr` of calib.txt leads from there to the first camera), so that maps labelled in LiDAR fit
as they are. The poses of the left grey camera become poses of the rear axle on the ground.
"""

from __future__ import annotations

from collections import Counter
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
from polemap.drivelog.readers.kitti_clock import gap_note
from polemap.drivelog.readers.kitti_pictures import NumberedPairs, find_pairs, lines_of
from polemap.drivelog.source_names import CalibrationNames, SourceNames
from polemap.drivelog.streams import ReferenceStream
from polemap.stereo.rig import Mounting

Floats = NDArray[np.float64]

# the makers of the benchmark give no figure for single poses; neighbouring frames agree to this
POSE_SD_M = 0.05
# cameras give ten pictures a second; times a hundred times as far apart are in another unit
_STEP_MAX_S = 10.0
_PAIRS = (("0", "1"), ("2", "3"))  # grey, else colour


class KittiOdometryReader:
    """Reads `sequences/SS` with `poses/SS.txt` beside `sequences`."""

    name = "kitti_odometry"

    def can_read(self, path: Path) -> bool:
        pictures = any((path / f"image_{left}").is_dir() for left, _ in _PAIRS)
        return (path / "calib.txt").is_file() and (pictures or (path / "times.txt").is_file())

    def read(self, path: Path, *, seed: int = 0) -> Drive:
        """The drive; `seed` draws the noise of the derived odometry and GNSS.

        Raises:
            InputError: a file that is missing or holds something else than it should.
        """
        path = path.resolve()
        problems: Counter[str] = Counter()
        times = _times(path / "times.txt")
        found, lines, notes = _pairs(path, times, problems)
        file = path / "calib.txt"
        calibration = read_calibration(file)
        left, right = (entry(calibration, f"P{name}", (3, 4), file) for name in found.cameras)
        camera_from_lidar = np.vstack(
            [entry(calibration, "Tr", (3, 4), file), [0.0, 0.0, 0.0, 1.0]]
        )
        known, camera_poses, pose_notes = _camera_poses(path, found.numbers, lines)
        vehicle_from_camera = _vehicle_from_camera(camera_from_lidar, camera_poses)
        first = read_grey(found.paths[0][0])
        # P = K [I | t]: a colour camera stands at -t in the frame of the grey one, whose poses are
        # known
        shift = -np.linalg.inv(left[:, :3]) @ left[:, 3]
        turn, place = vehicle_from_camera[:3, :3], vehicle_from_camera[:3, 3]
        mount = Mounting.from_rotation(turn, place + turn @ shift)
        rig = rig_of(left, right, (first.shape[1], first.shape[0]), mount, file)
        stamps = times[list(lines.values())]
        drive = Drive(
            name=f"kitti_odometry_{path.name}",
            path=path,
            frame=EarthFrame("local", name=f"kitti_odometry_{path.name}"),
            wheelbase_m=WHEELBASE_M,
            rig=rig,
            frame_stamps_s=stamps,
            frame_arrivals_s=stamps,
            frame_numbers=np.array(found.numbers, dtype=np.int64),
            images=ImagePairs(found.paths, (rig.width_px, rig.height_px)),
            notes=(*notes, *pose_notes),
            problems=dict(problems),
            names=SourceNames(
                frames=" and ".join(f"image_{name}" for name in found.cameras),
                odometry="odometry derived from the poses",
                gnss="fixes derived from the poses",
                reference=f"poses/{path.name}.txt",
                head="calib.txt",
                calibration=_calibration_names(*found.cameras),
            ),
        )
        if not len(camera_poses):
            return drive
        poses = _rear_axle_poses(camera_poses, camera_from_lidar, vehicle_from_camera)
        return _with_sensors(drive, times[known], poses, seed)


def _calibration_names(left: str, right: str) -> CalibrationNames:
    """The entries of calib.txt, and what is not written down but known of the car."""
    car = "of KITTI's car, which is known to this reader"
    return CalibrationNames(
        wheelbase=f"the wheelbase {car}",
        focal=f"P{left}[0,0] of calib.txt",
        centre_x=f"P{left}[0,2] of calib.txt",
        centre_y=f"P{left}[1,2] of calib.txt",
        baseline=f"(P{left}[0,3] - P{right}[0,3]) / P{left}[0,0] of calib.txt",
        height=f"the camera's height {car}",
        pitch="the pitch that the poses show",
        yaw="the yaw that the poses show",
    )


def _with_sensors(drive: Drive, stamps: Floats, poses: Floats, seed: int) -> Drive:
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
        odometry_is_derived=True,
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


def _pairs(
    path: Path, times: Floats, problems: Counter[str]
) -> tuple[NumberedPairs, dict[int, int], list[str]]:
    """The pairs that have a time, the line of `times` that each number has, and what to note."""
    found = find_pairs(path, _PAIRS)
    if found is None:
        raise InputError(
            f"{path}: neither image_0 and image_1 nor image_2 and image_3 hold pictures "
            "(000000.png …)"
        )
    if found.one_sided:
        problems["frames_one_side_missing"] += found.one_sided
    lines, by_position = lines_of(found.numbers, len(times))
    kept = [k for k, number in enumerate(found.numbers) if number in lines]
    if not kept:
        raise InputError(
            f"{path / 'times.txt'}: {len(times)} times, but the pictures are numbered "
            f"{found.numbers[0]} to {found.numbers[-1]}: keep the times of the whole sequence, or "
            "one a picture"
        )
    if lost := len(found.numbers) - len(kept):
        problems["frames_without_time"] += lost
    found = found.take(kept)
    notes = []
    if found.cameras != _PAIRS[0]:
        notes.append("no grey pictures: the colour pair image_2, image_3 is taken, turned to grey")
    numbers = found.numbers
    if by_position:
        notes.append(
            f"pictures {numbers[0]} to {numbers[-1]} have the {len(times)} times of times.txt in "
            "their order"
        )
        return found, lines, notes
    if numbers[0] > 0:
        notes.append(f"the pictures begin with number {numbers[0]}")
    if numbers[-1] + 1 < len(times):
        notes.append(f"only {numbers[-1] + 1} of {len(times)} frames have images")
    if note := gap_note("frames", list(numbers), numbers[-1] + 1, numbers[0]):
        notes.append(note)
    return found, lines, notes


def _camera_poses(
    path: Path, numbers: tuple[int, ...], lines: dict[int, int]
) -> tuple[list[int], Floats, list[str]]:
    """Poses `(m, 4, 4)` of the left grey camera in the first one's frame, with their time's line.

    Between the first and the last picture every pose counts, whether its picture is there or not.
    """
    file = path.parent.parent / "poses" / f"{path.name}.txt"
    none = np.empty((0, 4, 4))
    if not file.is_file():
        return [], none, ["no poses lie beside the sequence: no reference, wheel odometry or GNSS"]
    rows = read_numbers(file, 12).reshape(-1, 3, 4)
    notes = []
    whole = all(number == line for number, line in lines.items())
    if len(rows) > numbers[-1]:
        wanted = range(numbers[0], numbers[-1] + 1) if whole else numbers
        at = {lines.get(number, number): number for number in wanted}
    elif len(rows) == len(numbers):
        at = {lines[number]: k for k, number in enumerate(numbers)}
        notes.append(f"{file.name}: {len(rows)} poses for as many pictures, taken in their order")
    else:
        at = {lines[number]: number for number in numbers if number < len(rows)}
        notes.append(
            f"{file.name}: {len(rows)} poses, so only {len(at)} of {len(numbers)} pictures "
            "have one: beyond there is no reference"
        )
    poses = np.tile(np.eye(4), (len(at), 1, 1))
    poses[:, :3] = rows[list(at.values())]
    return list(at), poses, notes


def _vehicle_from_camera(camera_from_lidar: Floats, camera_poses: Floats) -> Floats:
    """Mounting `(4, 4)` of the left camera: how the rear axle moves shows where "ahead" is.

    The rear axle moves along the car. In these recordings that is 0.4 to 0.8 degrees to the left
    of where camera and LiDAR look, and the LiDAR hangs a degree out of the plane of motion. With
    too few poses the heading comes from the LiDAR and the pitch is taken to be level.
    """
    forward = camera_from_lidar[:3, 0]  # the LiDAR's x axis in camera axes
    level = float(np.arctan2(forward[0], forward[2])), 0.0
    yaw, pitch = _motion_axis(camera_poses) or level
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
