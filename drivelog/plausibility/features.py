"""Features followed from one picture into another, and from left to right in a pair."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import Image

Floats = NDArray[np.float64]
Grey = NDArray[np.uint8]

IN_ROW_PX = 1.0
_FEATURES = 200


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


@dataclass(frozen=True, slots=True)
class PairMatch:
    """Features of one pair: places in the left picture and steps to the right one, `(n, 2)`."""

    places_px: Floats
    steps_px: Floats

    @property
    def row_px(self) -> float:
        """By how many rows the right picture stands lower, in the median."""
        return float(np.median(self.steps_px[:, 1]))

    @property
    def in_row(self) -> float:
        """Share of the features within a pixel of that."""
        return float(np.mean(np.abs(self.steps_px[:, 1] - self.row_px) < IN_ROW_PX))

    @property
    def to_the_right(self) -> float:
        """Share of the features that stand farther right in the right picture."""
        return float(np.mean(self.steps_px[:, 0] > 0.5))


def match_pair(left: Image, right: Image, features: int = _FEATURES) -> PairMatch:
    """Follow corners of the left picture into the right one, there and back."""
    a, b = to_8_bit(left), to_8_bit(right)
    corners = cv2.goodFeaturesToTrack(a, features, 0.01, 10)
    if corners is None:
        return PairMatch(np.empty((0, 2)), np.empty((0, 2)))
    places, steps = follow(a, b, np.asarray(corners, dtype=np.float32))
    return PairMatch(places, steps)
