"""The tiles of all materials with their mipmaps, packed into one picture and read from it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.simulate.materials import MAKERS, TILES
from polemap.simulate.patterns import TILE_PX

Floats32 = NDArray[np.float32]

LEVELS = 8
_PAD = 2
_PER_ALBEDO = 40000  # of the 65535 that a texel can hold


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
        return read_picture(self.pixels, place) * np.float32(1 / _PER_ALBEDO)


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
    count = len(MAKERS)
    per_row = 6
    rows = -(-count // per_row)
    widths = [(TILE_PX >> level) + 2 * _PAD for level in range(LEVELS)]
    pixels = np.zeros((rows * strip, per_row * sum(widths)), dtype=np.uint16)
    corners = np.zeros((LEVELS, count, 2), dtype=np.float32)
    for index, maker in enumerate(MAKERS.values()):
        tile = maker(np.random.default_rng([seed, 7001, index])).astype(np.float32)
        row, column = divmod(index, per_row)
        x, y = column * sum(widths), row * strip
        for level, width in enumerate(widths):
            framed = cv2.copyMakeBorder(tile, _PAD, _PAD, _PAD, _PAD, cv2.BORDER_WRAP)
            block = np.clip(framed * _PER_ALBEDO, 400, 65000).astype(np.uint16)
            pixels[y : y + width, x : x + width] = block
            corners[level, index] = (x + _PAD - 0.5, y + _PAD - 0.5)
            x += width
            half = cv2.resize(tile, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            tile = np.asarray(half, dtype=np.float32)
    return Atlas(pixels, corners)
