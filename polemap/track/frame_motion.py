"""How the vehicle moved from one frame to the next.

Tracks would rather be dropped than moved by a guess, so a hole in the odometry is told. A
localizer's dead reckoning, which goes on through holes, is another matter.
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from polemap.drivelog.odometry_window import OdometryWindow
from polemap.track.tracks import Motion
from polemap.vehicle.motion import move_along_arc

KEEP_S = 10.0
"""Length of the window that a tracker needs: frames that come later than that are of no use."""


def motion_between(
    window: OdometryWindow, start_s: float, end_s: float, *, gap_max_s: float = 1.0
) -> Motion | None:
    """The motion from `start_s` to `end_s`; None where the odometry does not cover it.

    Speed and yaw rate are linear between samples and held beyond the first and the last one.

    Args:
        gap_max_s: the longest time without a sample.
    """
    if not len(window) or end_s < start_s:
        return None
    # what came before the last sample up to the start says nothing about the time from here on
    first = max(bisect_right(window.stamps_s, start_s) - 1, 0)
    stamp = np.array(window.stamps_s[first:])
    speed, rate = np.array(window.speeds_mps[first:]), np.array(window.yaw_rates_radps[first:])
    near = (stamp > start_s - gap_max_s) & (stamp < end_s + gap_max_s)
    inside = stamp[near]
    if not len(inside) or np.diff(np.r_[start_s, inside, end_s]).max() > gap_max_s:
        return None
    knots = np.r_[start_s, stamp[(stamp > start_s) & (stamp < end_s)], end_s]
    dt = np.diff(knots)
    middle = 0.5 * (knots[1:] + knots[:-1])
    distance = np.interp(middle, stamp, speed) * dt
    turn = np.interp(middle, stamp, rate) * dt
    # every arc on its own, from the origin in the direction that those before it led to
    begin = np.zeros((len(turn), 3))
    begin[1:, 2] = np.cumsum(turn[:-1])
    arcs = move_along_arc(begin, distance, turn)
    return Motion(
        dt_s=end_s - start_s,
        forward_m=float(arcs[:, 0].sum()),
        left_m=float(arcs[:, 1].sum()),
        turn_rad=float(turn.sum()),
        distance_m=float(np.abs(distance).sum()),
    )
