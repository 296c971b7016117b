"""What is true: the poles as a map, every standing object, the motion."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.io import write_map
from polemap.map.pole_map import PoleMap
from polemap.simulate.driver import Motion
from polemap.simulate.dynamics import CAR
from polemap.simulate.lane_truth import COLUMNS, lane_truth
from polemap.simulate.traffic import MOVER_ID
from polemap.simulate.world import World
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]
TRUTH_FILES = (
    *("objects.geojson", "standing.csv", "corners.csv", "truth.csv", "signals.csv"),
    "lane_truth.csv",
)
TRUTH_PICTURES = ("disparity_left", "disparity_right", "objects")
# the truth has no spread; a map needs one that can be inverted
_TRUTH_SD_M = 0.001
_EVERY = 4
# a car's inertial sensors deliver at 100 Hz
_SIGNAL_EVERY = 2


def true_map(world: World, frame: EarthFrame, origin_m: Floats) -> PoleMap:
    """The poles of a world as a pole map in the drive's frame."""
    poles = world.poles()
    count = len(poles)
    points = np.array([[p.x_m, p.y_m] for p in poles]).reshape(-1, 2) + origin_m
    return PoleMap(
        frame=frame,
        ids=np.array([p.owner for p in poles], dtype=np.int64),
        points_m=points,
        covariance_m2=np.broadcast_to(np.eye(2) * _TRUTH_SD_M**2, (count, 2, 2)).copy(),
        width_m=np.array([p.width_m for p in poles]),
        height_m=np.array([p.height_m for p in poles]),
        observations=np.ones(count, dtype=np.int64),
        drives=np.ones(count, dtype=np.int64),
        existence=np.ones(count),
    )


def write_truth(
    folder: Path, frame: EarthFrame, world: World, motion: Motion, origin_m: Floats
) -> None:
    """Writes the poles as a map, tables of all objects and of all corners, and the motion."""
    write_map(true_map(world, frame, origin_m), folder / "objects.geojson")
    lines = ["id,kind,pole,east_m,north_m,width_m,height_m"]
    for o in world.objects:
        east, north = o.x_m + origin_m[0], o.y_m + origin_m[1]
        lines.append(
            f"{o.owner},{o.kind},{int(o.pole)},{east:.4f},{north:.4f},{o.width_m:.3f},{o.height_m:.3f}"
        )
    (folder / "standing.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    lines = ["object,kind,east_m,north_m,facing_rad,height_m"]
    for c in world.corners:
        place = f"{c.x_m + origin_m[0]:.4f},{c.y_m + origin_m[1]:.4f}"
        lines.append(f"{c.owner},{c.kind},{place},{c.facing_rad:.4f},{c.height_m:.3f}")
    (folder / "corners.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    rows = slice(None, None, _EVERY)
    pose = motion.pose[rows].copy()
    pose[:, :2] += origin_m
    table = np.column_stack(
        [
            motion.stamp_s[rows],
            pose[:, :2],
            wrap_angle(pose[:, 2]),
            motion.speed_mps[rows],
            motion.yaw_rate_radps[rows],
            motion.station_m[rows],
            motion.lateral_m[rows],
            motion.wander_m[rows],
        ]
    )
    write_signals(folder, motion)
    header = "stamp_s,east_m,north_m,yaw_rad,speed_mps,yaw_rate_radps,station_m,lateral_m,wander_m"
    np.savetxt(folder / "truth.csv", table, fmt="%.6f", delimiter=",", header=header, comments="")


def write_signals(folder: Path, motion: Motion) -> None:
    """Writes signals.csv: steering, accelerations, true side-slip; `polemap estimate` reads it."""
    rows = slice(None, None, _SIGNAL_EVERY)
    turning = motion.yaw_rate_radps + np.gradient(motion.sideslip_rad, motion.stamp_s)
    swing = motion.speed_mps * turning
    table = np.column_stack(
        [
            motion.stamp_s, motion.steering_rad, motion.yaw_rate_radps, motion.acceleration_mps2,
            swing, motion.speed_mps, motion.sideslip_rad,
        ]
    )[rows]  # fmt: skip
    header = "stamp_s,road_wheel_angle_rad,yaw_rate_radps,ax_mps2,ay_mps2,vx_mps,sideslip_rad"
    np.savetxt(folder / "signals.csv", table, fmt="%.7f", delimiter=",", header=header, comments="")


def write_lane_truth(folder: Path, world: World, motion: Motion, stamps_s: Floats) -> None:
    """Writes lane_truth.csv at the pictures' stamps, of the preview point of the drive's car."""
    preview = CAR.cg_to_rear_m + CAR.preview_m
    rows = lane_truth(world.route, world.scenario.section, motion, stamps_s, preview)
    header = ",".join(COLUMNS)
    lines = [",".join("" if v != v else f"{v:.6f}" for v in row) for row in rows.tolist()]
    (folder / "lane_truth.csv").write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")


def to_disparity_png(disparity_px: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Disparity x 256, 0 where there is none: the KITTI convention."""
    scaled = np.nan_to_num(disparity_px, posinf=0.0) * np.float32(256)
    return np.asarray(np.clip(np.rint(scaled), 0, 65535), dtype=np.uint16)


def to_owner_png(owner: NDArray[np.int32]) -> NDArray[np.uint16]:
    """Object ids of standing.csv; 0 ground and houses, from 60000 movers, 65535 sky."""
    moved = np.where(owner >= MOVER_ID, owner - MOVER_ID + 60_000, owner)
    return np.asarray(np.where(moved < 0, 65535, moved), dtype=np.uint16)


def write_truth_pictures(
    folder: Path, number: int, left: NDArray[np.uint16], right: NDArray[np.uint16],
    owner: NDArray[np.uint16],
) -> None:  # fmt: skip
    """Writes truth/disparity_left, truth/disparity_right and truth/objects beside a frame."""
    for name, image in zip(TRUTH_PICTURES, (left, right, owner), strict=True):
        target = folder / "truth" / name
        target.mkdir(parents=True, exist_ok=True)
        done, data = cv2.imencode(".png", image)
        if not done:
            raise InputError(f"{target}: picture {number} cannot be encoded")
        (target / f"{number:06d}.png").write_bytes(data.tobytes())


def carry_truth(sound: Path, broken: Path, numbers: NDArray[np.int64]) -> None:
    """Copies the truth of a drive to its faulty copy, whose picture k was `numbers[k]` there."""
    for name in TRUTH_FILES:
        if (sound / name).exists():
            shutil.copy(sound / name, broken / name)
    for name in TRUTH_PICTURES if (sound / "truth").exists() else ():
        (broken / "truth" / name).mkdir(parents=True)
        for row, number in enumerate(numbers):
            place = Path("truth") / name
            shutil.copy(sound / place / f"{number:06d}.png", broken / place / f"{row:06d}.png")
