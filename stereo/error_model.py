"""How far a disparity may be off.

The table was measured with `python -m benchmarks.stereo.accuracy KITTI_2015 --calibrate` on every
second pair of the training set (default settings of the census matcher); the other pairs are the
test. It includes the error of that ground truth itself, so it is rather too large than too small.
Outliers are left out of it: how likely they are, `stereo/trust.py` says.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.errors import StereoError
from polemap.stereo.matching_types import Image

Floats = NDArray[np.float64]

OUTLIER_PX = 3.0
TEXTURE_WINDOW_PX = 5

_TEXTURE = (0.7, 1.5, 2.8, 5.5, 10.6, 21.6)
_MARGIN = (5.0, 15.0, 30.0, 50.0, 70.0, 95.0, 129.0, 173.0, 224.0)
_SD_PX = (
    (1.26, 1.23, 1.18, 1.11, 1.05, 0.98, 0.99, 0.99, 0.91),
    (1.20, 1.16, 1.08, 1.02, 0.93, 0.87, 0.82, 0.81, 0.79),
    (1.12, 1.08, 1.02, 0.96, 0.88, 0.83, 0.79, 0.80, 0.83),
    (1.08, 1.04, 0.98, 0.89, 0.80, 0.74, 0.69, 0.71, 0.78),
    (1.10, 1.06, 1.01, 0.92, 0.85, 0.77, 0.74, 0.75, 0.72),
    (1.06, 1.15, 1.12, 1.09, 0.98, 0.89, 0.86, 0.83, 0.78),
)


def texture(image: Image, bits: int = 8) -> Floats:
    """Strength of the horizontal grey gradient around each pixel, `(h, w)` grey values of 8 bit.

    Root mean square of the central difference over 5x5 pixels: vertical structure is what tells
    disparities apart.
    """
    grey = image.astype(np.float64) / 2.0 ** (bits - 8)
    step = np.zeros_like(grey)
    step[:, 1:-1] = (grey[:, 2:] - grey[:, :-2]) / 2
    window = (TEXTURE_WINDOW_PX, TEXTURE_WINDOW_PX)
    return np.sqrt(np.asarray(cv2.blur(step * step, window), dtype=np.float64))


@dataclass(frozen=True, slots=True)
class DisparityErrorModel:
    """Error of a disparity by texture (see `texture`) and margin (`DisparityPair.left_margin`).

    Attributes:
        texture_grid: `(m,)` ascending grey values; between them linear in the logarithm.
        margin_grid: `(n,)` ascending, 0 to 255.
        sd_px_table: `(m, n)` standard deviation of what is no outlier.

    Raises:
        StereoError: tables that do not fit their grids, or values that cannot be.
    """

    texture_grid: Floats = field(default_factory=lambda: np.array(_TEXTURE))
    margin_grid: Floats = field(default_factory=lambda: np.array(_MARGIN))
    sd_px_table: Floats = field(default_factory=lambda: np.array(_SD_PX))

    def __post_init__(self) -> None:
        shape = (len(self.texture_grid), len(self.margin_grid))
        if self.sd_px_table.shape != shape:
            raise StereoError(f"an error model with grids of {shape} needs a table of that shape")
        if not (np.diff(self.texture_grid) > 0).all() or not (np.diff(self.margin_grid) > 0).all():
            raise StereoError("the grids of an error model must ascend")
        if not (self.sd_px_table > 0).all() or not (self.texture_grid > 0).all():
            raise StereoError("an error model needs positive standard deviations and textures")

    def sd_px(self, texture: Floats, margin: NDArray[np.uint8] | Floats) -> Floats:
        """Standard deviation of disparity, broadcast over both arguments.

        Bilinear in log texture and margin, constant outside the grids.
        """
        logs = np.log(np.maximum(np.asarray(texture, dtype=np.float64), 1e-6))
        row, down = _place(np.log(self.texture_grid), logs)
        column, right = _place(self.margin_grid, np.asarray(margin, dtype=np.float64))
        table = self.sd_px_table
        upper = table[row, column] * (1 - right) + table[row, column + 1] * right
        lower = table[row + 1, column] * (1 - right) + table[row + 1, column + 1] * right
        return np.asarray(upper * (1 - down) + lower * down)


def _place(grid: Floats, value: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Cell of a grid and the share of the way through it."""
    index = np.clip(np.searchsorted(grid, value) - 1, 0, len(grid) - 2)
    share = (value - grid[index]) / (grid[index + 1] - grid[index])
    return index, np.clip(share, 0.0, 1.0)
