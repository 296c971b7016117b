"""OpenCV's StereoSGBM behind census-type preprocessing, for both views."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.census import census_planes, partial_ranks, rank_transform
from polemap.stereo.checks import SPECKLE_STEP_PX, check_left_right, check_pair, without_speckles
from polemap.stereo.config import Preprocessing, StereoConfig
from polemap.stereo.matching_types import DisparityPair, Image
from polemap.stereo.rig import StereoRig

_MODES = {
    "sgbm": cv2.STEREO_SGBM_MODE_SGBM,
    "3way": cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    "hh": cv2.STEREO_SGBM_MODE_HH,
    "hh4": cv2.STEREO_SGBM_MODE_HH4,
}
_SUBPIXELS = 16.0


@dataclass(frozen=True, slots=True)
class OpenCvOptions:
    """StereoSGBM's own options.

    Attributes:
        mode: StereoSGBM's own name of its paths.
        block_size_px: edge of the matched block.
        p1, p2: penalties of a change by one pixel and by more, per squared block pixel and
            channel, as OpenCV's own examples give them.
    """

    mode: Literal["sgbm", "3way", "hh", "hh4"] = "3way"
    block_size_px: int = 3
    p1: int = 8
    p2: int = 32


OPENCV_OPTIONS = OpenCvOptions()


def preprocess(image: Image, kind: Preprocessing) -> NDArray[np.uint8]:
    """What StereoSGBM is given to see: 8 bit, one channel `(h, w)` or three `(h, w, 3)`."""
    if kind == "rank7x7":
        return rank_transform(image, 3)
    if kind == "partial_ranks":
        return partial_ranks(image)
    if kind == "census_bytes":
        return np.ascontiguousarray(np.moveaxis(census_planes(image), 0, -1))
    if kind == "clahe":
        # in the image's own depth, so that dark 16-bit images keep their texture
        image = cast(Image, cv2.createCLAHE(2.0, (8, 8)).apply(image))
    if image.dtype == np.uint16:
        top = max(int(image.max()), 1)
        return np.asarray(image.astype(np.uint32) * 255 // top, dtype=np.uint8)
    return np.asarray(image, dtype=np.uint8)


class OpenCvSgbm:
    """StereoSGBM on the pair and, for the right view, on the flipped and swapped pair.

    Flipping gives a right map of its own aggregation: the winner over the left view's sums would
    inherit the left view's occlusions.
    """

    name = "opencv_sgbm"

    def __init__(
        self,
        config: StereoConfig,
        rig: StereoRig | None = None,
        options: OpenCvOptions = OPENCV_OPTIONS,
    ) -> None:
        self._config = config
        self._rig = rig
        self._options = options

    def match(self, left: Image, right: Image) -> DisparityPair:
        """Both disparity maps of a rectified pair.

        Raises:
            StereoError: images of different size or type, or too small for the search range.
        """
        check_pair(left, right, self._config, self._rig)
        kind = self._config.opencv_preprocessing
        with ThreadPoolExecutor(max_workers=2) as pool:
            left8, right8 = pool.map(lambda image: preprocess(image, kind), (left, right))
            flipped = [np.ascontiguousarray(image[:, ::-1]) for image in (right8, left8)]
            left_job = pool.submit(self._left_map, left8, right8)
            right_job = pool.submit(self._left_map, *flipped)
            left_map = left_job.result()
            right_map = np.ascontiguousarray(right_job.result()[:, ::-1])
        pair = check_left_right(left_map, right_map, self._config.left_right_tolerance_px)
        least = self._config.speckle_px
        return replace(
            pair,
            left=without_speckles(pair.left, least, SPECKLE_STEP_PX),
            right=without_speckles(pair.right, least, SPECKLE_STEP_PX),
        )

    def _left_map(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.float32]:
        config, options = self._config, self._options
        channels = 3 if left.ndim == 3 else 1
        scale = channels * options.block_size_px**2
        # StereoSGBM leaves the first columns of its search range empty: a border keeps them
        border = config.min_disparity_px + config.disparities
        matcher = cv2.StereoSGBM.create(
            minDisparity=config.min_disparity_px,
            numDisparities=config.disparities,
            blockSize=options.block_size_px,
            P1=options.p1 * scale,
            P2=options.p2 * scale,
            disp12MaxDiff=-1,
            preFilterCap=63,
            uniquenessRatio=config.uniqueness_percent,
            mode=_MODES[options.mode],
        )
        pads = (0, 0, border, 0, cv2.BORDER_REPLICATE)
        raw = matcher.compute(cv2.copyMakeBorder(left, *pads), cv2.copyMakeBorder(right, *pads))
        disparity = raw[:, border:].astype(np.float32) / np.float32(_SUBPIXELS)
        column = np.arange(disparity.shape[1], dtype=np.float32)
        known = (disparity >= config.min_disparity_px) & (disparity <= column)
        return np.where(known, disparity, np.float32(np.nan))
