"""May the output be trusted within three times its stated deviation? And if not, why."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.localize.config import HealthConfig
from polemap.localize.gnss.ekf_update import HELD_S, WRONG_FIXES
from polemap.localize.output_filter.state import NEVER, FilterState

Floats = NDArray[np.float64]

# a heading less sure than this leads a car off its lane within a few lengths
_YAW_SD_MAX_RAD = 0.1
SILENT_AFTER_S = 0.5
"""Odometry is silent after so long; at town speed the car is then some metres further."""
# fixes in a row, and how long; the errors of a fast receiver's fixes are alike for a moment
_FIXES_AFTER_S = 0.5
# poses in a row that fail the gate of 99.9 %, and how long; their errors are alike for a moment
_REJECTED, _REJECTED_S = 2, 0.25
# without a scan, or with poses that nobody offers, nothing checks odometry
_UNCHECKED_AFTER_S = 5.0


def distrust(state: FilterState, stamp_s: float, covariance: Floats, config: HealthConfig) -> str:
    """Why the output at `stamp_s` may not be trusted, "" where it may.

    Args:
        state: of the filter, predicted to the stamp.
        stamp_s: of the output.
        covariance: `(3, 3)` that the output states.
        config: how large its standard deviations may be.

    Returns:
        "unproven" (no pose on poles yet), "odometry_doubted", "odometry_silent", "poses_rejected",
        "fixes_disagree", "unchecked" (no pose for long) or "spread": the first that holds.
    """
    if state.last_pose_s == NEVER:
        return "unproven"
    if state.doubted:
        return "odometry_doubted"
    if stamp_s - state.odometry_s > SILENT_AFTER_S:
        return "odometry_silent"
    if _poses_rejected(state, stamp_s):
        return "poses_rejected"
    if fixes_disagree(state, stamp_s):
        return "fixes_disagree"
    if stamp_s - state.last_pose_s > _UNCHECKED_AFTER_S:
        return "unchecked"
    east, north, both = covariance[0, 0], covariance[1, 1], covariance[0, 1]
    largest = 0.5 * (east + north) + float(np.hypot(0.5 * (east - north), both))
    if largest > config.sd_max_m**2 or covariance[2, 2] > _YAW_SD_MAX_RAD**2:
        return "spread"
    return ""


def _poses_rejected(state: FilterState, stamp_s: float) -> bool:
    """Whether poses have failed the gate for a while with none accepted in between.

    They need not agree among themselves: of an odometry that goes wrong the filter is led on, and
    the poses, which are right, do not move as it does.
    """
    rival = state.rival
    if rival is None:
        return False
    return rival.rejected >= _REJECTED and stamp_s - rival.first_s >= _REJECTED_S


def fixes_disagree(state: FilterState, stamp_s: float) -> bool:
    """Whether all fixes have failed for a while in which no pole spoke for the pose.

    Each fails a gate that 99 % of right ones pass, the error that they share known: three in a row
    happen by chance once in a million. Where poles are found the fixes are wrong, and those that
    failed while poles held the pose are no evidence later.
    """
    alone = stamp_s - state.held_s > HELD_S
    lasted_s = stamp_s - state.gnss_rejected_since_s
    failed = state.gnss_rejected >= WRONG_FIXES and lasted_s >= _FIXES_AFTER_S
    return alone and failed and not state.gnss_wrong
