"""A comma2k19 segment (car bus, phone IMU, GNSS, post-processed reference) as a signal log.

Read are the folder's `accelerometer.csv, gyro.csv, wheel_speed.csv, steering.csv, gnss.csv,
reference.csv`. One row an IMU sample, about 104 Hz; docs/estimators.md tells what is done to each.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.electric.signals import SignalLog
from polemap.parsing.csv_text import check_csv
from polemap.parsing.errors import short
from polemap.vehicle.errors import VehicleError

Floats = NDArray[np.float64]

FILES = {
    "accelerometer": ("forward_mps2", "right_mps2", "down_mps2"),
    "gyro": ("forward_radps", "right_radps", "down_radps"),
    "wheel_speed": ("front_left_mps", "front_right_mps", "rear_left_mps", "rear_right_mps"),
    "steering": ("steering_wheel_deg",),
    "gnss": ("speed_mps", "bearing_deg", "utc_ms"),
    "reference": ("ecef_vx_mps", "ecef_vy_mps", "ecef_vz_mps", "qw", "qx", "qy", "qz"),
}
MOUNT_S, MOUNT_SPEED_MPS = 20.0, 5.0
"""The mount is read from the reference's first seconds above this speed; score what follows."""
LONGEST_DELAY_S = 0.5


@dataclass(frozen=True, slots=True)
class Segment:
    """A segment as a log, and what had to be found out about it.

    Attributes:
        log: inputs, GNSS and reference.
        mount_yaw_rad: of the phone in the car, left positive; mount_pitch_rad: nose down positive.
        mount_until_s: stamp up to which the reference served to find the mount.
        gnss_delay_s: from a fix's own time to its arrival, median.
    """

    log: SignalLog
    mount_yaw_rad: float
    mount_pitch_rad: float
    mount_until_s: float
    gnss_delay_s: float


def is_comma2k19(folder: Path) -> bool:
    """Whether a folder holds the files of a segment."""
    return folder.is_dir() and all((folder / f"{name}.csv").is_file() for name in FILES)


def read_comma2k19(folder: Path, steering_ratio: float) -> Segment:
    """The segment in axes of the car: x ahead, y left, yaw counter-clockwise.

    Args:
        folder: of the segment.
        steering_ratio: steering-wheel angle over road-wheel angle.

    Raises:
        InputError: a file or a column is missing, a cell is not a number, stamps do not grow, or
            the car stood still while the mount was to be found.
    """
    if not steering_ratio > 0.0:
        raise InputError(f"{folder}: the car file needs a steering_ratio to read a comma2k19 log")
    tables = {name: _read(folder / f"{name}.csv", names) for name, names in FILES.items()}
    stamps, force = tables["accelerometer"]
    reference_stamps, velocity = _in_camera(*tables["reference"])
    yaw, pitch, until = _mount(reference_stamps, velocity, folder)
    # camera axes are forward, right, down; undo the mount, then turn to forward, left, up
    to_car = scipy.spatial.transform.Rotation.from_euler("YZ", [pitch, yaw]).inv()
    flip = np.array([1.0, -1.0, -1.0])
    force = to_car.apply(force) * flip
    gyro = to_car.apply(_sampled(stamps, *tables["gyro"])) * flip
    wheels = _held(stamps, *tables["wheel_speed"])
    road_wheel = np.radians(_held(stamps, *tables["steering"])[:, 0]) / steering_ratio
    front = wheels[:, :2].mean(axis=1) * np.cos(road_wheel)
    columns = {
        "road_wheel_angle_rad": road_wheel,
        "yaw_rate_radps": gyro[:, 2],
        "ax_mps2": force[:, 0],
        "ay_mps2": force[:, 1],
        "vx_mps": 0.5 * (front + wheels[:, 2:].mean(axis=1)),
    }
    columns |= _reference(stamps, reference_stamps, to_car.apply(velocity) * flip)
    fixes, delay = _fixes(stamps, columns["vx_mps"], *tables["gnss"])
    try:
        log = SignalLog(stamps, columns | fixes)
    except VehicleError as error:
        raise InputError(f"{folder / 'accelerometer.csv'}: {error}") from error
    return Segment(log, yaw, pitch, until, delay)


def _read(path: Path, names: tuple[str, ...]) -> tuple[Floats, Floats]:
    """Stamps `(n,)` and the columns `(n, k)`."""
    import pandas as pd  # slow to import

    if not path.is_file():
        raise InputError(f"{path}: no such file; a comma2k19 segment has it")
    try:
        check_csv(path)
        table: Any = pd.read_csv(path)
    except Exception as error:  # pandas raises whatever it meets
        raise InputError(f"{path}: cannot be read as CSV ({short(error)})") from error
    for name in ("stamp_s", *names):
        if name not in table.columns:
            raise InputError(f"{path}: no column {name}")
    numbers = (
        table[["stamp_s", *names]]
        .apply(pd.to_numeric, errors="coerce")
        .to_numpy(np.float64, copy=True)
    )
    bad = np.argwhere(~np.isfinite(numbers))
    if len(bad):
        row, column = bad[0]
        raise InputError(f"{path}: row {row + 2}, {('stamp_s', *names)[column]}: not a number")
    late = np.flatnonzero(np.diff(numbers[:, 0]) <= 0.0)
    if len(late):
        raise InputError(f"{path}: stamp_s of row {late[0] + 3} does not follow the one before")
    if len(numbers) < 2:
        raise InputError(f"{path}: has {len(numbers)} rows, two at least are needed")
    return numbers[:, 0], numbers[:, 1:]


def _in_camera(stamps: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Velocity `(n, 3)` forward, right, down of the camera.

    The quaternion turns camera axes to ECEF as scipy applies it (the data set calls it the one
    from ECEF to the camera, counting the turn of the axes): only so the car goes forward.
    """
    turn = scipy.spatial.transform.Rotation.from_quat(values[:, [4, 5, 6, 3]])
    return stamps, np.asarray(turn.inv().apply(values[:, :3]))


def _mount(stamps: Floats, velocity: Floats, folder: Path) -> tuple[float, float, float]:
    """Yaw and pitch of the camera in the car: over a while a car goes where it points."""
    speed = np.linalg.norm(velocity, axis=1)
    early = (stamps < stamps[0] + MOUNT_S) & (speed > MOUNT_SPEED_MPS)
    if early.sum() < 50:
        raise InputError(
            f"{folder / 'reference.csv'}: the car moves too little in the first {MOUNT_S:.0f} s "
            "to tell how the camera is mounted; choose another segment"
        )
    ahead = np.median(velocity[early] / speed[early, None], axis=0)
    # the direction of travel lies right of the axis of a camera that looks left
    yaw = float(np.arctan2(ahead[1], np.hypot(ahead[0], ahead[2])))
    pitch = float(np.arctan2(-ahead[2], ahead[0]))
    return yaw, pitch, float(stamps[0] + MOUNT_S)


def _held(stamps: Floats, own: Floats, values: Floats) -> Floats:
    """The last value at or before each stamp, as a computer in the car would have it."""
    return np.asarray(values[np.maximum(np.searchsorted(own, stamps, side="right") - 1, 0)])


def _sampled(stamps: Floats, own: Floats, values: Floats) -> Floats:
    return np.column_stack([np.interp(stamps, own, column) for column in values.T])


def _reference(stamps: Floats, own: Floats, velocity: Floats) -> dict[str, Floats]:
    inside = (stamps >= own[0]) & (stamps <= own[-1])
    vx, vy = (
        np.where(inside, np.interp(stamps, own, velocity[:, axis]), np.nan) for axis in (0, 1)
    )
    return {"vx_reference_mps": vx, "vy_mps": vy, "sideslip_rad": np.arctan2(vy, vx)}


def _fixes(
    stamps: Floats, wheel: Floats, arrivals: Floats, values: Floats
) -> tuple[dict[str, Floats], float]:
    """GNSS course and speed at the rows of their fixes, with their arrivals.

    UTC gives the spacing of the fixes free of transport jitter. Its offset from the log's clock
    is the one at which GNSS speed and wheel speed agree best but for a scale: no reference in it.
    """
    speed, course = values[:, 0], np.unwrap(np.radians(90.0 - values[:, 1]))
    utc = values[:, 2] * 1e-3
    quickest = float((arrivals - utc).min())

    def disagreement(delay: float) -> float:
        then = np.interp(utc + quickest - delay, stamps, wheel)
        scale = float(then @ speed) / float(then @ then)
        return float(np.mean((speed - scale * then) ** 2))

    delays = np.arange(0.0, LONGEST_DELAY_S, 0.005)
    delay = float(delays[int(np.argmin([disagreement(d) for d in delays.tolist()]))])
    taken = utc + quickest - delay
    rows = np.clip(np.rint(np.interp(taken, stamps, np.arange(len(stamps)))), 0, len(stamps) - 1)
    rows = rows.astype(np.int64)
    keep = (taken >= stamps[0]) & (np.diff(rows, prepend=-1) > 0)
    columns = {}
    for name, what in (
        ("course_rad", course),
        ("speed_mps", speed),
        ("gnss_arrival_s", arrivals),
    ):
        columns[name] = np.full(len(stamps), np.nan)
        columns[name][rows[keep]] = what[keep]
    return columns, float(np.median(arrivals - taken))
