"""How the camera moves from frame to frame: features with disparity, followed, and a robust pose.

Short and plain on purpose: it serves the mounting and the odometry of a drive, frame by frame, and
keeps no map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.calibration.estimate import Fit, blocks_of, fit
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.plausibility.features import follow, to_8_bit
from polemap.stereo.rig import Mounting

Floats = NDArray[np.float64]

_FEATURES = 500
_LEAST = 30
_ROW_PX = 2.0
_NEAREST_PX, _FARTHEST_PX = 200.0, 1.5
_REPROJECTION_PX = 1.0
_STEP_MAX_S = 0.6
# straight and rolling: in bends the rear axle slips
_MOVED_MIN_M, _BEND_MAX = 0.1, 0.03
_BLOCK_S = 3.0
_YAW_FLOOR_RAD = 0.0007


@dataclass(frozen=True, slots=True)
class CameraSteps:
    """Motion of the left camera between pairs of frames, in the camera's axes at the first.

    Attributes:
        from_s, to_s: stamps `(n,)`.
        moved_m: `(n, 3)` displacement.
        turned: `(n, 3, 3)` first from second camera axes.
    """

    from_s: Floats
    to_s: Floats
    moved_m: Floats
    turned: Floats

    def __len__(self) -> int:
        return len(self.from_s)

    @classmethod
    def joined(cls, parts: Sequence[CameraSteps]) -> CameraSteps:
        """The steps of all parts, in their order."""
        return cls(
            np.concatenate([part.from_s for part in parts]),
            np.concatenate([part.to_s for part in parts]),
            np.concatenate([part.moved_m for part in parts]),
            np.concatenate([part.turned for part in parts]),
        )

    def in_vehicle(self, mount: Mounting) -> tuple[Floats, Floats]:
        """Displacements `(n, 3)` in vehicle axes, and turns `(n,)` about the vertical, radians."""
        r = mount.rotation()
        turned = r @ self.turned @ r.T
        return self.moved_m @ r.T, np.arctan2(turned[:, 1, 0], turned[:, 0, 0])


def camera_steps(drive: Drive, runs: Sequence[range]) -> CameraSteps:
    """Steps between neighbouring frames of every run of rows; those that fail are left out.

    Raises:
        InputError: no camera, or a picture that cannot be read.
    """
    if drive.rig is None:
        raise InputError(f"drive {drive.name}: it has no camera to calibrate")
    found: list[tuple[float, float, Floats, Floats]] = []
    for run in runs:
        before = None
        for row in run:
            frame = drive.read_frame(row)
            left, right = to_8_bit(frame.left), to_8_bit(frame.right)
            if before is not None and frame.stamp_s - before[0] < _STEP_MAX_S:
                step = _step(drive, before[1], before[2], left)
                if step is not None:
                    found.append((before[0], frame.stamp_s, *step))
            before = frame.stamp_s, left, right
    return CameraSteps(
        np.array([step[0] for step in found]),
        np.array([step[1] for step in found]),
        np.array([step[2] for step in found]).reshape(-1, 3),
        np.array([step[3] for step in found]).reshape(-1, 3, 3),
    )


def _step(drive: Drive, left: Any, right: Any, after: Any) -> tuple[Floats, Floats] | None:
    rig = drive.rig
    corners = cv2.goodFeaturesToTrack(left, _FEATURES, 0.003, 9)
    if rig is None or corners is None:
        return None
    places, across = follow(left, right, np.asarray(corners, dtype=np.float32))
    disparity = -across[:, 0]
    good = (np.abs(across[:, 1]) < _ROW_PX) & (disparity > _FARTHEST_PX)
    good &= disparity < _NEAREST_PX
    places, disparity = places[good], disparity[good]
    start = places.astype(np.float32).reshape(-1, 1, 2)
    if len(start) < _LEAST:
        return None
    kept, steps = follow(left, after, start)
    # `follow` keeps some of the places, in their order
    index = {tuple(place): k for k, place in enumerate(start.reshape(-1, 2).astype(np.float64))}
    rows = np.array([index[tuple(place)] for place in kept], dtype=np.int64)
    if len(rows) < _LEAST:
        return None
    points = rig.camera_points(kept[:, 0], kept[:, 1], disparity[rows])
    matrix = np.array([[rig.focal_px, 0, rig.cx_px], [0, rig.focal_px, rig.cy_px], [0, 0, 1.0]])
    cv2.setRNGSeed(0)
    done, turn, move, inliers = cv2.solvePnPRansac(
        points, kept + steps, matrix, None, iterationsCount=200,
        reprojectionError=_REPROJECTION_PX, confidence=0.999, flags=cv2.SOLVEPNP_EPNP,
    )  # fmt: skip
    if not done or inliers is None or len(inliers) < max(_LEAST, 0.3 * len(rows)):
        return None
    chosen = inliers.ravel()
    turn, move = cv2.solvePnPRefineLM(
        points[chosen], (kept + steps)[chosen], matrix, None, turn, move
    )
    rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
    return -rotation.T @ np.asarray(move, dtype=np.float64).ravel(), rotation.T


@dataclass(frozen=True, slots=True)
class Heading:
    """Where the car moves to, as its camera sees it.

    Attributes:
        yaw_rad, yaw_sd_rad: of the camera to the left of the way the rear axle moves.
        pitch_rad, pitch_sd_rad: of the camera below the way it moves.
        steps: how many straight ones gave them.
    """

    yaw_rad: float
    yaw_sd_rad: float
    pitch_rad: float
    pitch_sd_rad: float
    steps: int


def heading(steps: CameraSteps, mount: Mounting) -> Heading | None:
    """Mounting yaw and pitch from straight driving; None with fewer than ten such steps.

    Over an arc the axle moves along the mean heading, turn / 2 from the first one, and a camera
    `x_m` ahead of it sideways by x_m times the turn.
    """
    moved, turn = steps.in_vehicle(mount)
    way = np.hypot(moved[:, 0], moved[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        bend = np.where(way > 0.0, np.abs(turn) / way, np.inf)
    straight = (moved[:, 0] > _MOVED_MIN_M) & (bend < _BEND_MAX)
    if straight.sum() < 10:
        return None
    moved, turn, way = moved[straight], turn[straight], way[straight]
    block = blocks_of(steps.from_s[straight], _BLOCK_S)
    seen = np.arctan2(moved[:, 1], moved[:, 0])
    expected = turn / 2.0 + mount.x_m * turn / way
    # a slipping axle and a wrong x_m both go with the bend
    aside: Fit = fit(np.column_stack([np.ones(len(turn)), turn / way]), seen - expected, block)
    below = fit(np.ones((len(turn), 1)), moved[:, 2] / way, block)
    return Heading(
        mount.yaw_rad - float(aside.values[0]),
        float(np.hypot(aside.sd[0], _YAW_FLOOR_RAD)),
        mount.pitch_rad + float(below.values[0]),
        float(np.hypot(below.sd[0], _YAW_FLOOR_RAD)),
        int(straight.sum()),
    )
