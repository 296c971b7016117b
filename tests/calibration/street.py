"""A stereo camera over a flat, textured street: pictures, motion and odometry with known truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.streams import OdometryStream, ReferenceStream
from polemap.drivelog.writers.folder import folder_writer
from polemap.stereo.rig import Mounting, StereoRig, rotation_from_angles

SIZE = (480, 200)
TRUE = Mounting(1.2, 0.1, 1.4, roll_rad=0.012, pitch_rad=0.05, yaw_rad=-0.015)
SCALE, DELAY_S = 1.03, 0.1
_CELL_M = 0.04
_WALL_M = 7.0


def rig(mount: Mounting = TRUE) -> StereoRig:
    return StereoRig(*SIZE, 420.0, 239.5, 80.0, 0.4, mount)


def texture() -> np.ndarray:
    """Grey street of 120 m by 24 m."""
    rng = np.random.default_rng(5)
    shape = (int(24 / _CELL_M), int(120 / _CELL_M))
    fine = cv2.GaussianBlur(rng.standard_normal(shape).astype(np.float32), (0, 0), 1.5)
    coarse = cv2.GaussianBlur(rng.standard_normal(shape).astype(np.float32), (0, 0), 6.0)
    mixed = fine / fine.std() + 1.5 * coarse / coarse.std()
    return np.clip(120 + 28 * mixed, 0, 255).astype(np.uint8)


def view(pattern: np.ndarray, camera: StereoRig, pose: np.ndarray, right: bool) -> np.ndarray:
    """What one camera sees of the street and the walls beside it from the rear-axle pose `(3,)`."""
    mount = camera.vehicle_from_camera
    turn = mount.rotation()
    v, u = np.indices((SIZE[1], SIZE[0]))
    x, y = (u - camera.cx_px) / camera.focal_px, (v - camera.cy_px) / camera.focal_px
    heading = rotation_from_angles(pose[2], 0.0, 0.0)
    rays = np.stack([x, y, np.ones(u.shape)], axis=-1) @ (heading @ turn).T
    place = np.array([mount.x_m, mount.y_m, mount.z_m])
    if right:
        place = place + turn @ np.array([camera.baseline_m, 0.0, 0.0])
    place = heading @ place + np.array([pose[0], pose[1], 0.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = np.where(rays[..., 2] < -0.02, -place[2] / rays[..., 2], np.inf)
        side = np.sign(rays[..., 1]) * _WALL_M
        wall = np.where(np.abs(rays[..., 1]) > 0.02, (side - place[1]) / rays[..., 1], np.inf)
    points = place + np.minimum(ground, wall)[..., None] * rays
    # walls show another part of the pattern, by their height
    across = np.where(ground < wall, points[..., 1] + 12.0, 23.0 - 2.0 * points[..., 2])
    seen = cv2.remap(
        pattern, (points[..., 0] / _CELL_M).astype(np.float32),
        (across / _CELL_M).astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=200,
    )  # fmt: skip
    return np.where(np.isfinite(np.minimum(ground, wall)), seen, 200).astype(np.uint8)


def motion(stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rear-axle poses `(n, 3)`, speeds and turn rates: a car that brakes, speeds up and weaves."""
    fine = np.arange(0.0, stamps.max() + 1.0, 0.001)
    speed = 5.0 + 1.5 * np.sin(1.1 * fine)
    rate = np.where(fine > 1.2, 0.12 * np.sin(2.0 * (fine - 1.2)), 0.0)
    yaw = np.cumsum(rate) * 0.001
    x, y = np.cumsum(speed * np.cos(yaw)) * 0.001, np.cumsum(speed * np.sin(yaw)) * 0.001
    poses = np.column_stack([np.interp(stamps, fine, column) for column in (x, y, yaw)])
    return poses, np.interp(stamps, fine, speed), np.interp(stamps, fine, rate)


def write_street(
    path: Path, *, stated: Mounting, frames: int = 40, reference: bool = True,
    lower_px: float = 0.0, baseline: float = 1.0,
) -> Path:  # fmt: skip
    """A drive whose odometry is late and says too much, and whose drive.yaml states `stated`, and a
    baseline that is `baseline` times the true one."""
    ground = texture()
    stamps = 0.1 * np.arange(frames)
    poses, _, _ = motion(stamps)
    with folder_writer(
        path, name="street", frame=EarthFrame("local", name="street"), wheelbase_m=2.7,
        rig=replace(rig(stated), baseline_m=0.4 * baseline),
    ) as writer:  # fmt: skip
        for stamp, pose in zip(stamps, poses, strict=True):
            pair = [view(ground, rig(), pose, right) for right in (False, True)]
            if lower_px:
                move = np.array([[1.0, 0, 0], [0, 1.0, lower_px]])
                pair[1] = cv2.warpAffine(pair[1], move, SIZE, borderMode=cv2.BORDER_REPLICATE)
            writer.frame(float(stamp), float(stamp), pair[0], pair[1])
        at = np.arange(0.0, stamps[-1], 0.02)
        _, speed, rate = motion(at)
        writer.odometry(OdometryStream(at + DELAY_S, at + DELAY_S, SCALE * speed, rate))
        if reference:
            writer.reference(ReferenceStream(stamps, poses, np.full(frames, 0.02)))
    return path
