"""Commands on recordings: the same poses as from the folder, the topics told, mappings."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import PolemapError
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.tum import read_tum
from polemap.drivelog.writers.folder import write_drive
from polemap.map.io import read_map
from polemap.simulate.camera_mounting import CameraConfig
from polemap.simulate.config import RenderConfig, SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.scenario import Scenario
from polemap.stereo.rig import Mounting
from polemap.tools.cli import run
from tests.drivelog.bags.recordings import (
    Ros,
    ros_messages,
    write_mcap,
    write_rosbag2,
)
from tests.drivelog.drives import write_small


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A car passes a few lamps; every stream arrives later than it was measured."""
    street = Scenario.model_validate(
        {
            "name": "street",
            "route": {"closed": False, "corner_radius_m": 8.0, "corners_m": [[0, 0], [40, 0]]},
            "rows": [
                {"kind": "lamp", "side": "right", "spacing_m": 9, "offset_m": 0.5},
                {"kind": "lamp", "side": "left", "spacing_m": 12, "offset_m": 1.0},
            ],
            "drive": {"speed_mps": 7.0, "standstill_s": 0.5},
            "backdrop": False,
        }
    )
    camera = CameraConfig(width_px=320, height_px=200, focal_px=342.0, frame_rate_hz=3.0)
    config = SimulateConfig(camera=camera, render=RenderConfig(workers=1, shadows=False))
    return simulate_drive(street, tmp_path_factory.mktemp("street") / "drive", 1, 3, config)


def mapping(path: Path, **parts: object) -> Path:
    path.write_text(yaml.safe_dump({"format_version": 1, **parts}))
    return path


def poles_of(place: Path, drive: Path, *options: str) -> np.ndarray:
    """Poles of a map of the drive."""
    seen = place / f"{drive.stem}.gpkg"
    assert run(["map", str(drive), "--out", str(seen), "--force", *options]) == 0
    return read_map(seen).points_m


def poses_of(place: Path, drive: Path, *options: str) -> list[np.ndarray]:
    """Poles of a map of the drive, and both trajectories in it."""
    poles = poles_of(place, drive, *options)
    seen, out = place / f"{drive.stem}.gpkg", place / f"run_{drive.stem}"
    assert run(["localize", str(drive), "--map", str(seen), "--out", str(out), "--workers", "1",
                "--force", *options]) == 0  # fmt: skip
    return [poles, *(read_tum(out / f"{kind}.tum").poses for kind in ("pf", "kf"))]


def assert_same(ours: list[np.ndarray], theirs: list[np.ndarray]) -> None:
    assert len(theirs[0])
    for mine, folder in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine, folder, atol=1e-9, rtol=0)


def test_a_simulated_drive_gives_the_same_poses_as_a_recording(
    simulated: Path, tmp_path: Path
) -> None:
    drive = open_drive(simulated)
    ros = Ros()
    log = write_rosbag2(tmp_path / "log", ros_messages(drive, ros), ros, "SQLITE3")
    told = mapping(tmp_path / "topics.yaml", vehicle={"wheelbase_m": drive.wheelbase_m})
    ours = poses_of(tmp_path, log, "--topics", str(told))
    assert_same(ours, poses_of(tmp_path, simulated))


def test_kitti_gives_the_same_poles_as_a_recording(
    recording: Callable[[str], Path], tmp_path: Path
) -> None:
    whole = open_drive(recording("kitti_odometry") / "sequences" / "03")
    drive = whole.between(0.0, 1.5)
    assert drive.images is not None
    folder = tmp_path / "folder"
    write_drive(rounded(drive), folder)
    ros = Ros()
    log = write_mcap(tmp_path / "log.mcap", ros_messages(open_drive(folder), ros, png=True), ros)
    told = mapping(
        tmp_path / "topics.yaml",
        vehicle={"wheelbase_m": drive.wheelbase_m},
        frame=drive.frame.to_dict(),
        gnss={"topic": "/gnss/local"},
    )
    ours, theirs = (
        poles_of(tmp_path, *place) for place in ((log, "--topics", str(told)), (folder,))
    )
    assert len(ours)
    np.testing.assert_allclose(ours, theirs, atol=1e-9, rtol=0)


def rounded(drive: Drive) -> Drive:
    """Stamps of whole nanoseconds, which is what a recording holds, and a mounting of 1e-12."""
    streams = {
        name: replace(stream, **{key: np.round(getattr(stream, key), 9) for key in keys})
        for name, keys in (("odometry", ("stamp_s", "arrival_s")),
                           ("gnss", ("stamp_s", "arrival_s")), ("reference", ("stamp_s",)))
        if (stream := getattr(drive, name)) is not None
    }  # fmt: skip
    assert drive.rig is not None
    mount = Mounting(*(round(value, 12) for value in astuple(drive.rig.vehicle_from_camera)))
    rig = replace(drive.rig, vehicle_from_camera=mount)
    return replace(drive, rig=rig, **streams)


def test_info_lists_topics_and_writes_a_mapping_that_reads_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, ros = open_drive(write_small(tmp_path / "folder")), Ros()
    log = write_mcap(tmp_path / "log.mcap", ros_messages(drive, ros), ros)
    told = tmp_path / "topics.yaml"
    assert run(["info", str(log), "--write-mapping", str(told)]) == 0
    text = capsys.readouterr().out
    for line in ("log        1 file of MCAP", "compression zstd", "sensor_msgs/msg/NavSatFix",
                 "speed, yaw rate", "left calibration", "40  10.0 Hz  3.9 s  reference",
                 f"mapping    written to {told}", "frame      EPSG:32632"):  # fmt: skip
        assert line in text
    values = yaml.safe_load(told.read_text())
    assert values["gnss"] == {"topic": "/gnss/fix"}
    assert run(["info", str(log), "--topics", str(told)]) == 0
    assert "left pictures" in capsys.readouterr().out
    assert run(["info", str(log), "--topics", str(told), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert all(finding["severity"] != "error" for finding in found)
    assert run(["detect", str(log), "--topics", str(told), "--out", str(tmp_path / "d")]) == 0
    out = tmp_path / "again"
    assert run(["convert", str(log), "--topics", str(told), "--out", str(out)]) == 0
    assert len(open_drive(out).frame_stamps_s) == 3


def test_the_mapping_of_a_converted_drive_holds_its_car_and_laps(tmp_path: Path) -> None:
    place = write_small(tmp_path / "folder")
    head = yaml.safe_load((place / "drive.yaml").read_text())
    head["vehicle"] = {"wheelbase_m": 3.21}
    (place / "drive.yaml").write_text(yaml.safe_dump(head, sort_keys=False))
    start = open_drive(place).span_s[0]
    (place / "laps.csv").write_text(f"lap,start_s,end_s\nfirst,{start!r},{start + 1!r}\n")
    log, told = tmp_path / "log.mcap", tmp_path / "topics.yaml"
    assert run(["convert", str(place), "--out", str(log)]) == 0
    assert run(["info", str(log), "--write-mapping", str(told)]) == 0
    mapped, own = open_drive(log, topics=told), open_drive(log)
    assert mapped.wheelbase_m == own.wheelbase_m == 3.21
    assert mapped.laps == own.laps
    assert [lap.name for lap in mapped.laps] == ["first"]
    assert mapped.frame == own.frame
    assert mapped.odometry is not None
    assert own.odometry is not None
    assert np.array_equal(mapped.odometry.speed_mps, own.odometry.speed_mps)
    assert mapped.has_frames == own.has_frames
    assert (mapped.rig is None) == (own.rig is None)


def test_laps_in_a_mapping_that_cannot_be_are_told(tmp_path: Path) -> None:
    drive, ros = open_drive(write_small(tmp_path / "folder")), Ros()
    log = write_mcap(tmp_path / "log.mcap", ros_messages(drive, ros), ros)
    one = {"name": "a", "start_s": 1.0, "end_s": 2.0}
    told = mapping(tmp_path / "t.yaml", laps=[one, {**one, "end_s": 0.5}])
    with pytest.raises(PolemapError, match="lap 'a' ends before it starts"):
        open_drive(log, topics=told)
    told = mapping(tmp_path / "t.yaml", laps=[one, one])
    with pytest.raises(PolemapError, match="two are called 'a'"):
        open_drive(log, topics=told)


def test_info_lists_the_topics_of_a_log_that_makes_no_drive(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, ros = open_drive(write_small(tmp_path / "folder")), Ros()
    log = write_mcap(tmp_path / "log.mcap", ros_messages(drive, ros), ros)
    told = mapping(tmp_path / "topics.yaml", frame={"kind": "utm", "epsg": 4326})
    assert run(["info", str(log), "--topics", str(told)]) == 2
    said = capsys.readouterr()
    assert "/stereo/left/image_rect" in said.out
    assert "epsg 4326 is no UTM zone" in said.err


def test_folders_have_no_topics(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_small(tmp_path / "folder")
    assert run(["info", str(folder), "--write-mapping", str(tmp_path / "a.yaml")]) == 2
    assert "has no topics to map" in capsys.readouterr().err
    assert run(["info", str(folder), "--topics", str(tmp_path / "a.yaml")]) == 2
    assert "has no topics; --topics is for ROS bags and MCAP files" in capsys.readouterr().err
