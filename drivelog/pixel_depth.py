"""Sixteen-bit pictures of cameras with fewer bits: brought to twelve, which the matcher expects."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polemap.drivelog.errors import InputError
from polemap.drivelog.samples import Image

BITS = 12
_LARGEST = (1 << BITS) - 1


def of_bits(image: Image, bits: int, path: Path) -> Image:
    """A picture whose values fill `bits` bits, brought to twelve.

    Raises:
        InputError: it has larger values.
    """
    top = int(image.max()) if image.size else 0
    if top >= 1 << bits:
        raise InputError(
            f"{path}: holds the grey value {top}, more than the {bits} bits that are stated: "
            "correct camera.bits in drive.yaml, or leave it out"
        )
    if image.dtype == np.uint8 or bits == BITS:
        return image
    if bits > BITS:
        return image >> np.uint16(bits - BITS)
    return image << np.uint16(BITS - bits)


def same_depth(left: Image, right: Image) -> tuple[Image, Image]:
    """A pair of twelve bits that stand at the top of sixteen (GenICam's unpacked formats), at the
    bottom; every other pair as it is."""
    pair = (left, right)
    if left.dtype != np.uint16 or max(int(image.max()) for image in pair) <= _LARGEST:
        return pair
    if any((image & np.uint16(15)).any() for image in pair):
        return pair
    return left >> np.uint16(4), right >> np.uint16(4)
