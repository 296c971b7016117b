"""Height, pitch and roll of the camera from the disparities of the road ahead.

A plane n . P = h below the camera has disparity d = (f b / h) (n_x x + n_y y + n_z) with x and y
the image place in units of the focal length: linear, so that a plane of disparities gives both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.calibration.estimate import blocks_of, fit, mean
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import make_matcher
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

# the road in front of the car, in the vehicle's axes as far as they are known
_NEAR_M, _FAR_M, _HALF_WIDTH_M = 4.0, 16.0, 1.6
_SAMPLES = 4000
_TRIALS = 200
_INLIER_PX = 1.0
_INLIERS_MIN = 0.6
_TURN_MAX_RAD = 0.35
_BLOCK_S = 2.0
_PUSH_RANGE_MPS2 = 0.5
# what more frames do not average out: camber of the road, disparities that are off by a tenth of a
# pixel, springs that are never quite where they were
HEIGHT_FLOOR, ANGLE_FLOOR_RAD = 0.006, 0.0015


@dataclass(frozen=True, slots=True)
class GroundPlane:
    """The road in one frame: unit normal `(3,)` in camera axes, pointing down, and the height."""

    normal: Floats
    height_m: float
    inliers: float


@dataclass(frozen=True, slots=True)
class GroundMounting:
    """Mounting of the left camera over the road, with standard deviations.

    Attributes:
        frames: in how many the road was found, of how many looked at.
    """

    height_m: float
    height_sd_m: float
    pitch_rad: float
    pitch_sd_rad: float
    roll_rad: float
    roll_sd_rad: float
    frames: tuple[int, int]


def angles_of(normal: Floats) -> tuple[float, float]:
    """Pitch (nose down) and roll of a camera whose axes see the ground at `normal` `(3,)`.

    The camera axes of the normal, written as x forward, y left, z up, are Rx(-roll) Ry(-pitch)
    (0, 0, -1) = (sin pitch, -sin roll cos pitch, -cos roll cos pitch).
    """
    ahead, left, up = normal[2], -normal[0], -normal[1]
    return float(np.arcsin(np.clip(ahead, -1.0, 1.0))), float(np.arctan2(-left, -up))


def road_plane(
    disparity: NDArray[np.float32], rig: StereoRig, rng: np.random.Generator
) -> GroundPlane | None:
    """The road's plane in a disparity map, None where no plane lies where a road should."""
    mount = rig.vehicle_from_camera
    turn: Floats = mount.rotation()
    down: Floats = -turn[2]
    scale = rig.focal_px * rig.baseline_m
    normal: Floats = down
    height_m, inliers = mount.z_m, 0.0
    # once where the stated mounting sees the road, and again where the found one does
    for _ in range(2):
        rays, values = _corridor(disparity, rig, normal, height_m)
        if len(values) < 300:
            return None
        pick = rng.permutation(len(values))[:_SAMPLES]
        rays, values = rays[pick], values[pick]
        found = _consensus(rays, values, scale, down, rng)
        if found is None:
            return None
        slope, inliers = found
        length = float(np.linalg.norm(slope))
        normal, height_m = slope / length, scale / length
    return GroundPlane(normal, height_m, inliers) if inliers >= _INLIERS_MIN else None


def on_road(
    disparity: NDArray[np.float32], rig: StereoRig, plane: GroundPlane
) -> NDArray[np.bool_]:
    """Which pixels `(height, width)` lie on the plane, as far as it was looked at."""
    v, u = np.indices(disparity.shape)
    x, y = (u - rig.cx_px) / rig.focal_px, (v - rig.cy_px) / rig.focal_px
    n = plane.normal
    expected = rig.focal_px * rig.baseline_m / plane.height_m * (n[0] * x + n[1] * y + n[2])
    least = rig.focal_px * rig.baseline_m / (2.0 * _FAR_M)
    with np.errstate(invalid="ignore"):
        near = np.abs(disparity - expected) < _INLIER_PX
    return np.asarray(near & (expected > least))


def _corridor(
    disparity: NDArray[np.float32], rig: StereoRig, normal: Floats, height_m: float
) -> tuple[Floats, Floats]:
    """Rays `(n, 3)` with z = 1 and disparities `(n,)` where the plane holds the car's way."""
    v, u = np.indices(disparity.shape)
    x: Floats = np.asarray((u - rig.cx_px) / rig.focal_px)
    y: Floats = np.asarray((v - rig.cy_px) / rig.focal_px)
    towards = normal[0] * x + normal[1] * y + normal[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(towards > 1e-3, height_m / towards, np.nan)
    mount = rig.vehicle_from_camera
    r: Floats = mount.rotation()
    ahead = depth * (r[0, 0] * x + r[0, 1] * y + r[0, 2])
    left = depth * (r[1, 0] * x + r[1, 1] * y + r[1, 2]) + mount.y_m
    inside = (ahead > _NEAR_M) & (ahead < _FAR_M) & (np.abs(left) < _HALF_WIDTH_M)
    inside &= np.isfinite(disparity)
    rays = np.stack([x[inside], y[inside], np.ones(int(inside.sum()))], axis=1)
    return rays, disparity[inside].astype(np.float64)


def _consensus(
    rays: Floats, values: Floats, scale: float, down: Floats, rng: np.random.Generator
) -> tuple[Floats, float] | None:
    """Slopes `(3,)` of the disparity and the share that agrees; None without a likely road."""
    best: Floats | None = None
    most = 0
    for _ in range(_TRIALS):
        three = rng.choice(len(values), 3, replace=False)
        try:
            trial: Floats = np.asarray(np.linalg.solve(rays[three], values[three]))
        except np.linalg.LinAlgError:
            continue
        length = float(np.linalg.norm(trial))
        if not length > 0.0 or trial @ down < np.cos(_TURN_MAX_RAD) * length:
            continue
        if not 0.2 < scale / length < 6.0:
            continue
        count = int(np.count_nonzero(np.abs(values - rays @ trial) < _INLIER_PX))
        if count > most:
            best, most = trial, count
    if best is None:
        return None
    slope: Floats = best
    for limit in (_INLIER_PX, 0.7 * _INLIER_PX, 0.7 * _INLIER_PX):
        near = np.abs(values - rays @ slope) < limit
        if near.sum() < 100:
            return None
        slope = np.asarray(np.linalg.lstsq(rays[near], values[near], rcond=None)[0])
    share = float(np.mean(np.abs(values - rays @ slope) < _INLIER_PX))
    return slope, share


def ground_planes(
    drive: Drive, rows: Sequence[int], config: StereoConfig, seed: int
) -> list[GroundPlane | None]:
    """The road's plane in the frames of these rows.

    Raises:
        InputError: no camera, or a picture that cannot be read.
    """
    if drive.rig is None:
        raise InputError(f"drive {drive.name}: it has no camera to calibrate")
    matcher = make_matcher(config, drive.rig)
    planes = []
    for row in rows:
        frame = drive.read_frame(row)
        disparity = matcher.match(frame.left, frame.right).left
        planes.append(road_plane(disparity, drive.rig, np.random.default_rng([seed, row])))
    return planes


def ground_mounting(
    stamps_s: Floats, planes: Sequence[GroundPlane | None], pushed_mps2: Floats | None = None
) -> GroundMounting | None:
    """Height, pitch and roll over all frames; None where fewer than five show a road.

    Args:
        stamps_s: of the frames `(n,)`.
        planes: the road in them.
        pushed_mps2: `(n, 2)` accelerations along and to the left, on which a sprung body pitches
            and rolls; None where they are not known.
    """
    seen = [k for k, plane in enumerate(planes) if plane is not None]
    found = [plane for plane in planes if plane is not None]
    if len(found) < 5:
        return None
    block = blocks_of(stamps_s[seen], _BLOCK_S)
    angles = np.array([angles_of(plane.normal) for plane in found])
    height, height_sd = mean(np.array([plane.height_m for plane in found]), block)
    pushed = np.zeros((len(found), 2)) if pushed_mps2 is None else pushed_mps2[seen]
    pitch, pitch_sd = _at_rest(angles[:, 0], pushed[:, 0], block)
    roll, roll_sd = _at_rest(angles[:, 1], pushed[:, 1], block)
    return GroundMounting(
        height,
        float(np.hypot(height_sd, HEIGHT_FLOOR * height)),
        pitch,
        float(np.hypot(pitch_sd, ANGLE_FLOOR_RAD)),
        roll,
        float(np.hypot(roll_sd, ANGLE_FLOOR_RAD)),
        (len(found), len(planes)),
    )


def _at_rest(angle: Floats, pushed_mps2: Floats, block: NDArray[np.int64]) -> tuple[float, float]:
    """Mean of an angle without acceleration, and its standard deviation."""
    if np.ptp(pushed_mps2) < _PUSH_RANGE_MPS2:
        return mean(angle, block)
    found = fit(np.column_stack([np.ones(len(angle)), pushed_mps2]), angle, block)
    return float(found.values[0]), float(found.sd[0])
