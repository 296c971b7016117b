"""Recordings that are odd, not damaged: each is read right, or what is wrong is said."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.bags.reader import survey
from polemap.drivelog.readers.registry import open_drive
from tests.drivelog.bags.recordings import Said, write_mcap
from tests.drivelog.bags.streams import (
    INFO,
    MOUNTED,
    ROS,
    infos,
    mountings,
    pair,
    pictures,
    stream,
    twists,
)
from tests.drivelog.drives import RIG

Opened = Callable[..., Drive]
Log = Callable[..., Path]


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("twist.linear.q", r"it has no field 'twist.linear.q'; there are: x, y, z"),
        ("header.frame_id", r"its field 'header.frame_id' is no number"),
        ("twist.linear.x[9]", r"it has no field 'twist.linear.x\[9\]'"),
        ("__class__", "its field '__class__' is no number"),
    ],
)
def test_a_field_that_is_not_there_is_told(field: str, message: str, opened: Opened) -> None:
    speed = {"topic": "/wheel/twist", "fields": [field]}
    with pytest.raises(InputError, match=message):
        opened(twists(), odometry={"speed": speed})


def test_a_message_of_json_tells_its_fields(tmp_path: Path) -> None:
    from polemap.drivelog.readers.bags.decoding import _json
    from polemap.drivelog.readers.bags.fields import FieldError, by_path

    with pytest.raises(FieldError, match="there are: a, b"):
        by_path(["c"])(_json(b'{"a": 1, "b": 2}'))


def test_pictures_that_were_recorded_twice_keep_the_tolerance(opened: Opened) -> None:
    """Right ones 2 ms later pair with either copy of the left ones, not with none."""
    left, right = pictures("/stereo/left/image_rect"), pictures(
        "/stereo/right/image_rect", shift_ns=2_000_000)  # fmt: skip
    calibrations = [*infos("/stereo/left/camera_info", "left"),
                    *infos("/stereo/right/camera_info", "right")]  # fmt: skip
    drive = opened(left, left, right, right, calibrations, twists(), MOUNTED)
    assert len(drive.frame_stamps_s) == 12
    assert np.all(np.diff(drive.frame_stamps_s) > 0)


def test_a_camera_alone_is_called_so(log: Log) -> None:
    path = log(pictures("/cam/image_raw"), infos("/cam/camera_info", "left"), twists())
    uses = survey(path)[1].uses
    assert uses["/cam/image_raw"].startswith("not used: no pair: one of two cameras is told by")
    assert uses["/cam/camera_info"] == "not used: its pictures are not used"


def test_a_calibration_that_changes_is_a_warning(opened: Opened) -> None:
    def changing(side: str) -> list[Said]:
        def make(stamp: int, row: int) -> Any:
            info = ROS.info(stamp, RIG, side)
            info.k[0] *= 1.0 + 0.3 * (row >= 6)
            return info

        return stream(f"/stereo/{side}/camera_info", INFO, make)

    sides = [said for side in ("left", "right") for said in changing(side)]
    shown = [*pictures("/stereo/left/image_rect"), *pictures("/stereo/right/image_rect")]
    drive = opened(twists(), shown, sides, MOUNTED)
    found = [finding for finding in drive.findings if finding.kind == "calibration_changes"]
    assert len(found) == 2
    assert "6 of 12 calibrations differ from the first" in found[0].line()


def test_a_recording_without_a_message_says_so(tmp_path: Path) -> None:
    drive = open_drive(write_mcap(tmp_path / "log.mcap", [], ROS))
    assert [finding.kind for finding in drive.findings] == ["log_empty"]


def test_empty_parts_are_told_or_follow_whole_ones(tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "log_0.mcap").touch()
    with pytest.raises(InputError, match=r"log_0.mcap: is empty; the recorder wrote nothing"):
        open_drive(tmp_path / "log")
    write_mcap(tmp_path / "log" / "log_0.mcap", twists(), ROS)
    (tmp_path / "log" / "log_1.mcap").touch()
    assert open_drive(tmp_path / "log").odometry is not None


def test_frames_in_a_circle_end(opened: Opened) -> None:
    turn, zero = np.eye(3), np.zeros(3)
    circle = mountings(
        ("a", "b", zero, turn), ("b", "c", np.ones(3), turn), ("c", "a", zero, turn),
        ("base_link", "a", zero, turn), ("base_link", "base_link", np.ones(3), turn),
    )  # fmt: skip
    drive = opened(twists(), pair(), circle)
    (finding,) = (f for f in drive.findings if "no fixed TF leads" in f.line())
    assert finding.severity == "error"


def test_topics_of_any_letters_are_read(opened: Opened) -> None:
    drive = opened(twists("/räder/速度\n"), pair("/kamera/größe"), MOUNTED)
    assert drive.odometry is not None
    assert len(drive.frame_stamps_s) == 12
