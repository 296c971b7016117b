"""Trajectories of other systems brought to ours, by as little as is asked for and said.

The kinds are those of evo: nothing, the first pose, a rigid motion of the plane, the clock, or the
clock and then one of the others.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.plausibility.clocks import LAG_MAX_S, OVERLAP_MIN_S, find_lag
from polemap.drivelog.plausibility.odometer import of_reference
from polemap.drivelog.streams import ReferenceStream
from polemap.vehicle.pose import rotation, wrap_angle
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]
Alignment = Literal["none", "origin", "se2", "time", "time,origin", "time,se2"]
ALIGNMENTS: tuple[str, ...] = get_args(Alignment)
# the correlation finds the lag to some hundredths of a second, positions more finely
_REFINEMENTS, _REFINED_MAX_S = 5, 0.3


def align(
    track: Trajectory, goal: Trajectory, kind: Alignment, name: str
) -> tuple[Trajectory, str]:
    """The track as it is to be compared with the goal, and what was done to it in words.

    Args:
        track: of another system.
        goal: the reference, or our own output where there is none.
        kind: `none`; `origin` puts the first common pose onto the goal's; `se2` moves it by the
            rigid motion that brings all common positions nearest (least squares); `time` shifts
            its stamps by the lag of its speeds and turn rates; `time,se2` and `time,origin` do
            both, the lag refined by the positions that the motion brings together.
        name: of the track, for messages.

    Raises:
        InputError: nothing in common to align by.

    Source: Horn 1987, in the plane: the rotation is the angle of the summed products.
    """
    if kind == "none":
        return track, f"{name}: not aligned"
    if kind == "time":
        lag = _clock_lag(track, goal, name)
        moved = Trajectory(track.stamp_s - lag, track.poses, track.covariance)
        return moved, f"{name}: aligned by time, its stamps less {lag:.3f} s"
    if kind in ("time,origin", "time,se2"):
        lag = _clock_lag(track, goal, name)
        lag += _refined_lag(Trajectory(track.stamp_s - lag, track.poses), goal, name)
        shifted = Trajectory(track.stamp_s - lag, track.poses, track.covariance)
        rest: Alignment = "se2" if kind == "time,se2" else "origin"
        moved, text = align(shifted, goal, rest, name)
        return moved, f"{text}, after its stamps less {lag:.3f} s"
    poses = goal.at(track.stamp_s)
    both = np.isfinite(poses).all(axis=1)
    if both.sum() < 2:
        raise InputError(
            f"{name}: shares no time with what it is to be aligned to; --align time brings clocks "
            "together"
        )
    ours, theirs = poses[both], track.poses[both]
    if kind == "origin":
        turn = float(wrap_angle(ours[0, 2] - theirs[0, 2]))
        a, b = theirs[0, :2], ours[0, :2]
    else:
        a, b = theirs[:, :2].mean(axis=0), ours[:, :2].mean(axis=0)
        p, q = (theirs[:, :2] - a) @ [1.0, 1j], (ours[:, :2] - b) @ [1.0, 1j]
        turn = float(np.angle(np.sum(p.conj() * q)))
    points = (track.poses[:, :2] - a) @ rotation(turn).T + b
    moved = Trajectory(
        track.stamp_s, np.column_stack([points, wrap_angle(track.poses[:, 2] + turn)])
    )
    far = float(np.median(np.hypot(*(points - track.poses[:, :2]).T)))
    what = "first common pose" if kind == "origin" else "SE(2)"
    return moved, (
        f"{name}: aligned by {what}, turned {np.degrees(turn):.2f} degrees and moved {far:.2f} m"
    )


def _refined_lag(track: Trajectory, goal: Trajectory, name: str) -> float:
    """What is left of the lag, by the way along which the track lies behind the goal."""
    lag = 0.0
    for _ in range(_REFINEMENTS):
        moved, _text = align(Trajectory(track.stamp_s - lag, track.poses), goal, "se2", name)
        poses = goal.at(moved.stamp_s)
        velocity = np.gradient(moved.poses[:, :2], moved.stamp_s, axis=0)
        both = np.isfinite(poses).all(axis=1)
        power = float((velocity[both] ** 2).sum())
        if power <= 0.0:
            return lag
        off = poses[both, :2] - moved.poses[both, :2]
        lag += float((off * velocity[both]).sum()) / power
        lag = float(np.clip(lag, -_REFINED_MAX_S, _REFINED_MAX_S))
    return lag


def _clock_lag(track: Trajectory, goal: Trajectory, name: str) -> float:
    """Seconds by which the track's stamps are late; the clocks may have different epochs."""
    rough = 0.0
    if track.stamp_s[0] > goal.stamp_s[-1] or track.stamp_s[-1] < goal.stamp_s[0]:
        rough = float(track.stamp_s[0] - goal.stamp_s[0])
    duration = float(max(np.ptp(track.stamp_s), np.ptp(goal.stamp_s)))
    nothing = np.full(len(track), np.nan)
    theirs = of_reference(ReferenceStream(track.stamp_s - rough, track.poses, nothing))
    ours = of_reference(ReferenceStream(goal.stamp_s, goal.poses, np.full(len(goal), np.nan)))
    reach = max(LAG_MAX_S, 0.7 * duration if rough else 0.0)
    lag = find_lag(ours, theirs, reach, min(OVERLAP_MIN_S, 0.5 * duration))
    if lag is None:
        raise InputError(f"{name}: its speeds and turn rates fit ours at no shift of its clock")
    return rough + lag.lag_s
