"""Plain folders of raw pairs: every kind of calibration, and every way to get one wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from polemap.drivelog.readers.registry import open_drive
from polemap.stereo.calibration import StereoCalibration
from polemap.stereo.rectify import Rectifier
from polemap.tools.cli import run
from tests.drivelog.drives import picture, png, write_small
from tests.stereo.calibrations import (
    make_calibration,
    opencv_values,
    write_kalibr,
    write_kitti,
    write_opencv,
    write_ros,
)

MOUNT = {"x_m": 1.9, "y_m": 0.1, "z_m": 1.3}


def raw_drive(root: Path, size: tuple[int, int] = (320, 240)) -> Path:
    """A drive with pictures of the size of `make_calibration`, but no camera of that kind yet."""
    drive = write_small(root / "drive", images=2)
    for number, file in enumerate(sorted(drive.glob("*/*.png"))):
        png(file, cv2.resize(picture(number), size))
    return drive


def say(drive: Path, **camera: Any) -> Path:
    head = yaml.safe_load((drive / "drive.yaml").read_text())
    head["camera"] = {"vehicle_from_camera": MOUNT, **camera}
    (drive / "drive.yaml").write_text(yaml.safe_dump(head))
    return drive


def files(drive: Path, calibration: StereoCalibration, kind: str) -> str | list[str]:
    """Writes a calibration into the drive; what `camera.calibration` says then."""
    if kind == "ros":
        return [path.name for path in write_ros(drive, calibration)]
    writers: dict[str, Callable[[Path], Path]] = {
        "calib.yml": lambda path: write_opencv(path, opencv_values(calibration)),
        "calib.xml": lambda path: write_opencv(path, opencv_values(calibration)),
        "chain.yaml": lambda path: write_kalibr(path, calibration),
        "calib_cam_to_cam.txt": lambda path: write_kitti(path, calibration),
    }
    return writers[kind](drive / kind).name


@pytest.mark.parametrize(
    "kind", ["ros", "calib.yml", "calib.xml", "chain.yaml", "calib_cam_to_cam.txt"]
)
def test_every_kind_gives_the_same_rectified_pictures(tmp_path: Path, kind: str) -> None:
    calibration = make_calibration()
    drive = raw_drive(tmp_path)
    opened = open_drive(say(drive, calibration=files(drive, calibration, kind)))
    rectifier = Rectifier(calibration)
    assert opened.rig is not None
    assert opened.rig.vehicle_from_camera.x_m == 1.9
    raw = [cv2.imread(str(drive / side / "000001.png"), 0) for side in ("left", "right")]
    expected = rectifier.rectify(raw[0], raw[1])
    frame = opened.between(100.2, 101.0).read_frame(0)
    # Kalibr's radtan has four coefficients: the fifth of 0.01 moves corners by a tenth of a pixel
    atol = 40 if kind == "chain.yaml" else 1
    np.testing.assert_allclose(frame.left, expected[0], atol=atol)
    np.testing.assert_allclose(frame.right, expected[1], atol=atol)
    assert any("rectified as they are read" in note for note in opened.notes)


def without(text: str, line: str) -> str:
    return "\n".join(part for part in text.splitlines() if not part.startswith(line)) + "\n"


def spoil(values: dict[str, Any], what: str) -> dict[str, Any]:
    """OpenCV's values with one mistake."""
    out = dict(values)
    for name in ("R1", "R2", "P1", "P2"):
        out.pop(name)
    if what == "exchanged":
        out["M1"], out["M2"], out["D1"], out["D2"] = (out[n] for n in ("M2", "M1", "D2", "D1"))
        out["R"], out["T"] = out["R"].T, -out["R"].T @ out["T"]
    elif what == "millimetres":
        out["T"] = 1000.0 * out["T"]
    elif what == "coefficients":
        out["D2"] = out["D2"][:, :3]
    elif what == "nan":
        out["D1"] = np.full((1, 5), np.nan)
    elif what == "nan rotation":
        out["R"] = np.full((3, 3), np.nan)
    elif what == "singular":
        out["M1"] = np.diag([260.0, 0.0, 1.0])
    elif what == "other size":
        out["image_width"], out["image_height"] = 640, 480
    elif what == "other matrix":
        out["M1"] = np.array([[1000.0, 0, 960], [0, 1000, 540], [0, 0, 1]])
    elif what == "no rotation":
        out["R"] = np.ones((3, 3))
    elif what == "above":
        out["T"] = np.array([[0.0], [-0.3], [0.0]])
    elif what == "rodrigues":
        out["R"] = np.array([[0.01], [0.02], [0.0]])
    elif what == "no T":
        del out["T"]
    elif what == "infinite size":
        out["image_width"] = float("inf")
    elif what == "huge size":
        out["image_width"] = 99_999_999
    return out


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("exchanged", "not to its right: exchange the cameras"),
        ("millimetres", "the calibration seems to be in millimetres; correct it, or state base"),
        ("coefficients", "camera 2: lens model plumb_bob takes 0 or 4 or 5 coefficients, not 3"),
        ("nan", "'D1' holds a value that is not finite"),
        ("nan rotation", "'R' holds a value that is not finite"),
        ("singular", "has no positive focal lengths"),
        ("other size", "320x240 pixels, but c.yml is for 640x480: calibrate for these pictures"),
        ("other matrix", "the principal point 960 px lies far outside of a width of 320"),
        ("no rotation", "the rotation between the cameras is no rotation matrix"),
        ("above", "not to its right: only pairs side by side are matched"),
        ("rodrigues", "'R' holds 3 numbers, a rotation matrix of 9 is needed"),
        ("no T", "has no 'T'"),
        ("infinite size", "the image size holds no whole numbers"),
        ("huge size", "camera 1: camera size 99999999x240 px: 33554432 pixels are the most"),
    ],
)
def test_one_line_for_every_mistake(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], what: str, message: str
) -> None:
    drive = raw_drive(tmp_path)
    write_opencv(drive / "c.yml", spoil(opencv_values(make_calibration()), what))
    say(drive, calibration="c.yml")
    code = run(["detect", str(drive), "--out", str(tmp_path / "out")])
    text = capsys.readouterr().err.strip()
    assert code == 2
    assert message in text
    assert len(text.splitlines()) == 1


def test_a_measured_baseline_and_a_stated_size_and_lens(tmp_path: Path) -> None:
    calibration = make_calibration("equidistant")
    values = opencv_values(calibration)
    for name in ("R1", "R2", "P1", "P2", "image_width", "image_height"):
        values.pop(name)
    values["T"] = 25.0 * values["T"]
    drive = raw_drive(tmp_path)
    write_opencv(drive / "c.yml", values)
    say(drive, calibration="c.yml", distortion_model="fisheye", baseline_m=0.31,
        width_px=320, height_px=240)  # fmt: skip
    rig = open_drive(drive).rig
    assert rig is not None
    assert rig.baseline_m == pytest.approx(0.31)
    assert rig.focal_px == pytest.approx(Rectifier(calibration).rig.focal_px)


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("c.yaml", "cam0: {camera_model: omni, intrinsics: [1, 2, 3, 4]}\ncam1: {T_cn_cnm1: 3}\n",
         "'cam1.T_cn_cnm1' needs 16 numbers, not 1"),
        ("c.yaml", "cam0: {camera_model: pinhole}\n", "the camchain has cam0, two are needed"),
        ("c.yaml", "a: 1\n", "is no stereo calibration of a known kind: OpenCV"),
        ("c.yaml", "[1, 2]\n", "holds no names with values"),
        ("c.xml", "<?xml version='1.0'?><!DOCTYPE a [<!ENTITY b 'c'>]><a/>", "XML with decl"),
        ("c.xml", "<?xml version='1.0'?><a><b></a>", "not XML"),
        ("c.yml", "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
         "   data: [1, 2]\n", "matrix M1 is 3x3, but holds 2"),
        ("c.yml", "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 1\n   cols: 1\n   data: [x]\n",
         "matrix M1 cannot be read"),
        ("c.yaml", "image_width: 320\nprojection_matrix: {data: [1]}\n",
         "is the CameraInfo of one camera: name both files"),
        ("c.yaml", "", "holds no names with values"),
        ("calib_cam_to_cam.txt", "S_00: 1 2\nK_00: 1 2\n", "line 'K_00:' needs 9 finite numbers"),
    ],
)  # fmt: skip
def test_files_that_are_no_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], file: str, text: str, message: str
) -> None:
    drive = raw_drive(tmp_path)
    (drive / file).write_text(text)
    say(drive, calibration=file)
    assert run(["info", str(drive)]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert file in told


def test_lens_models_and_cameras_that_a_camchain_does_not_have(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = raw_drive(tmp_path)
    path = write_kalibr(drive / "chain.yaml", make_calibration())
    say(drive, calibration="chain.yaml", cameras=["cam0", "cam7"])
    assert run(["info", str(drive)]) == 2
    assert "'cam7' is none of them" in capsys.readouterr().err
    tree = yaml.safe_load(path.read_text())
    tree["cam1"]["T_cn_cnm1"] = [[0.0] * 4] * 4
    (drive / "flat.yaml").write_text(yaml.safe_dump(tree))
    say(drive, calibration="flat.yaml")
    assert run(["info", str(drive)]) == 2
    assert "the rotation in cam1.T_cn_cnm1 is no rotation matrix" in capsys.readouterr().err
    path.write_text(path.read_text().replace("radtan", "fov"))
    say(drive, calibration="chain.yaml")
    assert run(["info", str(drive)]) == 2
    assert "lens model 'fov' is unknown; known are plumb_bob" in capsys.readouterr().err
    path.write_text(path.read_text().replace("pinhole", "omni"))
    assert run(["info", str(drive)]) == 2
    assert "camera_model 'omni' is not read, only pinhole" in capsys.readouterr().err


def test_pictures_of_two_sizes_are_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = raw_drive(tmp_path)
    say(drive, calibration=files(drive, make_calibration(), "chain.yaml"))
    png(drive / "right" / "000000.png", cv2.resize(picture(9), (160, 120)))
    assert run(["detect", str(drive), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert "right/000000.png: 160x120 pixels" in told
    assert "320x240" in told
    text = (drive / "chain.yaml").read_text().replace("- 320\n  - 240", "- 160\n  - 120", 1)
    (drive / "chain.yaml").write_text(text)
    assert run(["info", str(drive)]) == 2
    assert "160x120 px, the right one 320x240: a pair needs one size" in capsys.readouterr().err
