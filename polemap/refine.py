"""The disparity of a whole stem, straight from the two images.

A dense matcher looks at every pixel for itself; its values at thin things lean towards the
background and towards whole pixels. A stem is one surface at one disparity: the columns between
and on its flanks, over all its rows, are fitted to the right image at once, with gain and offset of
the cameras as unknowns, by Gauss-Newton with robust weights.

Source: B. Lucas, T. Kanade, IJCAI 1981, for the iteration; here with a single unknown shift.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivelog.samples import Image

Floats = NDArray[np.float64]

_ROWS = 28
_COLUMNS = 11
_BESIDE_PX = 0.7  # the flanks themselves say most
_SWEEPS = 4
_REACH_PX = 1.6  # farther from the matcher's value the fit is not believed
_STEP_PX = 0.8
_CORRELATION_MIN = 0.7
_QUANTISATION_GREY = 0.29  # of whole grey levels: no picture is more exact
_NEIGHBOURS = 6.0  # so many samples share an error: blur, and columns taken twice


@dataclass(frozen=True, slots=True)
class Fit:
    """Disparity, its standard deviation (NaN where not trusted), and whether to believe it."""

    disparity_px: Floats
    sd_px: Floats
    trusted: NDArray[np.bool_]


def refine_disparity(
    left: Image,
    right: Image,
    left_px: Floats,
    right_px: Floats,
    top_px: Floats,
    bottom_px: Floats,
    slope: Floats,
    disparity_px: Floats,
) -> Fit:
    """Fit the disparity of every stem; arrays are `(n,)`.

    Args:
        left, right: the rectified pair.
        left_px, right_px: flanks at mid height.
        top_px, bottom_px: rows between which the stem is seen.
        slope: columns a row.
        disparity_px: where to begin, and what stays where the fit fails.
    """
    count = len(disparity_px)
    if not count:
        return Fit(disparity_px, np.empty(0), np.empty(0, dtype=bool))
    one, two = (cv2.GaussianBlur(image, (3, 3), 0.8) for image in (left, right))
    height, width = left.shape
    share = (np.arange(_ROWS) + 0.5) / _ROWS
    rows = np.rint(top_px[:, None] + (bottom_px - top_px)[:, None] * share)
    middle = 0.5 * (top_px + bottom_px)
    across = np.linspace(0.0, 1.0, _COLUMNS)
    first, last = left_px - _BESIDE_PX, right_px + _BESIDE_PX
    columns = first[:, None] + (last - first)[:, None] * across
    lean = slope[:, None] * (rows - middle[:, None])
    u = np.rint(columns[:, None, :] + lean[:, :, None]).astype(np.int64)
    v = np.clip(rows, 0, height - 1).astype(np.int64)[:, :, None]
    inside = (u >= 0) & (u < width)
    grey = one[v, np.clip(u, 0, width - 1)].astype(np.float64).reshape(count, -1)
    inside = inside.reshape(count, -1)
    u_flat, v_flat = u.reshape(count, -1), np.broadcast_to(v, u.shape).reshape(count, -1)
    shift, gain, offset = disparity_px.astype(np.float64).copy(), np.ones(count), np.zeros(count)
    weight = inside.astype(np.float64)
    noise = np.ones(count)
    curvature = np.ones(count)
    for _ in range(_SWEEPS):
        at = u_flat - shift[:, None]
        base = np.floor(at).astype(np.int64)
        part = at - base
        good = inside & (base >= 1) & (base < width - 2)
        base = np.clip(base, 1, width - 3)
        before, after = (
            two[v_flat, base].astype(np.float64),
            two[v_flat, base + 1].astype(np.float64),
        )
        other = before + part * (after - before)
        residual = grey - gain[:, None] * other - offset[:, None]
        spread = 1.4826 * np.median(np.abs(residual), axis=1) + 0.3
        weight = good / (1.0 + (residual / (2.0 * spread[:, None])) ** 2)
        slope_grey = -gain[:, None] * (after - before)  # right column is u minus disparity
        design = np.stack([slope_grey, other, np.ones_like(other)], axis=2)
        weighted = design * weight[:, :, None]
        normal = np.swapaxes(weighted, 1, 2) @ design
        scale = np.trace(normal, axis1=1, axis2=2)[:, None, None]
        # a stem whose partner lies outside the right image has no equation at all
        normal = normal + (1e-9 * scale + 1e-12) * np.eye(3)
        step = np.linalg.solve(normal, (weighted * residual[:, :, None]).sum(axis=1)[:, :, None])
        shift = shift + np.clip(step[:, 0, 0], -_STEP_PX, _STEP_PX)
        gain, offset = gain + step[:, 1, 0], offset + step[:, 2, 0]
        total = np.maximum(weight.sum(axis=1), 1.0)
        noise = np.sqrt((weight * residual**2).sum(axis=1) / total + _QUANTISATION_GREY**2)
        curvature = 1.0 / np.maximum(np.linalg.inv(normal)[:, 0, 0], 1e-12)
    mean = (weight * grey).sum(axis=1) / total
    variance = (weight * (grey - mean[:, None]) ** 2).sum(axis=1) / total
    explained = 1.0 - noise**2 / np.maximum(variance, 1e-9)
    sd = np.sqrt(_NEIGHBOURS) * noise / np.sqrt(curvature)
    trusted = (np.abs(shift - disparity_px) <= _REACH_PX) & (explained >= _CORRELATION_MIN**2)
    trusted &= (gain > 0.4) & (gain < 2.5) & (sd < 0.5) & np.isfinite(shift) & (shift > 0.5)
    return Fit(np.where(trusted, shift, disparity_px), np.where(trusted, sd, np.nan), trusted)
