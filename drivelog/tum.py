"""Trajectories as text in the TUM format: `stamp x y z qx qy qz qw`, one pose a line."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.errors import InputError
from polemap.parsing.errors import named
from polemap.parsing.text import MEGABYTE, check_size
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

TUM_COLUMNS = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")
LARGEST_BYTES = 20_000 * MEGABYTE
# stamps may be nanoseconds; metres go once round the earth; quaternions are normalised by use
_LARGEST = np.array([1e20, 1e9, 1e9, 1e9, 1e3, 1e3, 1e3, 1e3])

# a quaternion farther from length one than rounding makes it is no rotation
_UNIT_TOLERANCE = 0.1


def read_tum(path: Path, *, allow_empty: bool = False) -> Trajectory:
    """Read planar poses; `#` starts a comment.

    Lines that repeat a stamp or go back in time are dropped: other systems publish such.

    Args:
        allow_empty: accept a file without poses.

    Raises:
        InputError: the file is missing, has no pose, a line has not eight numbers, or a value is
            not finite, or a quaternion is none of length one.
    """
    if not os.path.isfile(path):
        raise InputError(f"{path}: no such trajectory")
    with named(path, InputError, "trajectory"):
        check_size(path, LARGEST_BYTES)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            table = np.loadtxt(path, dtype=np.float64, comments="#", ndmin=2)
    except (ValueError, OverflowError, OSError, UnicodeDecodeError):
        raise InputError(_broken_line(path)) from None
    if table.size == 0:
        if allow_empty:
            return Trajectory(np.empty(0), np.empty((0, 3)))
        raise InputError(f"{path}: holds no pose; a TUM line is '{' '.join(TUM_COLUMNS)}'")
    if table.shape[1] != len(TUM_COLUMNS):
        raise InputError(_broken_line(path))
    # False for NaN as well
    bad = np.argwhere(~(np.abs(table) <= _LARGEST))
    if len(bad):
        row, column = bad[0]
        raise InputError(
            f"{path}: pose {row + 1} has {TUM_COLUMNS[column]} = {table[row, column]:g}; every "
            f"value of a TUM trajectory must be finite and at most {_LARGEST[column]:g}"
        )
    norm = np.sqrt(np.sum(table[:, 4:8] ** 2, axis=1))
    wrong = np.flatnonzero(np.abs(norm - 1.0) > _UNIT_TOLERANCE)
    if len(wrong):
        raise InputError(
            f"{path}: pose {wrong[0] + 1} has a quaternion of length {norm[wrong[0]]:.3g}: "
            "no orientation; write unit quaternions (0 0 0 1 is yaw 0)"
        )
    stamp = table[:, 0]
    rising = stamp > np.concatenate([[-np.inf], np.maximum.accumulate(stamp)[:-1]])
    table = table[rising]
    qx, qy, qz, qw = table[:, 4:8].T
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    poses = np.column_stack([table[:, 1], table[:, 2], wrap_angle(yaw)])
    return Trajectory(np.ascontiguousarray(table[:, 0]), poses)


def tum_text(trajectory: Trajectory) -> str:
    """The trajectory as TUM lines in full precision; z, qx and qy are 0 in the plane."""
    half = 0.5 * trajectory.poses[:, 2]
    table = np.zeros((len(half), len(TUM_COLUMNS)))
    table[:, 0] = trajectory.stamp_s
    table[:, 1:3] = trajectory.poses[:, :2]
    table[:, 6], table[:, 7] = np.sin(half), np.cos(half)
    return "".join(" ".join(map(shortest, row)) + "\n" for row in table.tolist())


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write the trajectory in full precision."""
    with atomic_file(path) as part:
        part.write_text(tum_text(trajectory), encoding="utf-8")


def spatial_tum_text(stamps_s: Floats, poses: Floats) -> str:
    """Rigid poses `(n, 4, 4)` as TUM lines in full precision."""
    quaternions = scipy.spatial.transform.Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    table = np.column_stack([stamps_s, poses[:, :3, 3], quaternions])
    return "".join(" ".join(map(shortest, row)) + "\n" for row in table.tolist())


def shortest(value: float) -> str:
    """The shortest text that reads back to the same double."""
    return repr(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


def _broken_line(path: Path) -> str:
    """Name the first line that is not a pose."""
    wanted = f"expected eight numbers '{' '.join(TUM_COLUMNS)}'"
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        return f"{path}: is not a text file; {wanted} a line"
    except OSError as error:
        return f"{path}: cannot be read ({error.strerror}); is it a TUM trajectory?"
    for number, line in enumerate(lines, start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            return f"{path}:{number}: '{line[:60]}' is not a TUM pose; {wanted}"
        if len(values) != len(TUM_COLUMNS):
            return f"{path}:{number}: {len(values)} numbers; {wanted}"
    return f"{path}: cannot be read as a TUM trajectory; {wanted} a line"
