"""How far a disparity can be trusted: its chance to be an outlier, read off the two maps alone.

Two signs, both cheap. Where the views contradict each other or have holes, what they agree upon
nearby is often wrong, too; and a disparity that leaves the others of its column is rarely right,
while a pole, a wall and the road keep to theirs. (Leaving the others of its row is no such sign:
thin poles do.) The coefficients were fitted with `python -m benchmarks.stereo.accuracy KITTI_2015
--calibrate --every 2`, for each matcher at its default settings; the other pairs are the test.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.checks import Disparity, difference_px
from polemap.stereo.errors import StereoError
from polemap.stereo.matching_types import DisparityPair, Image, StereoMatcher

AREA_PX = (9, 31)  # width, height: mostly along what stands upright
COLUMN_PX = (1, 21)
OFFSET_LEAST_PX = 0.1
_DIFFERENCE_MOST_PX = 2.0


@dataclass(frozen=True, slots=True)
class TrustLaw:
    """Logistic: log odds = constant + disagreement * a + log(offset + 0.1 px) * b."""

    constant: float
    per_disagreement_px: float
    per_log_offset: float

    def chance(self, disagreement_px: Disparity, offset_px: Disparity) -> Disparity:
        """Probability of an error over 3 px, float32; NaN where the offset is."""
        log_odds = (
            np.float32(self.constant)
            + np.float32(self.per_disagreement_px) * disagreement_px
            + np.float32(self.per_log_offset) * np.log(offset_px + np.float32(OFFSET_LEAST_PX))
        )
        return np.asarray(1 / (1 + np.exp(-log_odds)), dtype=np.float32)


LAWS = {
    "census_sgm": TrustLaw(-4.68, 3.46, 0.84),
    "opencv_sgbm": TrustLaw(-4.32, 2.54, 1.10),
}


def disagreement_px(disparity: Disparity, other: Disparity, sign: int) -> Disparity:
    """How much the views differ around each pixel, `(h, w)` float32 from 0 to 2 px.

    The mean over 9x31 pixels of |own disparity - partner's|, where every difference over 2 px and
    every pixel without a disparity counts as 2 px. `other` is the other view before its checks,
    `sign` -1 for the left view and +1 for the right.
    """
    differences = np.minimum(difference_px(disparity, other, sign), np.float32(_DIFFERENCE_MOST_PX))
    return _mean(differences, AREA_PX)


def column_offset_px(disparity: Disparity) -> Disparity:
    """|disparity - mean of those in 21 rows of its column|, `(h, w)` float32; NaN where none is."""
    known = np.isfinite(disparity)
    total = _mean(np.where(known, disparity, np.float32(0)), COLUMN_PX)
    share = _mean(known.astype(np.float32), COLUMN_PX)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.abs(disparity - total / share)


def outlier_chance(pair: DisparityPair, matcher: str) -> tuple[Disparity, Disparity]:
    """Chance of each disparity of the left and of the right map to be off by more than 3 px.

    Args:
        pair: with its maps before the checks.
        matcher: `name` of the matcher that made it.

    Returns:
        Two `(h, w)` float32 maps, NaN where there is no disparity.

    Raises:
        StereoError: a matcher without a law, or a pair without the maps before the checks.
    """
    law = LAWS.get(matcher)
    if law is None:
        raise StereoError(f"no law of trust for the matcher {matcher}: there is {', '.join(LAWS)}")
    if pair.left_unchecked is None or pair.right_unchecked is None:
        raise StereoError("trust needs the disparity maps before the left-right check")
    return (
        law.chance(
            disagreement_px(pair.left, pair.right_unchecked, -1), column_offset_px(pair.left)
        ),
        law.chance(
            disagreement_px(pair.right, pair.left_unchecked, +1), column_offset_px(pair.right)
        ),
    )


class DoubtFilter:
    """A matcher whose maps keep only disparities with a small enough `outlier_chance`."""

    def __init__(self, matcher: StereoMatcher, chance_max: float) -> None:
        self._matcher = matcher
        self._chance_max = np.float32(chance_max)

    @property
    def name(self) -> str:
        """The matcher's own."""
        return self._matcher.name

    def match(self, left: Image, right: Image) -> DisparityPair:
        """Both disparity maps of a rectified pair.

        Raises:
            StereoError: see the matcher, and `outlier_chance`.
        """
        pair = self._matcher.match(left, right)
        chances = outlier_chance(pair, self.name)
        missing = np.float32(np.nan)
        kept = (
            np.where(chance <= self._chance_max, disparity, missing)
            for chance, disparity in zip(chances, (pair.left, pair.right), strict=True)
        )
        return replace(pair, **dict(zip(("left", "right"), kept, strict=True)))


def _mean(values: NDArray[np.float32], window_px: tuple[int, int]) -> Disparity:
    """Mean over a window of width and height; beyond the border the image is mirrored."""
    return np.asarray(cv2.blur(values, window_px, borderType=cv2.BORDER_REFLECT), dtype=np.float32)
