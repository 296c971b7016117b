"""Periodic patterns that surfaces are drawn from: noise, fallen leaves, stones in rows.

Source: Lee, Mumford, Huang, "Occlusion models for natural images", IJCV 2001 (dead leaves).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats32 = NDArray[np.float32]
Texture = NDArray[np.floating[Any]]

TILE_PX = 512


def fractal(rng: np.random.Generator, exponent: float, stretch: float = 1.0) -> Floats32:
    """Periodic noise of zero mean and unit variance, amplitude falling as 1/f^exponent.

    `stretch` > 1 draws the pattern out along the rows (the v direction).
    """
    fy = np.fft.fftfreq(TILE_PX)[:, None] * stretch
    fx = np.fft.rfftfreq(TILE_PX)[None, :]
    radius = np.hypot(fx, fy)
    radius[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.standard_normal((TILE_PX, TILE_PX))) / radius**exponent
    spectrum[0, 0] = 0.0
    noise = np.fft.irfft2(spectrum, s=(TILE_PX, TILE_PX))
    return np.asarray(noise / noise.std(), dtype=np.float32)


def dead_leaves(
    rng: np.random.Generator, count: int, radius_px: tuple[float, float], spread: float
) -> Texture:
    """Opaque ellipses over each other, periodic, mean about 1; radii follow r^-2."""
    image = np.ones((TILE_PX, TILE_PX), dtype=np.float32)
    low, high = radius_px
    radii = low / (1 - rng.uniform(0, 1, count) * (1 - low / high))
    radii = np.sort(radii)[::-1]
    shades = np.exp(rng.normal(0, spread, count))
    centres = rng.uniform(0, TILE_PX, (count, 2))
    turns, flats = rng.uniform(0, 180, count), rng.uniform(0.4, 1.0, count)
    for radius, shade, (x, y), turn, flat in zip(radii, shades, centres, turns, flats, strict=True):
        axes = (max(1, int(radius)), max(1, int(radius * flat)))
        for dx in (0, -TILE_PX if x > TILE_PX / 2 else TILE_PX):
            for dy in (0, -TILE_PX if y > TILE_PX / 2 else TILE_PX):
                if (dx and not -radius < x + dx < TILE_PX + radius) or (
                    dy and not -radius < y + dy < TILE_PX + radius
                ):
                    continue
                centre = (int(x + dx), int(y + dy))
                cv2.ellipse(image, centre, axes, float(turn), 0, 360, float(shade), -1)
    return np.asarray(image / image.mean())


def stones(
    columns: int, rows: int, joint_px: int, rng: np.random.Generator, spread: float
) -> Texture:
    """Bricks or stones in rows, every second row shifted; own shade each, dark joints."""
    ys, xs = np.mgrid[0:TILE_PX, 0:TILE_PX]
    row = ys * rows // TILE_PX
    shifted = (xs + (row % 2) * TILE_PX // (2 * columns)) % TILE_PX
    column = shifted * columns // TILE_PX
    shade = 1 + spread * rng.standard_normal((rows, columns)).astype(np.float32)
    image = shade[row, column]
    joint = (ys % (TILE_PX // rows) < joint_px) | (shifted % (TILE_PX // columns) < joint_px)
    image[joint] *= 0.55
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0.7), dtype=np.float32)
