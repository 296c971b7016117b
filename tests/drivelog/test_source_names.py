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
from polemap.drivelog.source_names import FOLDER, SourceNames
from polemap.tools.cli import run
from tests.drivelog.bags.recordings import Ros, write_mcap
from tests.drivelog.bags.streams import fixes, poses, twists
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
        strings = re.findall(r'"[^"\n]*(?:\.csv|\.yaml)[^"\n]*"', code)
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
