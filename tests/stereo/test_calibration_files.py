"""Calibration files of every kind, written by their own libraries where there is one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polemap.stereo.calibration import StereoCalibration
from polemap.stereo.calibration_trees import Stated
from polemap.stereo.io import read_calibration
from polemap.stereo.rectify import rectification_of
from tests.stereo.calibrations import (
    WRITERS,
    make_calibration,
    opencv_values,
    write_kalibr,
    write_kitti,
    write_opencv,
)


def assert_same(one: StereoCalibration, other: StereoCalibration) -> None:
    np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-9)
    np.testing.assert_allclose(one.translation_m, other.translation_m, atol=1e-9)
    for a, b in ((one.left, other.left), (one.right, other.right)):
        np.testing.assert_allclose(a.matrix, b.matrix, atol=1e-9)
        count = min(len(a.coefficients), len(b.coefficients))
        np.testing.assert_allclose(a.coefficients[:count], b.coefficients[:count], atol=1e-9)
        assert (a.width_px, a.height_px, a.distortion) == (b.width_px, b.height_px, b.distortion)


@pytest.mark.parametrize("kind", list(WRITERS))
@pytest.mark.parametrize("lens", ["plumb_bob", "rational_polynomial"])
def test_a_file_gives_back_what_was_written(tmp_path: Path, kind: str, lens: str) -> None:
    calibration = make_calibration(lens)
    again = read_calibration(WRITERS[kind](tmp_path, calibration))
    assert_same(again, calibration)
    ours, given = rectification_of(calibration), again.rectification
    assert given is not None
    np.testing.assert_allclose(given.left, ours.left, atol=1e-9)
    assert given.focal_px == pytest.approx(ours.focal_px)


@pytest.mark.parametrize("lens", ["plumb_bob", "equidistant"])
def test_a_kalibr_camchain(tmp_path: Path, lens: str) -> None:
    calibration = make_calibration(lens)
    path = write_kalibr(tmp_path / "chain.yaml", calibration)
    assert_same(read_calibration(path), calibration)
    with pytest.raises(Exception, match="cam1, cam0: the right camera stands at"):
        read_calibration(path, Stated(cameras=("cam1", "cam0")))


def test_kittis_own_file(tmp_path: Path) -> None:
    calibration = make_calibration()
    again = read_calibration(write_kitti(tmp_path / "calib_cam_to_cam.txt", calibration))
    assert_same(again, calibration)
    assert again.rectification is not None


def test_opencvs_samples_write_two_files_without_a_size(tmp_path: Path) -> None:
    calibration = make_calibration()
    values = opencv_values(calibration)
    one = write_opencv(
        tmp_path / "intrinsics.yml", {k: values[k] for k in ("M1", "D1", "M2", "D2")}
    )
    two = write_opencv(tmp_path / "extrinsics.yml", {k: values[k] for k in ("R", "T")})
    again = read_calibration([one, two], Stated(size_px=(320, 240)))
    assert_same(again, calibration)
    with pytest.raises(Exception, match="has no 'image_width'"):
        read_calibration([one, two])


def test_a_measured_baseline_stands_for_a_translation_in_squares(tmp_path: Path) -> None:
    calibration = make_calibration()
    values = opencv_values(calibration)
    values["T"] = 1000.0 * values["T"]
    path = write_opencv(tmp_path / "c.yml", values)
    with pytest.raises(
        Exception, match="seems to be in millimetres; correct it, or state baseline_m"
    ):
        read_calibration(path)
    baseline = calibration.baseline_m
    assert_same(read_calibration(path, Stated(baseline_m=baseline)), calibration)
