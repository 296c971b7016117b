"""Census and rank transforms in plain numpy: the order of grey values instead of the values.

Both forget gain, offset and every other monotonic change of brightness, which the two cameras of
a rig never share exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.config import Census
from polemap.stereo.matching_types import Image

Bytes = NDArray[np.uint8]


# The tall census: the nearest neighbours and what reaches up and down, found by exchanging single
# pairs of a 9 x 3 to 11 x 5 window as long as KITTI 2015 (every second pair), Middlebury and three
# rendered streets together improved.
_TALL = (
    (-4, -2, 0, 0),
    (-3, 0, 0, 0),
    (-2, 1, 0, 0),
    (-1, -1, 0, 0),
    (-1, 0, 0, 0),
    (0, -2, 0, 0),
    (0, -1, 0, 0),
    (0, 2, 0, 0),
    (0, 3, 0, 0),
    (1, -1, 0, 0),
    (1, 0, 0, 0),
    (3, 0, 0, 0),
    (-4, 0, 4, 0),
    (-4, 1, 4, -1),
    (-3, 0, 3, 0),
    (-2, 0, 2, 0),
    (0, -2, 0, 2),
    (-3, -1, -3, 0),
    (-2, -2, -1, -1),
    (-2, 0, 1, -1),
    (-1, -1, 1, -1),
    (0, -2, 1, -1),
    (2, 0, 2, 2),
    (4, -2, 4, -1),
)


def neighbour_offsets(radius_px: int) -> list[tuple[int, int]]:
    """The `(dv, du)` of a square window without its centre, row by row."""
    span = range(-radius_px, radius_px + 1)
    return [(dv, du) for dv in span for du in span if (dv, du) != (0, 0)]


def _neighbours(image: Image, radius_px: int) -> Iterator[NDArray[np.bool_]]:
    """For each offset, where the neighbour is darker than the centre; edges are repeated."""
    height, width = image.shape
    padded: NDArray[Any] = np.pad(image, radius_px, mode="edge")
    for dv, du in neighbour_offsets(radius_px):
        v, u = radius_px + dv, radius_px + du
        yield np.less(padded[v : v + height, u : u + width], image)


def census_pairs(kind: Census) -> list[tuple[int, int, int, int]]:
    """The 24 pairs of pixels that a census compares, as `(dv, du, dv, du)` from its pixel.

    Source: Zabih and Woodfill, ECCV 1994 (neighbours against the centre); Spangenberg et al., CAIP
    2013 (pairs symmetric about the centre, which no single noisy pixel can spoil).
    """
    if kind == "tall":
        return list(_TALL)
    if kind == "centre5x5":
        return [(dv, du, 0, 0) for dv, du in neighbour_offsets(2)]
    return [(dv, du, -dv, -du) for dv, du in neighbour_offsets(3)[:24]]


def census_planes(image: Image, kind: Census = "centre5x5") -> Bytes:
    """The census of a grey image as three bytes a pixel.

    Bit k is set where the first pixel of pair k is darker than the second; plane j holds the bits
    8j to 8j + 7. Outside the image the nearest pixel counts.

    Args:
        image: `(height, width)`, 8 or 16 bit.
        kind: which pairs are compared.

    Returns:
        `(3, height, width)` uint8.
    """
    height, width = image.shape
    reach = 5
    padded: NDArray[Any] = np.pad(image, reach, mode="edge")

    def moved(dv: int, du: int) -> NDArray[Any]:
        return padded[reach + dv : reach + dv + height, reach + du : reach + du + width]

    planes = np.zeros((3, height, width), dtype=np.uint8)
    for bit, (dv, du, other_dv, other_du) in enumerate(census_pairs(kind)):
        darker = np.less(moved(dv, du), moved(other_dv, other_du))
        planes[bit // 8] |= darker.astype(np.uint8) << np.uint8(bit % 8)
    return planes


def rank_transform(image: Image, radius_px: int) -> Bytes:
    """How many of the neighbours are darker than the centre, spread over 0 ... 255.

    Args:
        image: `(height, width)`, 8 or 16 bit.
        radius_px: 1 to 7; 3 is the 7x7 window.

    Returns:
        `(height, width)` uint8.
    """
    count = np.zeros(image.shape, dtype=np.uint16)
    for darker in _neighbours(image, radius_px):
        count += darker
    neighbours = (2 * radius_px + 1) ** 2 - 1
    return np.asarray(count * 255 // neighbours, dtype=np.uint8)


def partial_ranks(image: Image) -> Bytes:
    """Three ranks a pixel over the upper, middle and lower third of a 7x7 window.

    A single rank forgets where the darker neighbours are; three keep their height.

    Returns:
        `(height, width, 3)` uint8, each channel spread over 0 ... 255.
    """
    counts = np.zeros((*image.shape, 3), dtype=np.uint16)
    sizes = [0, 0, 0]
    for (dv, _), darker in zip(neighbour_offsets(3), _neighbours(image, 3), strict=True):
        third = 0 if dv < -1 else (2 if dv > 1 else 1)
        counts[..., third] += darker
        sizes[third] += 1
    return np.asarray(counts * 255 // np.array(sizes, dtype=np.uint16), dtype=np.uint8)
