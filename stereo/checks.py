"""What every matcher checks before, and the left-right check after."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.config import StereoConfig
from polemap.stereo.errors import StereoError
from polemap.stereo.matching_types import DisparityPair, Image
from polemap.stereo.rig import StereoRig

Disparity = NDArray[np.float32]

# neighbours are of one component if their disparities differ by no more
SPECKLE_STEP_PX = 1.0


def check_pair(left: Image, right: Image, config: StereoConfig, rig: StereoRig | None) -> None:
    """Refuses what no matcher can work with.

    Raises:
        StereoError: not grey, not 8 or 16 bit, different sizes or types, not the rig's size, or
            narrower than the smallest disparity.
    """
    for side, image in (("left", left), ("right", right)):
        if image.ndim != 2:
            raise StereoError(f"the {side} image has shape {image.shape}, it must be grey (h, w)")
        if image.dtype not in (np.uint8, np.uint16):
            raise StereoError(f"the {side} image is {image.dtype}, it must be uint8 or uint16")
    if left.shape != right.shape or left.dtype != right.dtype:
        raise StereoError(
            f"left image {left.shape} {left.dtype} and right image {right.shape} {right.dtype} "
            "differ, a pair needs the same size and type"
        )
    height, width = left.shape
    if height < 1 or width <= config.min_disparity_px:
        raise StereoError(
            f"an image of {width}x{height} px has no column with a disparity of at least "
            f"{config.min_disparity_px} px: lower min_disparity_px or use larger images"
        )
    if rig is not None and (width, height) != (rig.width_px, rig.height_px):
        raise StereoError(
            f"images of {width}x{height} px do not fit a rig of "
            f"{rig.width_px}x{rig.height_px} px: rectify them with this rig's calibration"
        )


def difference_px(disparity: Disparity, other: Disparity, sign: int) -> Disparity:
    """|disparity - the partner's in the other view|, infinite where either is missing.

    `sign` is -1 for the left view, whose partners lie to the left, and +1 for the right.
    """
    width = disparity.shape[1]
    known = np.isfinite(disparity)
    step = np.floor(np.where(known, disparity, np.float32(0)) + np.float32(0.5)).astype(np.int64)
    partner = np.arange(width) + sign * step
    known &= (partner >= 0) & (partner < width)
    seen = np.take_along_axis(other, np.clip(partner, 0, width - 1), axis=1)
    known &= np.isfinite(seen)
    with np.errstate(invalid="ignore"):
        return np.where(known, np.abs(seen - disparity), np.float32(np.inf))


def _consistent(disparity: Disparity, other: Disparity, sign: int, limit: float) -> Disparity:
    """`disparity` where the partner in `other` agrees to within `limit`, NaN elsewhere."""
    agrees = difference_px(disparity, other, sign) <= np.float32(limit)
    return np.where(agrees, disparity, np.float32(np.nan))


def check_left_right(
    left: Disparity, right: Disparity, tolerance_px: float | None
) -> DisparityPair:
    """Keeps in both maps what the other view confirms; None keeps everything."""
    if tolerance_px is None:
        return DisparityPair(left, right, left, right)
    return DisparityPair(
        _consistent(left, right, -1, tolerance_px),
        _consistent(right, left, +1, tolerance_px),
        left,
        right,
    )


def without_speckles(disparity: Disparity, least_px: int, step_px: float) -> Disparity:
    """`disparity` without connected components of fewer than `least_px` pixels.

    OpenCV's filter in sixteenths of a pixel, for OpenCV's matchers: the census kernel has its own,
    which spares what is tall.
    """
    if least_px <= 1:
        return disparity
    none = -16
    raw = np.where(np.isfinite(disparity), np.rint(disparity * 16), none).astype(np.int16)
    cv2.filterSpeckles(raw, none, least_px - 1, round(16 * step_px))
    return np.where(raw == none, np.float32(np.nan), disparity)
