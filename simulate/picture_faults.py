"""What can be wrong with a picture; 8 or 16 bit, the white level is that of the type or 12 bit."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import Image
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]


def each(pair: tuple[Image, Image], change: Callable[[Image], Image]) -> tuple[Image, Image]:
    """Both pictures changed alike."""
    return change(pair[0]), change(pair[1])


def white_level(image: Image) -> int:
    """255, or for 16-bit pictures the least full number of bits that holds all values."""
    if image.dtype == np.uint8:
        return 255
    return 4095 if int(image.max()) < 4096 else 65535


def _as_type_of(image: Image, values: NDArray[np.floating]) -> Image:
    clipped = np.clip(np.rint(values), 0, white_level(image))
    if image.dtype == np.uint8:
        return np.asarray(clipped, dtype=np.uint8)
    return np.asarray(clipped, dtype=np.uint16)


def brighten(image: Image, factor: float) -> Image:
    """Values times a factor, cut at white."""
    return _as_type_of(image, image.astype(np.float64) * factor)


def blur(image: Image, sigma_px: float) -> Image:
    """A Gaussian blur."""
    soft = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma_px)
    smooth = np.asarray(soft, dtype=np.float32)
    return _as_type_of(image, smooth)


def dirt(image: Image, spots: int, radius_px: float, rng: np.random.Generator) -> Image:
    """Soft dark and bright spots that blur what lies behind them."""
    height, width = image.shape
    cover = np.zeros((height, width), dtype=np.float32)
    glare = np.zeros((height, width), dtype=np.float32)
    for _ in range(spots):
        centre = (int(rng.uniform(0, width)), int(rng.uniform(0, height)))
        radius = max(2, int(radius_px * rng.uniform(0.3, 1.5)))
        cv2.circle(cover, centre, radius, float(rng.uniform(0.5, 1.0)), -1)
        cv2.circle(glare, centre, radius, float(rng.uniform(0.05, 0.6)), -1)
    cover = np.asarray(cv2.GaussianBlur(cover, (0, 0), radius_px / 4), dtype=np.float32)
    glare = np.asarray(cv2.GaussianBlur(glare, (0, 0), radius_px / 4), dtype=np.float32)
    far = np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), radius_px / 2))
    through = 0.6 * far + 0.4 * glare * white_level(image)
    return _as_type_of(image, (1 - cover) * image + cover * through)


def turning(rig: StereoRig, pitch_deg: float, yaw_deg: float, roll_deg: float) -> Floats:
    """Homography `(3, 3)` of a camera that turned about its x, y and z axis."""
    turn, _ = cv2.Rodrigues(np.deg2rad([pitch_deg, yaw_deg, roll_deg]))
    inner = np.array([[rig.focal_px, 0, rig.cx_px], [0, rig.focal_px, rig.cy_px], [0, 0, 1.0]])
    return np.asarray(inner @ turn @ np.linalg.inv(inner), dtype=np.float64)


def warp(image: Image, homography: Floats) -> Image:
    """The picture as a camera turned by the homography saw it."""
    size = (image.shape[1], image.shape[0])
    turned = cv2.warpPerspective(
        image, homography, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return _as_type_of(image, np.asarray(turned, dtype=np.float32))
