"""Markings as ridges of the road seen from above: stripes that a Laplacian of Gaussian answers."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.road_plane import BirdsEye, Grey

Floats = NDArray[np.float64]
Response = Literal["across", "isotropic"]
# a response that passes for paint: standard deviations of the picture's noise, and grey levels
RESPONSE_SDS, LEAST_RESPONSE = 3.0, 1.5
SMOOTHED_M = 0.5  # along the road, before the filter across it


class RidgeFilter:
    """Centres of bright stripes in each row of the road seen from above.

    `across` smooths 0.5 m along the road and takes the second derivative across it; `isotropic`
    is the two-dimensional Laplacian of Gaussian. Sigma is half the marking's width, so that the
    filter peaks at its centre.

    Source: W12 III (LoG) with errata.md, Road mapping.
    """

    def __init__(self, birds_eye: BirdsEye, marking_width_m: float, response: Response) -> None:
        self._birds_eye, grid = birds_eye, birds_eye.grid
        sigma_m = 0.5 * marking_width_m
        if response == "across":
            self._kernel = ridge_kernel(sigma_m / grid.across_m)[None, :]
            self._smooth = (1, max(1, round(SMOOTHED_M / grid.along_m)))
        else:
            self._kernel = isotropic_kernel(sigma_m / grid.across_m, sigma_m / grid.along_m)
            self._smooth = (1, 1)
        margin = self._kernel.shape[1] // 2 + 1
        self.valid = cv2.erode(
            birds_eye.seen.astype(np.uint8), np.ones((1, 2 * margin + 1), np.uint8)
        ).astype(bool)

    def points(self, image: Grey) -> tuple[Floats, Floats]:
        """Road points `(n, 2)` of stripes in an image, and how strong each is `(n,)`.

        In each row: local maxima of the response that stand out from that picture's own noise.
        """
        view = self._birds_eye.warp(image)
        if self._smooth != (1, 1):
            view = np.asarray(cv2.blur(view, self._smooth), dtype=np.uint8)
        response = cv2.filter2D(view, cv2.CV_32F, self._kernel)
        response[~self.valid] = 0.0
        some = response[self.valid][::7]
        # the median absolute deviation does not see the few rows of markings
        noise = 1.4826 * float(np.median(np.abs(some))) if len(some) else 0.0
        limit = max(RESPONSE_SDS * noise, LEAST_RESPONSE)
        middle = response[:, 1:-1]
        peak = (middle > limit) & (middle >= response[:, :-2]) & (middle > response[:, 2:])
        rows, columns = np.nonzero(peak)
        strength = middle[rows, columns].astype(np.float64)
        left, right = response[rows, columns], response[rows, columns + 2]
        bend = left - 2.0 * strength + right
        shift = np.where(bend < 0.0, 0.5 * (left - right) / np.where(bend < 0.0, bend, -1.0), 0.0)
        grid = self._birds_eye.grid
        return grid.to_road(rows.astype(np.float64), columns + 1.0 + shift), strength


def ridge_kernel(sigma_px: float) -> NDArray[np.float32]:
    """Minus the second derivative of a Gaussian `(n,)`, zero mean, answer 1 to a unit ridge."""
    radius = max(2, int(3.5 * sigma_px + 0.5))
    u = np.arange(-radius, radius + 1) / sigma_px
    kernel = (1.0 - u * u) * np.exp(-0.5 * u * u)
    kernel -= kernel.mean()
    return np.asarray(kernel / kernel[np.abs(u) <= 1.0].sum(), dtype=np.float32)


def isotropic_kernel(across_px: float, along_px: float) -> NDArray[np.float32]:
    """Minus the Laplacian of a Gaussian `(rows, columns)`, the same normalisation."""
    across, along = (max(2, int(3.5 * sigma + 0.5)) for sigma in (across_px, along_px))
    u = np.arange(-across, across + 1)[None, :] / across_px
    v = np.arange(-along, along + 1)[:, None] / along_px
    square = u * u + v * v
    kernel = (2.0 - square) * np.exp(-0.5 * square)
    kernel -= kernel.mean()
    stripe = np.broadcast_to(np.abs(u) <= 1.0, kernel.shape)
    return np.asarray(kernel / kernel[stripe].sum(), dtype=np.float32)
