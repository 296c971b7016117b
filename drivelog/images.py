"""Grey images from the disk; a damaged PNG is an error, not a picture with a grey half."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import FrameSource
from polemap.drivelog.errors import InputError
from polemap.drivelog.pixel_depth import of_bits, same_depth
from polemap.drivelog.samples import Image
from polemap.parsing.errors import named, short
from polemap.parsing.pictures import check_size, stated_bits
from polemap.parsing.text import MEGABYTE, read_bytes
from polemap.stereo.errors import StereoError
from polemap.stereo.rectify import Rectifier

LARGEST_BYTES = 300 * MEGABYTE
_PNG = b"\x89PNG\r\n\x1a\n"


def _check_png(data: bytes, path: Path | str) -> None:
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


def read_grey(path: Path, size: tuple[int, int] | None = None) -> Image:
    """A grey image `(height, width)`, 8 or 16 bit; colour is turned to grey.

    Args:
        path: the file.
        size: width and height that it must have.

    Raises:
        InputError: missing, truncated, damaged, or no image.
    """
    with named(path, InputError, "image"):
        data = read_bytes(path, LARGEST_BYTES)
    return decode_grey(data, path, size)


def decode_grey(data: bytes, path: Path | str, size: tuple[int, int] | None = None) -> Image:
    """A grey image `(height, width)`, 8 or 16 bit, from the bytes of a file.

    Args:
        data: PNG, JPEG or what else OpenCV decodes.
        path: the file or place that errors name.
        size: width and height that it must have.

    Raises:
        InputError: truncated, damaged, or no image.
    """
    with named(path, InputError, "image"):
        if data.startswith(_PNG):
            _check_png(data, path)
        width, height = check_size(data)
    if size is not None and (width, height) != size:
        raise InputError(
            f"{path}: {width}x{height} pixels, but the camera of the drive has {size[0]}x{size[1]}"
        )
    # what the decoders print is one line of ours below
    log: Any = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except (cv2.error, MemoryError) as error:
        raise InputError(f"{path}: not an image that can be decoded ({short(error)})") from error
    finally:
        log.setLogLevel(level)
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
    """Pairs of image files, checked against the camera's size when they are read.

    Attributes:
        paths: left and right file of every row.
        size_px: width and height.
        bits: how many of a pixel the camera fills, where it is stated; a PGM says so itself.
    """

    paths: tuple[tuple[Path, Path], ...]
    size_px: tuple[int, int]
    bits: int | None = None

    def load(self, row: int) -> tuple[Image, Image]:
        """Left and right picture of a row.

        Raises:
            InputError: one cannot be read, is of another size or of another depth.
        """
        left, right = (self._read(path) for path in self.paths[row])
        if left.dtype != right.dtype:
            raise InputError(
                f"{self.paths[row][1]}: {right.dtype} pixels, but the left image has {left.dtype}"
            )
        return same_depth(left, right)

    def _read(self, path: Path) -> Image:
        with named(path, InputError, "image"):
            data = read_bytes(path, LARGEST_BYTES)
        bits = self.bits or stated_bits(data)
        image = decode_grey(data, path, self.size_px)
        return image if bits is None else of_bits(image, bits, path)

    def keep(self, rows: NDArray[np.int64]) -> ImagePairs:
        """The same source with these rows only."""
        return ImagePairs(tuple(self.paths[int(row)] for row in rows), self.size_px, self.bits)

    def check_exist(self) -> None:
        """Every file is there.

        Raises:
            InputError: the first that is not.
        """
        for pair in self.paths:
            for path in pair:
                if not path.is_file():
                    raise InputError(f"{path}: image is missing, but the drive lists it")


@dataclass(frozen=True, slots=True)
class RectifiedPairs:
    """Raw pairs of any source, rectified as they are read."""

    raw: FrameSource
    rectifier: Rectifier

    def load(self, row: int) -> tuple[Image, Image]:
        """Left and right rectified picture of a row.

        Raises:
            InputError: one cannot be read, or is of another size than the calibration.
        """
        left, right = self.raw.load(row)
        try:
            return self.rectifier.rectify(left, right)
        except StereoError as error:
            raise InputError(f"frame {row}: {error}") from error

    def keep(self, rows: NDArray[np.int64]) -> RectifiedPairs:
        """The same source with these rows only."""
        return RectifiedPairs(self.raw.keep(rows), self.rectifier)
