"""Eight, ten, twelve, fourteen and sixteen bits, in PNG, TIFF, PGM and JPEG."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.images import ImagePairs
from polemap.parsing.pictures import stated_bits

SIZE = (64, 48)


def ramp(bits: int) -> np.ndarray:
    top = (1 << bits) - 1
    return np.linspace(0, top, 48 * 64).reshape(48, 64).astype(np.uint16 if bits > 8 else np.uint8)


def pair(tmp_path: Path, image: np.ndarray, ending: str = ".png") -> tuple[tuple[Path, Path], ...]:
    paths = (tmp_path / f"l{ending}", tmp_path / f"r{ending}")
    for path in paths:
        assert cv2.imwrite(str(path), image)
    return (paths,)


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
@pytest.mark.parametrize("ending", [".png", ".tiff"])
def test_stated_bits_become_twelve(tmp_path: Path, bits: int, ending: str) -> None:
    left, right = ImagePairs(pair(tmp_path, ramp(bits), ending), SIZE, bits).load(0)
    assert left.dtype == np.uint16
    assert int(left.max()) == 4095 >> max(0, 12 - bits) << max(0, 12 - bits)
    np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("ending", [".png", ".jpg", ".pgm", ".tif"])
def test_eight_bits_stay_and_colour_becomes_grey(tmp_path: Path, ending: str) -> None:
    grey = ramp(8)
    left, _ = ImagePairs(pair(tmp_path, np.dstack([grey] * 3), ".png"), SIZE).load(0)
    np.testing.assert_array_equal(left, grey)
    left, _ = ImagePairs(pair(tmp_path, grey, ending), SIZE, 8).load(0)
    assert left.dtype == np.uint8
    np.testing.assert_allclose(left, grey, atol=3)


def test_twelve_bits_at_the_top_of_sixteen_are_seen(tmp_path: Path) -> None:
    left, _ = ImagePairs(pair(tmp_path, ramp(12) << 4), SIZE).load(0)
    np.testing.assert_array_equal(left, ramp(12))
    left, _ = ImagePairs(pair(tmp_path, ramp(16)), SIZE).load(0)
    np.testing.assert_array_equal(left, ramp(16))


def test_a_pgm_says_how_many_bits_it_fills(tmp_path: Path) -> None:
    data = b"P5\n# a camera\n64 48\n1023\n" + ramp(10).astype(">u2").tobytes()
    assert stated_bits(data) == 10
    assert stated_bits(b"P5 64 48 65535 ") is None
    assert stated_bits(b"P5 64 48") is None
    for name in ("l.pgm", "r.pgm"):
        (tmp_path / name).write_bytes(data)
    left, _ = ImagePairs(((tmp_path / "l.pgm", tmp_path / "r.pgm"),), SIZE).load(0)
    np.testing.assert_array_equal(left, ramp(10) << 2)


def test_more_than_the_stated_bits_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="grey value 4095, more than the 10 bits"):
        ImagePairs(pair(tmp_path, ramp(12)), SIZE, 10).load(0)
