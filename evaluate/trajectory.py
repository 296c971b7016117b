"""Trajectories as the report sees them: stamps and planar poses, read from TUM files."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

TUM_COLUMNS = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses over time in one plane; `stamp_s` `(n,)` rises strictly.

    Attributes:
        stamp_s: `(n,)` seconds.
        poses: `(n, 3)` east, north in metres and yaw in radians, rear axle.
    """

    stamp_s: Floats
    poses: Floats

    def __len__(self) -> int:
        return len(self.stamp_s)

    def between(self, start_s: float, end_s: float) -> Trajectory:
        """The part with `start_s <= stamp <= end_s`."""
        first = int(np.searchsorted(self.stamp_s, start_s, side="left"))
        last = int(np.searchsorted(self.stamp_s, end_s, side="right"))
        return Trajectory(self.stamp_s[first:last], self.poses[first:last])

    def at(self, stamps_s: Floats, max_gap_s: float = 1.0) -> Floats:
        """Interpolated poses `(m, 3)`; NaN outside and in gaps longer than `max_gap_s`."""
        stamps = np.asarray(stamps_s, dtype=np.float64)
        result = np.full((len(stamps), 3), np.nan)
        if len(self) < 2:
            return result
        after = np.clip(np.searchsorted(self.stamp_s, stamps), 1, len(self) - 1)
        before = after - 1
        gap = self.stamp_s[after] - self.stamp_s[before]
        share = (stamps - self.stamp_s[before]) / gap
        good = (share >= 0.0) & (share <= 1.0) & (gap <= max_gap_s)
        low, high = self.poses[before], self.poses[after]
        turned = wrap_angle(high[:, 2] - low[:, 2])
        result[:, :2] = low[:, :2] + share[:, None] * (high[:, :2] - low[:, :2])
        result[:, 2] = wrap_angle(low[:, 2] + share * turned)
        result[~good] = np.nan
        return result

    def thinned(self, spacing_m: float) -> Trajectory:
        """Every pose that lies at least `spacing_m` of travel behind the one kept before it.

        Standstill collapses to one pose and a 100 Hz stream to what a picture can show.
        """
        if len(self) < 2:
            return self
        travelled = self.travelled_m()
        ticks = np.floor(travelled / spacing_m)
        keep = np.concatenate([[True], np.diff(ticks) > 0])
        return Trajectory(self.stamp_s[keep], self.poses[keep])

    def travelled_m(self) -> Floats:
        """Distance along the polyline up to every pose, `(n,)`."""
        steps = np.hypot(*np.diff(self.poses[:, :2], axis=0).T)
        return np.concatenate([[0.0], np.cumsum(steps)])


def read_tum(path: Path) -> Trajectory:
    """Read `stamp x y z qx qy qz qw`, one pose a line, `#` starts a comment.

    Lines that repeat a stamp or go back in time are dropped: other systems publish such.

    Raises:
        InputError: the file is missing, has no pose, a line has not eight numbers, or a value is
            not finite.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            table = np.loadtxt(path, dtype=np.float64, comments="#", ndmin=2)
    except FileNotFoundError:
        raise InputError(f"{path}: no such trajectory") from None
    except (ValueError, OSError, UnicodeDecodeError):
        raise InputError(_broken_line(path)) from None
    if table.size == 0:
        raise InputError(f"{path}: holds no pose; a TUM line is '{' '.join(TUM_COLUMNS)}'")
    if table.shape[1] != len(TUM_COLUMNS):
        raise InputError(_broken_line(path))
    bad = np.argwhere(~np.isfinite(table))
    if len(bad):
        row, column = bad[0]
        raise InputError(
            f"{path}: pose {row + 1} has {TUM_COLUMNS[column]} = {table[row, column]}; "
            "every value of a TUM trajectory must be finite"
        )
    stamp = table[:, 0]
    rising = stamp > np.concatenate([[-np.inf], np.maximum.accumulate(stamp)[:-1]])
    table = table[rising]
    qx, qy, qz, qw = table[:, 4:8].T
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    poses = np.column_stack([table[:, 1], table[:, 2], wrap_angle(yaw)])
    return Trajectory(np.ascontiguousarray(table[:, 0]), poses)


def tum_text(trajectory: Trajectory) -> str:
    """The trajectory as TUM lines, full precision, height zero."""
    half = trajectory.poses[:, 2] / 2.0
    lines = [
        f"{stamp:.9f} {x!r} {y!r} 0 0 0 {qz!r} {qw!r}\n"
        for stamp, x, y, qz, qw in zip(
            trajectory.stamp_s.tolist(),
            trajectory.poses[:, 0].tolist(),
            trajectory.poses[:, 1].tolist(),
            np.sin(half).tolist(),
            np.cos(half).tolist(),
            strict=True,
        )
    ]
    return "".join(lines)


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
