"""Grey images from the disk; a damaged PNG is an error, not a picture with a grey half."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.samples import Image
from polemap.stereo.rig import StereoRig

_PNG = b"\x89PNG\r\n\x1a\n"


def _check_png(data: bytes, path: Path) -> None:
    """Walk the chunks: decoders fill in for what is missing, and only say so on stderr."""
    at = len(_PNG)
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        end = at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise InputError(f"{path}: damaged PNG (checksum at byte {at}); restore the file")
        if data[at + 4 : at + 8] == b"IEND":
            return
        at = end
    raise InputError(f"{path}: truncated PNG ({len(data)} bytes, no end); restore the file")


def read_grey(path: Path) -> Image:
    """A grey image `(height, width)`, 8 or 16 bit; colour is turned to grey.

    Raises:
        InputError: missing, truncated, damaged, or no image.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: image cannot be read ({error.strerror})") from error
    if data.startswith(_PNG):
        _check_png(data, path)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if image is None:
        raise InputError(f"{path}: not an image that can be decoded ({len(data)} bytes)")
    if image.ndim == 3 and image.shape[2] in (3, 4):
        code = cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
        image = np.asarray(cv2.cvtColor(image, code))
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: {image.dtype} {image.shape} is not a grey image of 8 or 16 bit")
    return cast(Image, np.ascontiguousarray(image))


@dataclass(frozen=True, slots=True)
class ImagePairs:
    """Pairs of image files, checked against the camera when they are read."""

    paths: tuple[tuple[Path, Path], ...]
    rig: StereoRig

    def load(self, row: int) -> tuple[Image, Image]:
        left, right = (read_grey(path) for path in self.paths[row])
        for image, path in zip((left, right), self.paths[row], strict=True):
            if image.shape != (self.rig.height_px, self.rig.width_px):
                raise InputError(
                    f"{path}: {image.shape[1]}x{image.shape[0]} pixels, but the camera of the "
                    f"drive has {self.rig.width_px}x{self.rig.height_px}"
                )
        if left.dtype != right.dtype:
            raise InputError(
                f"{self.paths[row][1]}: {right.dtype} pixels, but the left image has {left.dtype}"
            )
        return left, right

    def keep(self, rows: NDArray[np.int64]) -> ImagePairs:
        return ImagePairs(tuple(self.paths[int(row)] for row in rows), self.rig)

    def check_exist(self) -> None:
        """Every file is there.

        Raises:
            InputError: the first that is not.
        """
        for pair in self.paths:
            for path in pair:
                if not path.is_file():
                    raise InputError(f"{path}: image is missing, but the drive lists it")
