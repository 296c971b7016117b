"""Calibration files of every kind, written by their own libraries where there is one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from polemap.stereo.calibration import StereoCalibration
from polemap.stereo.calibration_trees import Stated
from polemap.stereo.errors import StereoError
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


@pytest.mark.parametrize("ending", ["yml", "xml", "json"])
def test_arrays_of_one_dimension(tmp_path: Path, ending: str) -> None:
    calibration = make_calibration()
    values = opencv_values(calibration)
    flat = {name: np.ravel(values[name]) for name in ("D1", "D2", "T")}
    assert_same(
        read_calibration(write_opencv(tmp_path / f"c.{ending}", values | flat)), calibration
    )


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


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("M1", lambda m: np.diag([1.0, 0.01, 1.0]) @ m, "no pixel is so far from square"),
        ("D1", lambda d: np.array([-3000.0, 1e8, 0.0, 0.0, 0.0]), "fold or tear the picture"),
        ("D2", lambda d: np.array([0.1, 0.0, 0.0, 0.0, -1e6]), "fold or tear the picture"),
    ],
)
def test_what_no_lens_does_is_refused(
    tmp_path: Path, name: str, change: Callable[[np.ndarray], np.ndarray], message: str
) -> None:
    values = opencv_values(make_calibration())
    values[name] = change(np.asarray(values[name], dtype=np.float64))
    if name == "M1":
        values[name][1, 2] = 100.0
    with pytest.raises(StereoError, match=message):
        read_calibration(write_opencv(tmp_path / "c.yml", values))


@pytest.mark.parametrize("put", ["[true, 500, 160, 120]", "[no, 500, 160, 120]"])
def test_truths_are_no_numbers(tmp_path: Path, put: str) -> None:
    path = write_kalibr(tmp_path / "chain.yaml", make_calibration())
    tree = yaml.safe_load(path.read_text())
    tree["cam0"]["intrinsics"] = yaml.safe_load(put)
    path.write_text(yaml.safe_dump(tree))
    with pytest.raises(StereoError, match=r"'cam0\.intrinsics' holds no numbers"):
        read_calibration(path)
