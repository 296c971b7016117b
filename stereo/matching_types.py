"""What goes into a matcher and what comes out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class DisparityPair:
    """Disparity of the left and of the right view, `(height, width)` float32 pixels.

    `left[v, u]` belongs to left pixel (u, v) and its partner is right pixel (u - disparity, v);
    `right[v, u]` to right pixel (u, v), partner (u + disparity, v). NaN where there is none.
    `*_unchecked` hold the maps before the left-right check (half-occlusions keep a value there).
    `*_margin` say by how much the winner beats its rivals, uint8, 255 (second - best) / second.
    """

    left: NDArray[np.float32]
    right: NDArray[np.float32]
    left_unchecked: NDArray[np.float32] | None = None
    right_unchecked: NDArray[np.float32] | None = None
    left_margin: NDArray[np.uint8] | None = None
    right_margin: NDArray[np.uint8] | None = None


class StereoMatcher(Protocol):
    """Computes both disparity maps of a rectified pair.

    Raises:
        StereoError: images of different size or type, or too small for the disparity range.
    """

    @property
    def name(self) -> str:
        """The setting `stereo.matcher` that names it."""

    def match(self, left: Image, right: Image) -> DisparityPair:
        """Both disparity maps of a rectified pair."""
