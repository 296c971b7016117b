"""The flanks of a candidate on the strongest mean image gradient, to a fraction of a pixel."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.detect.hypotheses import Hypotheses

Floats = NDArray[np.float64]

_ROWS = 24  # image rows along the candidate for the gradient profile
_REACH_PX = 5
_OFFSETS = np.arange(-_REACH_PX - 1, _REACH_PX + 2)
_NEARNESS = np.exp(-0.5 * (np.arange(-_REACH_PX, _REACH_PX + 1) / 2.5) ** 2)
_SIDES = np.array([-0.5, 0.5])[:, None, None]
INSIDE = np.array([-0.25, 0.0, 0.25])  # of the width, where the candidate itself is sampled


def refine_flanks(
    hypotheses: Hypotheses, image: NDArray[np.uint8] | NDArray[np.uint16]
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Flanks on the strongest mean image gradient along them, to a fraction of a pixel.

    Returns left and right column at the centre row, their standard deviation, the normalised
    gradients and the smoothness of the texture along the candidate.
    """
    n = len(hypotheses)
    height, width = image.shape
    share = (np.arange(_ROWS) + 0.5) / _ROWS
    rows = hypotheses.top_px[:, None] + (hypotheses.bottom_px - hypotheses.top_px)[:, None] * share
    centre = hypotheses.column_px[:, None] + hypotheses.slope[:, None] * (
        rows - hypotheses.row_px[:, None]
    )
    v = np.minimum(np.maximum(np.rint(rows).astype(np.int64), 0), height - 1)
    # integer columns along both flanks, the fraction is put back at the end
    contrast = float(cv2.meanStdDev(image[::8, ::8])[1].item()) + 1e-6
    flank = centre + _SIDES * hypotheses.width_px[:, None]
    base = np.rint(flank)
    u = np.minimum(np.maximum(base.astype(np.int64)[..., None] + _OFFSETS, 0), width - 1)
    grey = image.ravel().take(u + v[:, :, None] * width).astype(np.float64)
    gradient = 0.5 * (grey[..., 2:] - grey[..., :-2]) / contrast
    rise = np.add.reduce(gradient, axis=2) / _ROWS
    mean = np.abs(rise) + 0.35 * (np.add.reduce(np.abs(gradient), axis=2) / _ROWS)
    mean = (mean * _NEARNESS).reshape(2 * n, len(_NEARNESS))
    at = np.minimum(np.maximum(mean.argmax(axis=1), 1), 2 * _REACH_PX - 1)
    row = np.arange(2 * n)
    before, peak, after = mean[row, at - 1], mean[row, at], mean[row, at + 1]
    bend = before - 2.0 * peak + after
    fraction = np.where(bend < -1e-9, 0.5 * (before - after) / np.minimum(bend, -1e-9), 0.0)
    fraction = np.minimum(np.maximum(fraction, -0.5), 0.5)
    moved = at - _REACH_PX + fraction + (base - flank).mean(axis=2).ravel()
    strength = peak / (np.sort(mean, axis=1)[:, _REACH_PX] + 0.02)  # against the median
    trusted = ((strength >= 1.8) & (peak >= 0.05)).reshape(2, n)
    plain = hypotheses.column_px + _SIDES[:, 0] * hypotheses.width_px
    columns = plain + np.where(trusted, moved.reshape(2, n), 0.0)
    crossed = columns[1] - columns[0] < 0.5
    left_px, right_px = np.where(crossed, plain, columns)
    blurred = ~(trusted & ~crossed)
    flank_sd = np.sqrt(np.where(blurred, 1.5**2, 0.4**2).mean(axis=0))
    smooth = _smoothness(hypotheses, image, centre, v, contrast)
    edge_left, edge_right = np.minimum(peak, 1.5).reshape(2, n)
    return left_px, right_px, flank_sd, edge_left, edge_right, smooth


def _smoothness(
    hypotheses: Hypotheses,
    image: NDArray[np.uint8] | NDArray[np.uint16],
    centre: Floats,
    v: NDArray[np.int64],
    contrast: float,
) -> Floats:
    """Mean step of the grey value from row to row inside the candidate, against the contrast."""
    width = image.shape[1]
    u = np.rint(centre[:, :, None] + INSIDE * hypotheses.width_px[:, None, None]).astype(np.int64)
    u = np.minimum(np.maximum(u, 0), width - 1)
    grey = image.ravel().take(v[:, :, None] * width + u).astype(np.float64)
    step = np.abs(grey[:, 1:] - grey[:, :-1]).mean(axis=(1, 2))
    return np.asarray(np.minimum(step / contrast, 2.0))
