"""`polemap disparity`: files of the KITTI convention, and one clear line for bad input."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from polemap.drivelog.errors import ConfigError
from polemap.stereo.config import StereoConfig
from polemap.tools.cli import run
from polemap.tools.disparity import colour_picture, encode, fitting_settings


def write_pair(folder, dtype, top, shift=9, colour=False):
    rng = np.random.default_rng(3)
    wide = cv2.GaussianBlur(rng.uniform(0, top, (60, 160)), (3, 3), 0).astype(dtype)
    for name, image in (("l.png", wide[:, :140]), ("r.png", wide[:, shift : shift + 140])):
        cv2.imwrite(str(folder / name), cv2.merge([image] * 3) if colour else image)
    return str(folder / "l.png"), str(folder / "r.png")


@pytest.mark.parametrize(
    ("dtype", "top", "colour"),
    [
        (np.uint8, 255, False),
        (np.uint8, 255, True),
        (np.uint16, 4095, False),
        (np.uint16, 65535, False),
        (np.uint16, 65535, True),
    ],
)
@pytest.mark.parametrize("matcher", ["census_sgm", "opencv_sgbm"])
def test_every_kind_of_pair_is_matched(tmp_path, dtype, top, colour, matcher):
    left, right = write_pair(tmp_path, dtype, top, colour=colour)
    out, right_out = tmp_path / "d.png", tmp_path / "r" / "d.png"
    arguments = ["disparity", left, right, "--out", str(out), "--right-out", str(right_out)]
    arguments += ["--max-disparity", "31", "--matcher", matcher]
    arguments += ["--picture", str(tmp_path / "c.png")]
    assert run(arguments) == 0
    for path in (out, right_out):
        disparity = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert disparity.dtype == np.uint16
        inner = disparity[10:-10, 30:-30] / 256
        assert (inner > 0).mean() > 0.9
        assert np.median(np.abs(inner[inner > 0] - 9)) < 0.1
    assert cv2.imread(str(tmp_path / "c.png")).shape == (60, 140, 3)


def test_bad_input_is_one_line_and_leaves_nothing(tmp_path, capsys):
    left, right = write_pair(tmp_path, np.uint8, 255)
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((60, 100), np.uint8))
    broken = tmp_path / "broken.png"
    broken.write_bytes((tmp_path / "l.png").read_bytes()[:200])
    out = tmp_path / "d.png"
    for arguments, text in (
        ([left, str(tmp_path / "no.png")], "no.png"),
        ([left, str(small)], "differ"),
        ([left, str(broken)], "truncated"),
        ([left, right, "--max-disparity", "0"], "--max-disparity 0"),
        ([left, right, "--max-disparity", "300"], "--max-disparity 300"),
        ([left, right, "--matcher", "magic"], "magic"),
        ([left, right, "--set", "stereo.penalties.p1=60"], "p1 <= p2_min"),
    ):
        assert run(["disparity", *arguments, "--out", str(out)]) == 2
        lines = capsys.readouterr().err.strip().splitlines()
        assert len(lines) == 1
        assert text in lines[0]
        assert not out.exists()
    assert run(["disparity", left, right, "--out", str(tmp_path / "d.tif")]) == 2
    assert "PNG" in capsys.readouterr().err


def test_the_encoding_keeps_small_values_and_refuses_large_ones():
    disparity = np.array([[np.nan, 0.0, 0.5, 255.9]], dtype=np.float32)
    assert encode(disparity).tolist() == [[0, 1, 128, 65510]]
    with pytest.raises(ConfigError, match="does not fit"):
        encode(np.array([[256.5]], dtype=np.float32))


def test_the_search_covers_the_largest_disparity():
    images = (np.zeros((2, 2), np.uint16), np.full((2, 2), 40000, np.uint16))
    settings = fitting_settings(StereoConfig(min_disparity_px=8), images, 64)
    assert settings.min_disparity_px + settings.disparities > 64
    assert settings.uint16_bits == 16
    assert fitting_settings(StereoConfig(), images, 256).disparities == 256


def test_colours_tell_near_from_far():
    picture = colour_picture(np.array([[np.nan, 2.0, 60.0]], dtype=np.float32), 64)
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert picture[0, 1, 0] > picture[0, 1, 2]
    assert picture[0, 2, 2] > picture[0, 2, 0]
