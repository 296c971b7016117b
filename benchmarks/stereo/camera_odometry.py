"""Drift and time of camera odometry on real drives, beside a plain LK + PnP in the same run.

    python -m benchmarks.stereo.camera_odometry [DRIVE...]

Drift is KITTI's: over every stretch of 20 and of 40 m, the translation in percent of its length and
the rotation in degrees a metre. Without drives the recordings beside the project are taken.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import RECORDINGS, Figures, command_line
from polemap.drivelog.drive import Drive
from polemap.drivelog.readers.registry import open_drive
from polemap.stereo.odometry.camera_odometry import CameraOdometry
from polemap.stereo.odometry.motion import vehicle_step
from polemap.stereo.rig import StereoRig
from polemap.vehicle.pose import relative, wrap_angle

Floats = NDArray[np.float64]
Grey = NDArray[np.uint8]
Advance = Callable[[float, Grey, Grey], Floats]

DRIVES = {
    "KITTI 03": RECORDINGS / "kitti_odometry/sequences/03",
    "KITTI 00": RECORDINGS / "kitti_odometry/sequences/00",
    "raw 0039": RECORDINGS / "kitti_raw/2011_09_26/2011_09_26_drive_0039_sync",
}
LENGTHS_M = (20.0, 40.0)


class PlainOdometry:
    """Sixty lines: best corners, Lucas-Kanade to the right and to the next picture, PnP."""

    def __init__(self, rig: StereoRig) -> None:
        self._rig, self._before = rig, cast("tuple[Grey, Grey] | None", None)

    def advance(self, _stamp_s: float, left: Grey, right: Grey) -> Floats:
        """`(4, 4)` motion of camera points from the pair before to this one."""
        motion, before = np.eye(4), self._before
        self._before = (left, right)
        if before is None:
            return motion
        corners = cv2.goodFeaturesToTrack(before[0], 800, 0.005, 12)
        if corners is None:
            return motion
        in_right, good_right, _ = cv2.calcOpticalFlowPyrLK(*before, corners, None)  # type: ignore[call-overload]
        now, good_now, _ = cv2.calcOpticalFlowPyrLK(before[0], left, corners, None)  # type: ignore[call-overload]
        a, r, b = (np.asarray(p, dtype=np.float64).reshape(-1, 2) for p in (corners, in_right, now))
        disparity = a[:, 0] - r[:, 0]
        good = (np.asarray(good_right).ravel() > 0) & (np.asarray(good_now).ravel() > 0)
        good &= (disparity > 1.0) & (np.abs(a[:, 1] - r[:, 1]) < 2.0)
        rig = self._rig
        points = rig.camera_points(a[good, 0], a[good, 1], disparity[good])
        camera = np.array(
            [[rig.focal_px, 0.0, rig.cx_px], [0.0, rig.focal_px, rig.cy_px], [0.0, 0.0, 1.0]]
        )
        found, turn, shift, _ = cv2.solvePnPRansac(
            points, b[good], camera, None, reprojectionError=1.0, iterationsCount=200
        )
        if found:
            motion[:3, :3] = cv2.Rodrigues(turn)[0]
            motion[:3, 3] = np.asarray(shift).ravel()
        return motion


def drift(estimated: Floats, reference: Floats, length_m: float) -> tuple[float, float]:
    """Mean errors of planar poses `(n, 3)` over stretches: percent, and degrees a metre."""
    steps = np.linalg.norm(np.diff(reference[:, :2], axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    shifts, turns = [], []
    for first in range(len(way)):
        last = int(np.searchsorted(way, way[first] + length_m))
        if last == len(way):
            break
        length = way[last] - way[first]
        moved, true = (relative(p[first], p[last]) for p in (estimated, reference))
        error = moved - true
        shifts.append(100.0 * np.hypot(*error[:2]) / length)
        turns.append(np.degrees(abs(wrap_angle(error[2]))) / length)
    return float(np.mean(shifts)), float(np.mean(turns))


def follow(drive: Drive, advance: Advance) -> tuple[Floats, float]:
    """Planar rear-axle poses `(n, 3)`, and milliseconds of CPU a pair without reading it."""
    assert drive.rig is not None
    pose, poses, spent = np.eye(4), [], 0.0
    for row in range(len(drive.frame_stamps_s)):
        frame = drive.read_frame(row)
        left, right = np.asarray(frame.left, np.uint8), np.asarray(frame.right, np.uint8)
        begin = time.process_time()
        motion = advance(frame.stamp_s, left, right)
        spent += time.process_time() - begin
        pose = pose @ vehicle_step(drive.rig, motion)
        poses.append((pose[0, 3], pose[1, 3], np.arctan2(pose[1, 0], pose[0, 0])))
    return np.array(poses), 1e3 * spent / len(poses)


def run(drives: dict[str, Path] | None = None) -> Figures:
    """Drift over 20 and 40 m and time of both, for each drive that is there and has a reference."""
    figures: Figures = {}
    cv2.setNumThreads(1)
    for name, path in (DRIVES if drives is None else drives).items():
        if not path.is_dir():
            print(f"{path}: not there, left out")
            continue
        drive = open_drive(path)
        if drive.reference is None or drive.rig is None:
            print(f"{path}: without a reference, left out")
            continue
        reference = np.column_stack(
            [
                np.interp(drive.frame_stamps_s, drive.reference.stamp_s, values)
                for values in np.column_stack(
                    [drive.reference.poses[:, :2], np.unwrap(drive.reference.poses[:, 2])]
                ).T
            ]
        )
        ours = CameraOdometry(drive.rig)
        kinds: dict[str, Advance] = {
            "ours": lambda s, l, r, o=ours: o.advance(s, l, r).current_from_previous,  # type: ignore[misc]  # noqa: E741
            "plain": PlainOdometry(drive.rig).advance,
        }
        for kind, advance in kinds.items():
            poses, spent_ms = follow(drive, advance)
            row = {"cpu_ms": spent_ms}
            for length in LENGTHS_M:
                row[f"percent_{length:.0f}m"], row[f"deg_per_m_{length:.0f}m"] = drift(
                    poses, reference, length
                )
            figures[f"{name} {kind}"] = row
    return figures


def main() -> None:
    """Command line."""
    chosen = command_line(__doc__, paths="drives").drives
    for name, row in run({path.name: path for path in chosen} or None).items():
        print(f"{name:16}", "  ".join(f"{key} {value:.4g}" for key, value in row.items()))


if __name__ == "__main__":
    main()
