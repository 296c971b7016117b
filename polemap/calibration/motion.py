"""How the camera of a drive moves, step by step, and which way it looks along that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.calibration.estimate import Fit, blocks_of, fit
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.stereo.odometry.camera_odometry import CameraOdometry
from polemap.stereo.rig import Mounting

Floats = NDArray[np.float64]

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
    """Known steps between neighbouring frames of every run of rows, by camera odometry.

    Raises:
        InputError: no camera, or a picture that cannot be read.
    """
    if drive.rig is None:
        raise InputError(f"drive {drive.name}: it has no camera to calibrate")
    spans: list[tuple[float, float]] = []
    steps: list[Floats] = []
    for run in runs:
        odometry = CameraOdometry(drive.rig)
        before_s = float("-inf")
        for row in run:
            frame = drive.read_frame(row)
            motion = odometry.advance(frame.stamp_s, frame.left, frame.right)
            if motion.known and frame.stamp_s - before_s < _STEP_MAX_S:
                spans.append((before_s, frame.stamp_s))
                steps.append(np.asarray(np.linalg.inv(motion.current_from_previous), np.float64))
            before_s = frame.stamp_s
    stamps = np.array(spans).reshape(-1, 2)
    previous_from_current = np.array(steps).reshape(-1, 4, 4)
    return CameraSteps(
        stamps[:, 0],
        stamps[:, 1],
        previous_from_current[:, :3, 3],
        previous_from_current[:, :3, :3],
    )


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
