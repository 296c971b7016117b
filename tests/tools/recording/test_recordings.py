"""Runs as recordings, read back by mcap, rosbags and rerun."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rerun
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.tum import read_tum
from polemap.drivelog.writers.folder import write_drive
from polemap.map.io import read_map, write_map
from polemap.stereo.rig import StereoRig
from polemap.tools import cli, view
from polemap.tools.recording.layout import layout
from polemap.tools.recording.scene import jpeg, lines_px
from tests.drivelog.drives import write_small
from tests.localize.point_drives import street_drive


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in a map of poles, of a drive with poles of its own, in a local frame."""
    made = street_drive(2, duration_s=4.0)
    folder = tmp_path_factory.mktemp("street")
    write_drive(made.drive, folder / "drive")
    write_map(made.pole_map, folder / "map.gpkg")
    words = ["localize", folder / "drive", "--map", folder / "map.gpkg", "--out", folder / "run"]
    assert cli.run([*map(str, words), "--set", "localize.particles=100"]) == cli.GOOD
    return folder


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run without poles of a drive with pictures, on the earth."""
    folder = tmp_path_factory.mktemp("filmed")
    write_small(folder / "drive")
    words = ["localize", folder / "drive", "--without-poles", "--out", folder / "run", "--force"]
    assert cli.run(list(map(str, words))) == cli.GOOD
    return folder


def run_view(*words: object) -> int:
    return cli.run(["view", *map(str, words)])


def decoded(path: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, content in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(content)
    return found


def test_a_run_in_foxglove(street: Path, tmp_path: Path) -> None:
    words = [street / "run", "--drive", street / "drive", "--out", tmp_path / "r.mcap"]
    assert run_view(*words) == cli.GOOD
    back = decoded(tmp_path / "r.mcap")
    kf, pf = read_tum(street / "run" / "kf.tum"), read_tum(street / "run" / "pf.tum")
    poses = back["/localization/pose"]
    assert [c.pose.pose.position.x for c in poses] == pytest.approx(kf.poses[:, 0])
    assert poses[-1].twist.twist.linear.x > 0.0
    assert poses[-1].pose.covariance[0] > 0.0
    assert len(back["/tf"]) == len(kf)
    assert len(back["/health"]) == len(back["/diagnostics"]) == len(pf)
    status = back["/diagnostics"][-1].status[0]
    assert status.level in (0, b"\x00")
    assert {value.key for value in status.values} >= {"matched", "gate"}
    poles = back["/map/poles"][0].entities[0].cylinders
    assert len(poles) == len(read_map(street / "map.gpkg"))
    assert any(scene.entities[0].cylinders for scene in back["/seen/poles"])
    assert {"/path/kf", "/path/pf", "/path/reference"} <= set(back)
    assert "/localization/fix" not in back  # a local frame has no latitude


def test_pictures_with_what_was_seen(filmed: Path, tmp_path: Path) -> None:
    words = [filmed / "run", "--drive", filmed / "drive", "--out", tmp_path / "r.mcap"]
    assert run_view(*words) == cli.GOOD
    back = decoded(tmp_path / "r.mcap")
    drive = open_drive(filmed / "drive")
    assert len(back["/camera/left/compressed"]) == len(drive.frame_stamps_s)
    assert len(back["/camera/left/annotations"]) == len(drive.frame_stamps_s)
    picture = cv2.imdecode(np.frombuffer(back["/camera/left/compressed"][0].data, np.uint8), 0)
    assert picture.shape == drive.read_frame(0).left.shape
    assert back["/localization/fix"][0].latitude == pytest.approx(49.0, abs=0.2)
    # drawn near the origin: viewers have single precision
    assert abs(back["/localization/pose"][0].pose.pose.position.y) < 200.0
    with (tmp_path / "r.mcap").open("rb") as file:
        about = next(iter(make_reader(file).iter_metadata())).metadata
    first = read_tum(filmed / "run" / "kf.tum").poses[0]
    drawn = back["/localization/pose"][0].pose.pose.position
    assert drawn.y + float(about["origin_north_m"]) == pytest.approx(first[1], abs=1e-6)


def test_rosbags_reads_all_and_the_layout_names_topics_that_are_there(
    filmed: Path, tmp_path: Path
) -> None:
    words = [filmed / "run", "--drive", filmed / "drive", "--out", tmp_path / "r.mcap"]
    assert run_view(*words) == cli.GOOD
    topics = set()
    with AnyReader([tmp_path / "r.mcap"]) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            topics.add(connection.topic)
    panels = json.loads((tmp_path / "r.layout.json").read_text())["configById"]
    shown = panels["Image!left"]["imageMode"]
    assert {shown["imageTopic"], shown["calibrationTopic"], *shown["annotations"]} <= topics
    assert panels["map!place"]["followTopic"] in topics
    for panel, config in panels.items():
        if panel.startswith("Plot!"):
            assert {path["value"].split(".")[0] for path in config["paths"]} <= topics


def test_the_layout_places_every_panel_once() -> None:
    def leaves(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    for pictures in (True, False):
        made = layout(with_pictures=pictures, on_earth=pictures, with_poles=not pictures)
        assert sorted(leaves(made["layout"])) == sorted(made["configById"])


def test_rerun_reads_its_recording(filmed: Path, tmp_path: Path) -> None:
    words = [filmed / "run", "--drive", filmed / "drive", "--out", tmp_path / "r.rrd"]
    assert run_view(*words) == cli.GOOD
    reader = rerun.experimental.RrdReader(str(tmp_path / "r.rrd"))
    entities = {str(chunk.entity_path) for chunk in reader.stream()}
    assert {"/map/car", "/map/path/kf", "/camera/left", "/motion/speed_mps"} <= entities


def test_without_a_display_the_recording_is_written(
    street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(view, "has_display", lambda: False)
    monkeypatch.chdir(tmp_path)
    assert run_view(street / "run") == cli.GOOD
    said = capsys.readouterr().out
    assert "no display" in said
    assert "open it with: rerun run.rrd" in said
    assert "--drive DRIVE adds them" in said
    assert (tmp_path / "run.rrd").stat().st_size > 0


def test_a_run_converts_to_the_same_recording(street: Path, tmp_path: Path) -> None:
    words = ["convert", street / "run", "--out", tmp_path / "c.mcap"]
    assert cli.run(list(map(str, words))) == cli.GOOD
    assert run_view(street / "run", "--out", tmp_path / "v.mcap") == cli.GOOD
    assert (tmp_path / "c.mcap").read_bytes() == (tmp_path / "v.mcap").read_bytes()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["drive"], "is not a run folder"),
        (["nothing"], "no such run folder"),
        (["run", "--out", "x.bag"], "a recording ends in .rrd (rerun) or .mcap (Foxglove)"),
        (["run", "--out", "run/x.mcap"], "lies inside the input"),
        (["run", "--out", "x.mcap", "--run", "7"], "there is no run 7"),
        (["run", "--out", "x.mcap", "--drive", "map.gpkg"], "map.gpkg"),
    ],
)
def test_what_cannot_be_shown_is_one_line(
    words: list[str], message: str, street: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = [street / word if not word.startswith("-") and word != "7" else word for word in words]
    assert run_view(*places) == cli.USER_ERROR
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (street / "x.mcap").exists()


def test_a_map_that_is_gone_and_settings_of_another_polemap_are_told(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(street / "run", tmp_path / "old")
    config = yaml.safe_load((tmp_path / "old" / "config.yaml").read_text())
    config |= {"map": "gone.gpkg", "settings": {"unheard_of": 1}}
    (tmp_path / "old" / "config.yaml").write_text(yaml.safe_dump(config))
    words = [tmp_path / "old", "--drive", street / "drive", "--out", tmp_path / "o.mcap"]
    assert run_view(*words) == cli.GOOD
    said = capsys.readouterr().out
    assert "gone.gpkg is gone: no poles are shown" in said
    assert "settings are of another polemap" in said
    assert "/map/poles" not in decoded(tmp_path / "o.mcap")


def test_the_viewer_is_not_imported_for_foxglove(street: Path, tmp_path: Path) -> None:
    program = (
        "import sys; sys.modules['rerun'] = None\n"
        "from polemap.tools import cli\n"
        "sys.exit(cli.run(['view', sys.argv[1], '--out', sys.argv[2]]))"
    )
    words = [sys.executable, "-c", program, str(street / "run"), str(tmp_path / "a.mcap")]
    assert subprocess.run(words, check=False).returncode == cli.GOOD


def test_poles_stand_in_the_picture_where_the_camera_sees_them() -> None:
    rig = StereoRig(640, 480, 500.0, 319.5, 239.5, 0.3)  # at 1.5 m, level
    lines = lines_px(rig, np.array([[10.0, 0.0], [-5.0, 0.0], [60.0, 0.0]]), np.full(3, 3.0))
    assert len(lines) == 1  # neither behind the camera nor too far away
    foot, top = lines[0]
    assert foot == pytest.approx([319.5, 239.5 + 500.0 * 1.5 / 10.0])
    assert top == pytest.approx([319.5, 239.5 - 500.0 * 1.5 / 10.0])


def test_deep_pictures_are_shown_in_eight_bits() -> None:
    deep = np.random.default_rng(0).integers(0, 4000, (48, 64)).astype(np.uint16)
    back = cv2.imdecode(np.frombuffer(jpeg(deep), np.uint8), cv2.IMREAD_UNCHANGED)
    assert back.shape == deep.shape
    assert back.max() > 200
