"""Streams that end early, or jump: a part of a recording that is not what it says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.jitter import jitter_m
from polemap.drivelog.streams import ReferenceStream
from polemap.vehicle.pose import rotate

Floats = NDArray[np.float64]

# a step beyond the usual one of its neighbours by more than a car can brake or gain, and this
_JUMP_M, _JUMP_SDS, _ACCELERATION_MPS2, _NEIGHBOURS = 1.0, 8.0, 12.0, 5
# steps over a longer time are holes, not jumps
_STEP_MAX_S = 2.0
# what lies so far from the median is no place of the drive, but a default or another zone
_ELSEWHERE_M, _ELSEWHERE_SHARE = 100e3, 0.3
_MISSING_S, _MISSING_SHARE = 2.0, 0.1
_SLOW_TICKS = ((60.0, "minutes"), (3600.0, "hours"), (1e3, "thousands of seconds"))
# poses are not interpolated over longer than this
_POSE_STEP_MAX_S, _SPARSE_SHARE, _SPARSE_FROM_S = 1.0, 0.5, 10.0
# the middle of a quarter of the fixes: their slow errors are some metres
_DRIFT_M, _DRIFT_SDS, _QUARTER_MIN = 10.0, 4.0, 8


@dataclass(frozen=True, slots=True)
class _Jumps:
    """Rows before a jump `(n,)` and its lengths."""

    rows: NDArray[np.int64]
    size_m: Floats


def jump_findings(drive: Drive) -> list[Finding]:
    """A reference that goes from one place to another as no car does."""
    reference = drive.reference
    if reference is None or len(reference) < 2 * _NEIGHBOURS:
        return []
    jumps = _jumps(reference)
    if not len(jumps.rows):
        return []
    largest = int(np.argmax(jumps.size_m))
    size, stamp = jumps.size_m[largest], reference.stamp_s[jumps.rows[largest]]
    median = np.median(reference.poses[:, :2], axis=0)
    away = int((np.hypot(*(reference.poses[:, :2] - median).T) > _ELSEWHERE_M).sum())
    many = f"{len(jumps.rows)} times" if len(jumps.rows) > 1 else "once"
    value = f"its position jumps {many}, by up to {_length(size)} after {stamp:.3f} s"
    if away:
        value += f"; {away} of {len(reference)} rows lie over 100 km from the others"
    return [
        Finding(
            "reference_jump", "error" if away else "warning", drive.names.reference, value,
            "a path that a car can drive",
            "leave these rows out" if away
            else "leave out what is wrong there, or cut the recording at the jump",
        )
    ]  # fmt: skip


def _jumps(reference: ReferenceStream) -> _Jumps:
    duration = np.diff(reference.stamp_s)
    length = np.hypot(*np.diff(reference.poses[:, :2], axis=0).T)
    speed = length / np.maximum(duration, 1e-6)
    # the median speed of the steps before and after, this one among them
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(speed, _NEIGHBOURS // 2, mode="edge"), _NEIGHBOURS
    )
    usual = np.median(around, axis=1)
    span = duration * _NEIGHBOURS
    beyond = length - usual * duration - _ACCELERATION_MPS2 * span * duration
    least = max(_JUMP_M, _JUMP_SDS * jitter_m(reference))
    rows = np.flatnonzero((beyond > least) & (duration < _STEP_MAX_S))
    return _Jumps(rows, length[rows])


def _length(metres: float) -> str:
    return f"{metres / 1000.0:.0f} km" if metres > 10_000.0 else f"{metres:.1f} m"


def sparse_findings(drive: Drive) -> list[Finding]:
    """A reference with so few poses that nothing is known between them."""
    reference = drive.reference
    if reference is None or len(reference) < 3:
        return []
    step = np.diff(reference.stamp_s)
    usual = step[step < 60.0]
    if usual.sum() < _SPARSE_FROM_S:
        return []
    long = usual > _POSE_STEP_MAX_S
    if usual[long].sum() < _SPARSE_SHARE * usual.sum():
        return []
    return [
        Finding(
            "reference_sparse", "warning", drive.names.reference,
            f"a pose every {np.median(usual):.1f} s in the median",
            f"a pose every {_POSE_STEP_MAX_S:g} s or more often: over longer nothing is "
            "interpolated",
            "write more poses, or map with --slam",
        )
    ]  # fmt: skip


def drift_findings(drive: Drive) -> list[Finding]:
    """A reference that leaves the fixes as the drive goes on, such as one that was summed up."""
    gnss, reference = drive.gnss, drive.reference
    if gnss is None or reference is None or not len(reference):
        return []
    poses = reference.at(gnss.stamp_s, max_gap_s=5.0)
    fixes = np.stack([gnss.east_m, gnss.north_m], axis=1)
    off = fixes - poses[:, :2] - rotate(drive.gnss_antenna_m, poses[:, 2])
    off = off[np.isfinite(off).all(axis=1)]
    quarter = len(off) // 4
    if quarter < _QUARTER_MIN:
        return []
    middles = np.array([np.median(part, axis=0) for part in np.array_split(off, 4)])
    way = middles[-1] - middles[0]
    size = float(np.hypot(*way))
    spread = 1.4826 * float(np.median(np.abs(np.array_split(off, 4)[0] - middles[0])))
    # step by step in the same direction: a receiver that was wrong for a while comes back
    steps = np.diff(middles, axis=0) @ (way / max(size, 1e-9))
    if size < max(_DRIFT_M, _DRIFT_SDS * spread) or steps.min() < 0.1 * size:
        return []
    return [
        Finding(
            "reference_drift", "warning", drive.names.reference,
            f"the fixes leave it by {size:.0f} m from the first to the last quarter of the drive",
            f"below {_DRIFT_M:g} m", "correct its drift, or map with --slam",
        )
    ]  # fmt: skip


def coverage_findings(drive: Drive, stamps: dict[str, Floats]) -> list[Finding]:
    """An odometry that begins late or ends early: nothing tells the motion there.

    Args:
        drive: its name of the odometry counts.
        stamps: of all its streams, by name.
    """
    own = stamps.get(drive.names.odometry)
    others = [s for name, s in stamps.items() if name != drive.names.odometry and len(s) > 1]
    if own is None or len(own) < 3 or not others:
        return []
    # the middle one: a lone stream on another clock is told as such
    begin = float(np.median([s[0] for s in others]))
    end = float(np.median([s[-1] for s in others]))
    before, after = own[0] - begin, end - own[-1]
    missing = max(before, 0.0) + max(after, 0.0)
    span = end - begin
    if own[0] > end or own[-1] < begin:
        return []
    if max(before, after) < _MISSING_S or missing < _MISSING_SHARE * span:
        return []
    ratio = span / max(own[-1] - own[0], 1e-9)
    unit = next(
        (name for factor, name in _SLOW_TICKS if 0.9 < ratio / factor < 1.1 and own[0] < 1e5), None
    )
    where = " and ".join(
        text for text, seconds in ((f"the first {before:.1f} s", before),
                                   (f"the last {after:.1f} s", after)) if seconds >= _MISSING_S
    )  # fmt: skip
    return [
        Finding(
            "stamp_unit" if unit else "odometry_missing",
            "error" if unit else "warning",
            drive.names.odometry,
            f"it has no rows in {where} of the {span:.1f} s of the drive"
            + (f"; its stamps are {unit}" if unit else ""),
            "rows from the first to the last stamp of the others",
            "write stamps in seconds" if unit
            else "record it for the whole drive, or cut the others to it",
        )
    ]  # fmt: skip
