"""Procedural grey textures: periodic tiles with the contrast of real surfaces, packed with mipmaps.

Vegetation is drawn by the dead-leaves model (opaque discs falling on each other), which has the
edge statistics of natural images; mineral surfaces are filtered noise with cracks and joints.

Source: Lee, Mumford, Huang, "Occlusion models for natural images", IJCV 2001 (dead leaves).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats32 = NDArray[np.float32]
Texture = NDArray[np.floating[Any]]

TILE_PX = 512
LEVELS = 8
_PAD = 2


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


def _grid(
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


def _asphalt(rng: np.random.Generator) -> Texture:
    grain = 1 + 0.10 * fractal(rng, 0.15) + 0.06 * fractal(rng, 1.0)
    cracks = np.abs(fractal(rng, 1.6)) < 0.012
    grain[cracks] *= 0.6
    return 0.26 * grain


def _worn_asphalt(rng: np.random.Generator) -> Texture:
    grain = 1 + 0.13 * fractal(rng, 0.2) + 0.09 * fractal(rng, 1.2)
    cracks = np.abs(fractal(rng, 1.5)) < 0.03
    grain[cracks] *= 0.5
    return 0.33 * grain


def _cobble(rng: np.random.Generator) -> Texture:
    return 0.34 * _grid(12, 12, 5, rng, 0.18) * (1 + 0.12 * fractal(rng, 0.6))


def _slabs(rng: np.random.Generator) -> Texture:
    return (
        0.42 * _grid(6, 6, 3, rng, 0.07) * (1 + 0.10 * fractal(rng, 0.5) + 0.08 * fractal(rng, 1.3))
    )


def _grass(rng: np.random.Generator) -> Texture:
    return 0.27 * dead_leaves(rng, 9000, (2, 9), 0.38) * (1 + 0.15 * fractal(rng, 1.4))


def _gravel(rng: np.random.Generator) -> Texture:
    return 0.36 * dead_leaves(rng, 9000, (2, 12), 0.25) * (1 + 0.10 * fractal(rng, 1.2))


def _leaves(rng: np.random.Generator) -> Texture:
    return 0.26 * dead_leaves(rng, 5000, (4, 26), 0.75)


def _foliage(rng: np.random.Generator) -> Texture:
    return 0.20 * dead_leaves(rng, 6500, (3, 40), 0.8) * (1 + 0.3 * fractal(rng, 1.8))


def _bark(rng: np.random.Generator) -> Texture:
    return 0.20 * (1 + 0.30 * fractal(rng, 1.0, 0.2) + 0.16 * fractal(rng, 0.5))


def _birch(rng: np.random.Generator) -> Texture:
    image = 0.62 * (1 + 0.08 * fractal(rng, 1.0))
    image[fractal(rng, 1.0, 4.0) > 1.35] *= 0.3
    return image


def _plaster(rng: np.random.Generator) -> Texture:
    return 0.62 * (1 + 0.035 * fractal(rng, 0.4) + 0.05 * fractal(rng, 1.6))


def _brick(rng: np.random.Generator) -> Texture:
    return 0.30 * _grid(8, 24, 3, rng, 0.16) * (1 + 0.10 * fractal(rng, 0.8))


def _planks(rng: np.random.Generator) -> Texture:
    shade = (1 + 0.14 * rng.standard_normal(8)).repeat(TILE_PX // 8).astype(np.float32)
    image = 0.36 * shade[None, :] * (1 + 0.16 * fractal(rng, 1.0, 0.12))
    image[:, np.arange(TILE_PX) % (TILE_PX // 8) < 5] *= 0.3
    return np.asarray(image, dtype=np.float32)


def _concrete(rng: np.random.Generator) -> Texture:
    return 0.45 * (1 + 0.08 * fractal(rng, 0.7) + 0.09 * fractal(rng, 1.6))


def _paint(rng: np.random.Generator) -> Texture:
    return 0.50 * (1 + 0.02 * fractal(rng, 0.3) + 0.05 * fractal(rng, 1.8))


def _enamel(rng: np.random.Generator) -> Texture:
    """Car paint: hardly any texture of its own; it lives from what it mirrors."""
    return 0.50 * (1 + 0.012 * fractal(rng, 0.3) + 0.03 * fractal(rng, 2.0))


def _metal(rng: np.random.Generator) -> Texture:
    return 0.40 * (1 + 0.05 * fractal(rng, 0.6) + 0.10 * fractal(rng, 1.4, 0.3))


def _glass(rng: np.random.Generator) -> Texture:
    return 0.10 * (1 + 0.35 * fractal(rng, 2.2))


def _marking(rng: np.random.Generator) -> Texture:
    return np.where(fractal(rng, 0.9) > 1.3, 0.38, 0.80).astype(np.float32) * (
        1 + 0.06 * fractal(rng, 0.3)
    )


def _roof(rng: np.random.Generator) -> Texture:
    return 0.24 * _grid(10, 14, 4, rng, 0.14) * (1 + 0.12 * fractal(rng, 1.0))


def _sign(rng: np.random.Generator) -> Texture:
    image = np.full((TILE_PX, TILE_PX), 0.82, dtype=np.float32)
    half = TILE_PX // 2
    cv2.circle(image, (half, half), half - 20, 0.28, 60)
    for _ in range(4):
        corner = rng.integers(half - 120, half + 60, 2)
        size = rng.integers(30, 110, 2)
        cv2.rectangle(image, corner.tolist(), (corner + size).tolist(), 0.12, -1)
    return image * (1 + 0.02 * fractal(rng, 1.0))


def _poster(rng: np.random.Generator) -> Texture:
    """Posters side by side: what advertising columns and shop windows show."""
    image = np.full((TILE_PX, TILE_PX), 0.4, dtype=np.float32)
    for i in range(4):
        for j in range(3):
            x, y = i * TILE_PX // 4, j * TILE_PX // 3
            ground = float(rng.uniform(0.2, 0.8))
            cv2.rectangle(image, (x + 6, y + 6), (x + 120, y + 160), ground, -1)
            for _ in range(6):
                a = rng.integers(0, 90, 2) + np.array([x + 10, y + 10])
                b = a + rng.integers(8, 50, 2)
                cv2.rectangle(image, a.tolist(), b.tolist(), float(rng.uniform(0.05, 0.9)), -1)
    return image


def _window(rng: np.random.Generator) -> Texture:
    """A window with frame, sash bars and curtains; its uprights look like thin poles."""
    image = _glass(rng) * 1.2
    third = TILE_PX // 3
    image[: TILE_PX // 2, third : 2 * third] = 0.16
    image[:, : TILE_PX // 5] = 0.34
    for x in (0, TILE_PX // 2 - 18, TILE_PX - 37):
        image[:, x : x + 37] = 0.78
    for y in (0, TILE_PX // 3, TILE_PX - 37):
        image[y : y + 37] = 0.78
    return np.asarray(image, dtype=np.float32)


def _cloth(rng: np.random.Generator) -> Texture:
    return 0.30 * (1 + 0.12 * fractal(rng, 1.5, 0.4) + 0.04 * fractal(rng, 0.3))


def _macro(rng: np.random.Generator) -> Texture:
    """Stains, wear and patches that no two places share; multiplied over everything."""
    return np.asarray(np.clip(0.5 * (1 + 0.12 * fractal(rng, 1.1)), 0.3, 0.75))


_MAKERS: dict[str, Callable[[np.random.Generator], Texture]] = {
    "macro": _macro,
    "asphalt": _asphalt,
    "worn_asphalt": _worn_asphalt,
    "cobble": _cobble,
    "slabs": _slabs,
    "grass": _grass,
    "gravel": _gravel,
    "leaves": _leaves,
    "foliage": _foliage,
    "bark": _bark,
    "birch": _birch,
    "plaster": _plaster,
    "brick": _brick,
    "planks": _planks,
    "concrete": _concrete,
    "paint": _paint,
    "enamel": _enamel,
    "metal": _metal,
    "glass": _glass,
    "marking": _marking,
    "roof": _roof,
    "sign": _sign,
    "poster": _poster,
    "window": _window,
    "cloth": _cloth,
}
TILES: dict[str, int] = {name: index for index, name in enumerate(_MAKERS)}


@dataclass(frozen=True, slots=True)
class Atlas:
    """All tiles at all mipmap levels in one picture, albedo x 40000 as uint16.

    `corner_px` is `(levels, tiles, 2)`: column and row of texel (0, 0) of each.
    """

    pixels: NDArray[np.uint16]
    corner_px: Floats32

    def sample(self, tile: NDArray[np.uint8], uv: Floats32, footprint_tiles: Floats32) -> Floats32:
        """Albedo `(n,)` at coordinates `(n, 2)`; `footprint_tiles` is a pixel's width in tiles."""
        texels = np.clip(footprint_tiles * np.float32(TILE_PX * 1.41421), 1.0, 2.0 ** (LEVELS - 1))
        # the binary exponent is the mipmap level, rounded by the factor above
        level = np.right_shift(texels.view(np.int32), 23) - 127
        np.minimum(level, LEVELS - 1, out=level)
        place = uv - np.floor(uv)
        place *= np.take(_SIZES, level)[:, None]
        place += self.corner_px.reshape(-1, 2)[level * len(TILES) + tile]
        return self._read(place)

    def sample_one(self, tile: int, uv: Floats32, level: int = 0) -> Floats32:
        """Albedo `(n,)` of one tile at one mipmap level."""
        place = uv - np.floor(uv)
        place *= _SIZES[level]
        place += self.corner_px[level, tile]
        return self._read(place)

    def _read(self, place: Floats32) -> Floats32:
        return read_picture(self.pixels, place) * np.float32(1 / 40000)


_SIZES = np.ldexp(np.float32(TILE_PX), -np.arange(LEVELS)).astype(np.float32)


def read_picture(picture: NDArray[np.generic], place_px: Floats32, **how: object) -> Floats32:
    """A picture's values `(n,)` at places `(n, 2)` (column, row), bilinear unless told."""
    # cv2.remap wants a request in the shape of a picture below 32768 rows
    count = len(place_px)
    if count == 0:
        return np.empty(0, dtype=np.float32)
    columns = 256
    rows = -(-count // columns)
    request = place_px
    if rows * columns != count:
        request = np.zeros((rows * columns, 2), dtype=np.float32)
        request[:count] = place_px
    options: dict[str, object] = {"interpolation": cv2.INTER_LINEAR} | how
    found = cv2.remap(picture, request.reshape(rows, columns, 2), None, **options)  # type: ignore[call-overload]
    return np.asarray(found.reshape(-1)[:count], dtype=np.float32)


def make_atlas(seed: int) -> Atlas:
    """Draws every tile (each from its own stream of `seed`) and packs them."""
    strip = TILE_PX + 2 * _PAD
    count = len(_MAKERS)
    per_row = 6
    rows = -(-count // per_row)
    widths = [(TILE_PX >> level) + 2 * _PAD for level in range(LEVELS)]
    pixels = np.zeros((rows * strip, per_row * sum(widths)), dtype=np.uint16)
    corners = np.zeros((LEVELS, count, 2), dtype=np.float32)
    for index, maker in enumerate(_MAKERS.values()):
        tile = maker(np.random.default_rng([seed, 7001, index])).astype(np.float32)
        row, column = divmod(index, per_row)
        x, y = column * sum(widths), row * strip
        for level, width in enumerate(widths):
            framed = cv2.copyMakeBorder(tile, _PAD, _PAD, _PAD, _PAD, cv2.BORDER_WRAP)
            block = np.clip(framed * 40000, 400, 65000).astype(np.uint16)
            pixels[y : y + width, x : x + width] = block
            corners[level, index] = (x + _PAD - 0.5, y + _PAD - 0.5)
            x += width
            half = cv2.resize(tile, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            tile = np.asarray(half, dtype=np.float32)
    return Atlas(pixels, corners)
