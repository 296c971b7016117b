"""Grey pictures out of every encoding that recorders write."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.bags.pictures import grey

HEIGHT, WIDTH = 6, 8


def raw(pixels: np.ndarray, encoding: str, padding: int = 0, big: bool = False) -> Any:
    """An Image message with `padding` bytes behind every row."""
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    rows = np.hstack([rows, np.full((len(rows), padding), 77, dtype=np.uint8)])
    return SimpleNamespace(
        height=pixels.shape[0], width=pixels.shape[1], encoding=encoding, is_bigendian=big,
        step=rows.shape[1], data=rows.ravel(),
    )  # fmt: skip


def noise(*shape: int, dtype: type = np.uint8) -> np.ndarray:
    return np.random.default_rng(4).integers(0, np.iinfo(dtype).max, shape).astype(dtype)


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("name", ["mono8", "8UC1"])
def test_grey_pixels_are_taken_as_they_are(name: str, padding: int) -> None:
    pixels = noise(HEIGHT, WIDTH)
    np.testing.assert_array_equal(grey(raw(pixels, name, padding), "x"), pixels)


@pytest.mark.parametrize("big", [False, True])
def test_sixteen_bits_come_in_either_order(big: bool) -> None:
    pixels = noise(HEIGHT, WIDTH, dtype=np.uint16)
    stored = pixels.astype(">u2" if big else "<u2")
    found = grey(raw(stored, "mono16", 2, big), "x")
    np.testing.assert_array_equal(found, pixels)
    assert found.dtype == np.uint16


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("bgr8", cv2.COLOR_BGR2GRAY),
        ("rgb8", cv2.COLOR_RGB2GRAY),
        ("bgra8", cv2.COLOR_BGRA2GRAY),
        ("rgba8", cv2.COLOR_RGBA2GRAY),
    ],
)
def test_colours_become_grey_by_their_own_order(name: str, code: int) -> None:
    pixels = noise(HEIGHT, WIDTH, 4 if "a" in name else 3)
    np.testing.assert_array_equal(grey(raw(pixels, name, 5), "x"), cv2.cvtColor(pixels, code))


@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_bayer_pattern_is_that_of_its_first_two_rows(order: str) -> None:
    """Red areas are as bright as red is, whatever colour the first pixel has."""
    levels = {"r": 200, "g": 40, "b": 120}
    tile = np.array([levels[letter] for letter in order], dtype=np.uint8).reshape(2, 2)
    found = grey(raw(np.tile(tile, (8, 8)), f"bayer_{order}8"), "x")
    colour = np.array([[[levels["b"], levels["g"], levels["r"]]]], dtype=np.uint8)
    wanted = int(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)[0, 0])
    assert np.abs(found[3:-3, 3:-3].astype(int) - wanted).max() <= 1


def test_yuv_has_the_brightness_in_every_second_byte() -> None:
    pixels = noise(HEIGHT, WIDTH, 2)
    np.testing.assert_array_equal(grey(raw(pixels, "yuv422"), "x"), pixels[:, :, 1])
    np.testing.assert_array_equal(grey(raw(pixels, "yuv422_yuy2"), "x"), pixels[:, :, 0])


@pytest.mark.parametrize("form", ["png", "jpg"])
def test_compressed_pictures_are_decoded(form: str) -> None:
    pixels = cv2.GaussianBlur(noise(48, 64), (0, 0), 8)
    message = SimpleNamespace(format=f"mono8; {form} compressed", data=b"")
    message.data = cv2.imencode(f".{form}", pixels)[1].tobytes()
    found = grey(message, "x").astype(int)
    assert np.abs(found - pixels).max() <= (0 if form == "png" else 12)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"encoding": "mystery9"}, "pixels are 'mystery9'"),
        ({"step": 4}, "do not fit"),
        ({"data": np.zeros(7, dtype=np.uint8)}, "do not fit its 7 bytes"),
        ({"width": 0}, "do not fit"),
        ({"height": 60000}, "do not fit"),
    ],
)
def test_pixels_that_cannot_be_are_told(change: dict[str, Any], reason: str) -> None:
    message = raw(noise(HEIGHT, WIDTH), "mono8")
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(InputError, match=reason):
        grey(message, "/left, picture 3")


@pytest.mark.parametrize(
    ("form", "data", "reason"),
    [
        ("h264", b"", "only single pictures"),
        ("16UC1; compressedDepth", b"", "depth picture"),
        ("jpeg", b"\xff\xd8\xff\xe0", "cut off"),
        ("png", b"nothing", "not an image that is read here"),
    ],
)
def test_what_is_no_picture_is_told(form: str, data: bytes, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        grey(SimpleNamespace(format=form, data=data), "/left, picture 3")
