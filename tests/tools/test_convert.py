"""`polemap convert`: what goes in, what comes out, and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.tum import read_tum
from polemap.drivelog.writers.folder import write_drive
from polemap.map.io import write_map
from polemap.tools import cli
from polemap.tools.convert import CONVERSIONS
from tests.drivelog.drives import write_small
from tests.localize.point_drives import street_drive


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_small(tmp_path / "drive")


def convert(*words: object) -> int:
    return cli.run(["convert", *map(str, words)])


def test_a_drive_becomes_a_folder_with_the_same_streams(drive: Path, tmp_path: Path) -> None:
    assert convert(drive, "--out", tmp_path / "copy") == cli.GOOD
    old, new = open_drive(drive), open_drive(tmp_path / "copy")
    assert old.odometry is not None
    assert new.odometry is not None
    np.testing.assert_array_equal(old.odometry.speed_mps, new.odometry.speed_mps)
    np.testing.assert_array_equal(old.frame_stamps_s, new.frame_stamps_s)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["DRIVE", "--out", "X", "--to", "punchcards"], "--to takes folder"),
        (["missing", "--out", "X"], "no such file or folder"),
        (["DRIVE", "DRIVE", "--out", "X"], "takes one input"),
        (["empty", "--out", "X"], "neither a drive nor a run"),
    ],
)
def test_what_cannot_be_converted_is_one_line(
    words: list[str], message: str, drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    places = {"DRIVE": drive, "X": tmp_path / "x", "empty": tmp_path / "empty"}
    assert convert(*(places.get(word, word) for word in words)) == cli.USER_ERROR
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "x").exists()


def test_every_conversion_names_a_function_that_is_there() -> None:
    for place in CONVERSIONS.values():
        module, _, function = place.partition(":")
        path = Path(cli.__file__).parent / f"{module.rpartition('.')[2]}.py"
        assert f"def {function}(" in path.read_text(encoding="utf-8"), place


def test_a_drive_becomes_kitti_and_says_what_is_lost(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert convert(drive, "--out", tmp_path / "kitti", "--to", "kitti") == cli.GOOD
    said = capsys.readouterr().out
    assert "no place for odometry, GNSS" in said
    assert "no mounting of the camera" in said
    old, new = open_drive(drive), open_drive(tmp_path / "kitti" / "sequences" / "00")
    np.testing.assert_array_equal(old.read_frame(1).right, new.read_frame(1).right)
    assert len(new.frame_stamps_s) == len(old.frame_stamps_s)


def test_a_drive_becomes_mcap_and_names_its_topics(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert convert(drive, "--out", tmp_path / "d.mcap") == cli.GOOD
    assert "/vehicle/twist" in capsys.readouterr().out
    assert (tmp_path / "d.mcap").read_bytes().startswith(b"\x89MCAP")


def test_the_reference_of_a_drive_becomes_a_trajectory(drive: Path, tmp_path: Path) -> None:
    assert convert(drive, "--out", tmp_path / "r.tum") == cli.GOOD
    reference = open_drive(drive).reference
    assert reference is not None
    np.testing.assert_array_equal(read_tum(tmp_path / "r.tum").stamp_s, reference.stamp_s)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`one` is a run, `two` a folder with two, of a short drive of points in a local frame."""
    made = street_drive(2, duration_s=4.0)
    folder = tmp_path_factory.mktemp("runs")
    write_drive(made.drive, folder / "drive")
    write_map(made.pole_map, folder / "map.gpkg")
    words = ["localize", folder / "drive", "--map", folder / "map.gpkg"]
    words += ["--set", "localize.particles=100"]
    assert cli.run([*map(str, words), "--out", str(folder / "one")]) == cli.GOOD
    assert cli.run([*map(str, words), "--out", str(folder / "two"), "--runs", "2"]) == cli.GOOD
    return folder


def test_a_run_becomes_a_trajectory_with_its_health(runs: Path, tmp_path: Path) -> None:
    assert convert(runs / "one", "--out", tmp_path / "t.tum") == cli.GOOD
    old, new = read_tum(runs / "one" / "kf.tum"), read_tum(tmp_path / "t.tum")
    np.testing.assert_array_equal(new.stamp_s, old.stamp_s)
    np.testing.assert_allclose(new.poses, old.poses, atol=1e-12)
    assert convert(runs / "two", "--out", tmp_path / "t.csv", "--run", 1) == cli.GOOD
    head, first = (tmp_path / "t.csv").read_text().splitlines()[:2]
    assert {"healthy", "speed_mps", "distrust"} <= set(head.split(","))
    stamp = read_tum(runs / "two" / "001" / "kf.tum").stamp_s[0]
    assert float(first.split(",")[0]) == stamp
    words = [runs / "one", "--out", tmp_path / "p.csv", "--trajectory", "pf"]
    assert convert(*words) == cli.GOOD
    assert "matched" in (tmp_path / "p.csv").read_text().splitlines()[0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["one", "--out", "t.gpx"], "not tied to the earth"),
        (["two", "--out", "t.tum", "--run", "2"], "there is no run 2"),
        (["one", "--out", "t.tum", "--trajectory", "ekf"], "a run has kf (100 Hz) and pf"),
        (["one", "--out", "folder"], "cannot become 'folder'"),
        (["one", "--out", "one/kf.tum"], "lies inside the input"),
        (["one", "--out", "t.tum", "--map", "drive"], "no such map"),
    ],
)
def test_what_a_run_cannot_become_is_one_line(
    words: list[str], message: str, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {name: runs / name for name in ("one", "two", "drive", "one/kf.tum")}
    assert convert(*(places.get(word, word) for word in words)) == cli.USER_ERROR
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_run_without_frame_and_map_asks_for_them(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(runs / "one", tmp_path / "old")
    config = yaml.safe_load((tmp_path / "old" / "config.yaml").read_text())
    del config["frame"]
    config |= {"drive": "gone", "map": "gone.gpkg"}
    (tmp_path / "old" / "config.yaml").write_text(yaml.safe_dump(config))
    assert convert(tmp_path / "old", "--out", tmp_path / "t.tum") == cli.USER_ERROR
    assert "give --map MAP or --drive DRIVE" in capsys.readouterr().err
    words = [tmp_path / "old", "--out", tmp_path / "t.tum", "--map", runs / "map.gpkg"]
    assert convert(*words) == cli.GOOD


def test_mcap_says_which_landmarks_it_has_no_place_for_and_makes_no_poles_of_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = tmp_path / "drive"
    drive.mkdir()
    (drive / "drive.yaml").write_text(
        "format_version: 1\nname: street\nframe: {kind: local, name: park}\n"
        "vehicle: {wheelbase_m: 2.7}\n"
    )
    (drive / "odometry.csv").write_text(
        "stamp_s,speed_mps,yaw_rate_radps\n" + "".join(f"{k * 0.1},5,0\n" for k in range(20))
    )
    (drive / "poles.csv").write_text(
        "stamp_s,x_m,y_m,var_x_m2,var_y_m2,cov_xy_m2,width_m,kind,facing_rad\n"
        + "".join(f"{k * 0.1},10,3,0.01,0.01,0,0.2,pole,\n"
                  f"{k * 0.1},12,6,0.01,0.01,0,,corner,1.5\n" for k in range(10))
    )  # fmt: skip
    (drive / "lines.csv").write_text(
        "stamp_s,kind,x0_m,y0_m,x1_m,y1_m,offset_sd_m,direction_sd_rad\n"
        + "".join(f"{k * 0.1},kerb,5,-3,11,-3,0.05,0.01\n" for k in range(15))
    )
    assert convert(drive, "--out", tmp_path / "drive.mcap") == cli.GOOD
    said = capsys.readouterr().out
    assert "10 corners, 15 kerbs are left out" in said
    again = open_drive(tmp_path / "drive.mcap")
    assert [len(scan) for scan in again.scans] == [1] * 10
    assert all((scan.kind == 0).all() for scan in again.scans)
