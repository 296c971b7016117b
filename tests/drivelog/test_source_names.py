"""Findings and refusals name what the user of a recording has: topics, or files of his folder."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.drive import Drive
from polemap.drivelog.plausibility.check import check_drive
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.source_names import FOLDER, CalibrationNames, SourceNames
from polemap.drivelog.writers.kitti_odometry import write_kitti_odometry
from polemap.tools.cli import run
from tests.drivelog.bags.recordings import Ros, ros_messages, write_mcap, write_rosbag2
from tests.drivelog.bags.streams import fixes, poses, twists
from tests.drivelog.drives import RIG, write_small
from tests.drivelog.plausibility.made import clean_drive, with_gnss, with_odometry, with_reference

PLAUSIBILITY = Path(__file__).resolve().parents[2] / "drivelog" / "plausibility"
OF_A_FOLDER = re.compile(r"\w+\.csv|drive\.yaml|\b\w+_(?:m|s|mps|deg|rad|radps)\b")


def test_two_streams_of_one_topic_are_told_apart_by_their_role() -> None:
    names = SourceNames.distinct(odometry="/odom", reference="/odom", gnss="/fix")
    assert (names.odometry, names.reference) == ("/odom (odometry)", "/odom (reference)")
    assert names.gnss == "/fix"
    with pytest.raises(ValueError, match="two streams have one name"):
        replace(FOLDER, gnss="odometry.csv")


def test_no_check_names_a_file_of_its_own() -> None:
    for file in PLAUSIBILITY.glob("*.py"):
        code = file.read_text().partition('"""\n\n')[2]
        # a log of the car's signals is this file wherever there is one
        strings = re.findall(r'"[^"\n]*(?:(?<!signals)\.csv|\.yaml)[^"\n]*"', code)
        assert not strings, (file.name, strings)


def _faster(drive: Drive) -> Drive:
    return with_odometry(drive, speed_mps=3.6 * drive.odometry.speed_mps)


def _mirrored(drive: Drive) -> Drive:
    return with_odometry(drive, yaw_rate_radps=-drive.odometry.yaw_rate_radps)


def _backward(drive: Drive) -> Drive:
    poses = drive.reference.poses + np.array([0.0, 0.0, np.pi])
    return with_reference(drive, poses=poses)


def _early(drive: Drive) -> Drive:
    return with_gnss(drive, stamp_s=drive.gnss.stamp_s + 900.0)


def _far(drive: Drive) -> Drive:
    return with_gnss(drive, east_m=drive.gnss.east_m + 500.0)


@pytest.mark.parametrize("fault", [_faster, _mirrored, _backward, _early, _far])
def test_findings_speak_of_topics(fault: Callable[[Drive], Drive]) -> None:
    names = SourceNames.distinct(
        odometry="/wheel/twist", gnss="/fix", reference="/ground_truth", poles="/poles", head="m"
    )
    told = check_drive(fault(clean_drive(0, 80.0)))
    found = check_drive(replace(fault(clean_drive(0, 80.0)), names=names))
    assert found
    assert [f.kind for f in found] == [f.kind for f in told]
    for finding in found:
        assert finding.stream in ("/wheel/twist", "/fix", "/ground_truth", "/poles")
        assert not OF_A_FOLDER.search(finding.line()), finding.line()


def test_a_recording_names_its_topics(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = sorted([*twists(speed=400.0), *poses(), *fixes()], key=lambda one: one.log_ns)
    path = write_mcap(tmp_path / "log.mcap", said, Ros())
    names = open_drive(path).names
    assert (names.odometry, names.reference) == ("/wheel/twist", "/ground_truth")
    assert run(["info", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "/wheel/twist: " in printed
    assert "odometry.csv" not in printed
    assert "drive.yaml" not in printed
    # what it lacks is named as what a recording would hold
    alone = write_mcap(tmp_path / "alone.mcap", sorted(fixes(), key=lambda one: one.log_ns), Ros())
    assert run(["map", str(alone), "--out", str(tmp_path / "m.gpkg")]) == 2
    assert ".csv" not in capsys.readouterr().err
    assert run(["localize", str(alone), "--without-poles", "--out", str(tmp_path / "run")]) == 2
    assert "a topic of speed and yaw rate (--topics)" in capsys.readouterr().err


def _wrong_camera(drive: Drive) -> Drive:
    """A lens in millimetres, a baseline in millimetres, out of the picture's middle, in the sky."""
    rig = replace(RIG, focal_px=8.0, baseline_m=300.0, cx_px=1.0, cy_px=1.0)
    rig = replace(rig, vehicle_from_camera=replace(rig.vehicle_from_camera, z_m=9.0))
    return replace(drive, rig=rig, wheelbase_m=2700.0)


CAMERA_KINDS = {"focal_length", "baseline", "principal_point", "camera_place", "wheelbase"}
KEYS = re.compile(r"\b(?:focal_px|c[xy]_px|baseline_m|wheelbase_m|z_m|pitch_rad|yaw_rad)\b")


def test_camera_findings_name_the_keys_of_a_folder() -> None:
    found = check_drive(_wrong_camera(clean_drive(0, 80.0)))
    assert {finding.kind for finding in found} >= CAMERA_KINDS
    told = " ".join(finding.line() for finding in found)
    assert {"focal_px", "cx_px", "baseline_m", "wheelbase_m"} <= set(KEYS.findall(told))


def test_camera_findings_name_what_the_source_has(tmp_path: Path) -> None:
    said = sorted([*twists(), *poses(), *fixes()], key=lambda one: one.log_ns)
    bag = open_drive(write_mcap(tmp_path / "log.mcap", said, Ros())).names
    calib = CalibrationNames(focal="P0[0,0] of calib.txt", baseline="P1 of calib.txt")
    for names in (replace(bag, calibration=calib), bag):
        found = check_drive(replace(_wrong_camera(clean_drive(0, 80.0)), names=names))
        assert {finding.kind for finding in found} >= CAMERA_KINDS
        told = {finding.kind: finding.value for finding in found if finding.kind in CAMERA_KINDS}
        assert told["focal_length"].startswith(names.calibration.focal)
        assert told["baseline"].startswith(names.calibration.baseline)
        assert told["wheelbase"].startswith(names.calibration.wheelbase)
        keys = set(KEYS.findall(" ".join(told.values())))
        assert keys == (set() if names is not bag else {"wheelbase_m"})  # the mapping's own key


def test_kitti_and_bags_say_where_each_number_of_the_camera_stands(tmp_path: Path) -> None:
    drive = open_drive(write_small(tmp_path / "drive"))
    kitti = write_kitti_odometry(drive, tmp_path / "kitti")
    assert open_drive(kitti).names.calibration.focal == "P0[0,0] of calib.txt"
    ros = Ros()
    bag = write_rosbag2(tmp_path / "bag", ros_messages(drive, ros), ros)
    told = open_drive(bag).names.calibration
    assert re.fullmatch(r"P\[0,0\] of /\S*camera_info", told.focal), told
    assert told.height == "the camera's height in TF"
