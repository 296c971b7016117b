"""Noise of a reference from row to row, and the reference without it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.streams import ReferenceStream

Floats = NDArray[np.float64]

# a step of a metre tells a course to two degrees with less
_QUIET_M = 0.03
_ACCELERATION_MPS2 = 10.0
_MEAN_S, _ROWS_MIN = 1.0, 5


def jitter_m(reference: ReferenceStream) -> float:
    """Standard deviation an axis of what is independent from row to row, beyond what a car does."""
    if len(reference) < 3:
        return 0.0
    points, step = reference.poses[:, :2], np.diff(reference.stamp_s)
    # a second difference of independent errors has six times their variance
    bend = np.median(np.abs(np.diff(points, n=2, axis=0))) * 1.4826 / np.sqrt(6.0)
    return max(0.0, float(bend) - _ACCELERATION_MPS2 * float(np.median(step)) ** 2)


def without_jitter(reference: ReferenceStream) -> ReferenceStream:
    """A reference whose rows jitter, averaged over a second; one that does not, as it is."""
    if jitter_m(reference) < _QUIET_M or np.median(np.diff(reference.stamp_s)) > (
        _MEAN_S / _ROWS_MIN
    ):
        return reference
    number = np.floor((reference.stamp_s - reference.stamp_s[0]) / _MEAN_S).astype(np.int64)
    _, span, count = np.unique(number, return_inverse=True, return_counts=True)
    yaw = np.unwrap(reference.poses[:, 2])
    columns = (reference.stamp_s, *reference.poses[:, :2].T, yaw, reference.sd_m)
    mean = np.stack([np.bincount(span, weights=column) / count for column in columns], axis=1)
    kept = mean[count >= _ROWS_MIN]
    return ReferenceStream(kept[:, 0], kept[:, 1:4], kept[:, 4])
