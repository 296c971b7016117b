"""Grey pictures out of messages: raw encodings of ROS and Foxglove, JPEG and PNG."""

from __future__ import annotations

import base64
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.images import decode_grey
from polemap.drivelog.samples import Image

_GREY8, _GREY16 = ("mono8", "8uc1"), ("mono16", "16uc1")
# channels, and what makes them grey
_COLOURS: dict[str, tuple[int, int]] = {
    "bgr8": (3, cv2.COLOR_BGR2GRAY),
    "8uc3": (3, cv2.COLOR_BGR2GRAY),
    "rgb8": (3, cv2.COLOR_RGB2GRAY),
    "bgra8": (4, cv2.COLOR_BGRA2GRAY),
    "8uc4": (4, cv2.COLOR_BGRA2GRAY),
    "rgba8": (4, cv2.COLOR_RGBA2GRAY),
    "bgr16": (3, cv2.COLOR_BGR2GRAY),
    "rgb16": (3, cv2.COLOR_RGB2GRAY),
    "bgra16": (4, cv2.COLOR_BGRA2GRAY),
    "rgba16": (4, cv2.COLOR_RGBA2GRAY),
    # two bytes a pixel, the brightness being one of them
    "yuv422": (2, cv2.COLOR_YUV2GRAY_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2GRAY_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2GRAY_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2GRAY_YUY2),
}
# ROS names the first two pixels of the first row, OpenCV the second two of the second
_BAYER: dict[str, int] = {
    "bayer_rggb": cv2.COLOR_BayerBG2GRAY,
    "bayer_bggr": cv2.COLOR_BayerRG2GRAY,
    "bayer_gbrg": cv2.COLOR_BayerGR2GRAY,
    "bayer_grbg": cv2.COLOR_BayerGB2GRAY,
}
_VIDEO = ("h264", "h265", "hevc", "av1", "vp9")


def encoding_of(message: Any) -> str:
    """What a picture's message says of its pixels: `mono8`, `jpeg` and so on."""
    if hasattr(message, "encoding"):
        return str(message.encoding)
    return str(getattr(message, "format", ""))


def grey(message: Any, place: str) -> Image:
    """The grey picture `(height, width)` of a message, 8 or 16 bit.

    Args:
        message: `Image`, `RawImage` or `CompressedImage`.
        place: how errors name it.

    Raises:
        InputError: an encoding that is unknown, too few bytes, or a damaged JPEG or PNG.
    """
    data = message.data
    if isinstance(data, str):  # JSON
        data = base64.b64decode(data, validate=True)
    if not hasattr(message, "encoding"):
        return _compressed(bytes(data), str(message.format), place)
    return _raw(message, data, place)


def _compressed(data: bytes, form: str, place: str) -> Image:
    if any(name in form.lower() for name in _VIDEO):
        raise InputError(f"{place}: a frame of {form[:20]} video; only single pictures can be read")
    if "compresseddepth" in form.lower():
        raise InputError(f"{place}: a depth picture ({form[:40]}), not one of a camera")
    return decode_grey(data, place)


def _raw(message: Any, data: Any, place: str) -> Image:
    name = str(message.encoding).lower()
    width, height, step = int(message.width), int(message.height), int(message.step)
    bayer = next((start for start in _BAYER if name.startswith(start)), None)
    if name in _GREY8 or name in _GREY16:
        channels = 1
    elif name in _COLOURS:
        channels = _COLOURS[name][0]
    elif bayer is not None and name in (f"{bayer}8", f"{bayer}16"):
        channels = 1
    else:
        raise InputError(
            f"{place}: pixels are '{name[:30]}'; known are mono8, mono16, bgr8, rgb8, bgra8, "
            "rgba8, their 16-bit kinds, bayer_* and yuv422"
        )
    deep = name.endswith("16") or name in _GREY16
    pixels = _pixels(message, data, (width, height, step, channels, deep), place)
    if bayer is not None:
        return cast(Image, cv2.cvtColor(pixels, _BAYER[bayer]))
    if name in _COLOURS:
        return cast(Image, cv2.cvtColor(pixels, _COLOURS[name][1]))
    return cast(Image, pixels)


def _pixels(
    message: Any, data: Any, layout: tuple[int, int, int, int, bool], place: str
) -> NDArray[Any]:
    """Pixels `(height, width[, channels])`, contiguous, in the machine's order of bytes."""
    width, height, step, channels, deep = layout
    row = width * channels * (2 if deep else 1)
    flat = np.frombuffer(data, dtype=np.uint8)
    if width < 1 or height < 1 or step < row or len(flat) < (height - 1) * step + row:
        raise InputError(
            f"{place}: {width}x{height} pixels of {message.encoding} in rows of {step} bytes do "
            f"not fit its {len(flat)} bytes"
        )
    short = height * step - len(flat)
    if short > 0:  # the last row may come without its padding
        flat = np.concatenate([flat, np.zeros(short, dtype=np.uint8)])
    rows = flat[: height * step].reshape(height, step)[:, :row]
    pixels = np.ascontiguousarray(rows)
    if deep:
        big = bool(getattr(message, "is_bigendian", False))
        pixels = np.ascontiguousarray(pixels.view(">u2" if big else "<u2").astype(np.uint16))
    return pixels.reshape(height, width, channels) if channels > 1 else pixels
