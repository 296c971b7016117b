"""Features followed from one picture into another."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import Image

Floats = NDArray[np.float64]
Grey = NDArray[np.uint8]


def to_8_bit(image: Image) -> Grey:
    """Spread over 8 bit, so that neither depth nor exposure matters to the matching."""
    # a sixteenth of the pixels shows the range as well
    low, high = np.percentile(image[::4, ::4], [1, 99])
    scaled = (image.astype(np.float32) - low) * (255.0 / max(float(high - low), 1.0))
    return np.asarray(np.clip(scaled, 0, 255), dtype=np.uint8)


def follow(a: Grey, b: Grey, corners: NDArray[np.float32]) -> tuple[Floats, Floats]:
    """Places `(n, 2)` in `a` and steps to `b` of the corners that lead back to themselves."""
    places, steps, _ = follow_rows(a, b, corners)
    return places, steps


def follow_rows(
    a: Grey, b: Grey, corners: NDArray[np.float32]
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """As `follow`, and the rows of the corners that are left."""
    if not len(corners):
        return np.empty((0, 2)), np.empty((0, 2)), np.empty(0, dtype=np.int64)
    window = {"winSize": (21, 21), "maxLevel": 4}
    there, ok_there, _ = cv2.calcOpticalFlowPyrLK(a, b, corners, None, **window)  # type: ignore[call-overload]
    back, ok_back, _ = cv2.calcOpticalFlowPyrLK(b, a, there, None, **window)  # type: ignore[call-overload]
    places = corners.reshape(-1, 2).astype(np.float64)
    steps = there.reshape(-1, 2) - places
    error = np.hypot(*(back.reshape(-1, 2) - places).T)
    kept = (ok_there.ravel() > 0) & (ok_back.ravel() > 0) & (error < 0.7)
    return places[kept], np.asarray(steps[kept], dtype=np.float64), np.flatnonzero(kept)
