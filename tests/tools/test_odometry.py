"""Motion from wheels, camera or both, through every command that takes a choice."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.registry import open_drive
from polemap.simulate.camera_mounting import CameraConfig
from polemap.simulate.config import RenderConfig, SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.scenario import Scenario
from polemap.tools import cli
from polemap.tools.map_slam import check_slam


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some seconds along lamps, with wheels and pictures."""
    scenario = Scenario.model_validate(
        {
            "name": "street",
            "route": {"closed": False, "corners_m": [[0, 0], [26, 0]]},
            "rows": [
                {"kind": "lamp", "side": "right", "spacing_m": 8, "offset_m": 0.5},
                {"kind": "lamp", "side": "left", "spacing_m": 11, "offset_m": 0.5},
            ],
            "drive": {"speed_mps": 7.0, "standstill_s": 0.3},
        }
    )
    camera = CameraConfig(width_px=480, height_px=300, focal_px=420.0, frame_rate_hz=5.0)
    config = SimulateConfig(camera=camera, render=RenderConfig(workers=1, shadows=False))
    place = tmp_path_factory.mktemp("street")
    simulate_drive(scenario, place / "street", 1, 3, config)
    return place / "street"


def _run(capsys: pytest.CaptureFixture[str], *words: str | Path) -> str:
    code = cli.run([str(word) for word in words])
    shown = capsys.readouterr()
    assert code == cli.GOOD, shown.err
    return shown.out + shown.err


def _table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(
    ("choice", "note"), [("camera", "the stereo camera's"), ("both", "of wheels and camera")]
)
def test_every_choice_goes_through_map_and_localize(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], choice: str, note: str
) -> None:
    motion = ("--odometry", choice)
    kept = ("--cache", street.parent / "kept", "--workers", "1", *motion)
    out = tmp_path / "map.gpkg"
    assert note in _run(
        capsys, "detect", street, "--out", tmp_path / "seen", "--frames", "0:6", *motion
    )
    assert note in _run(capsys, "map", street, "--out", out, *motion)
    assert note in _run(capsys, "localize", street, "--map", out, "--out", tmp_path / "run", *kept)
    metrics = json.loads((tmp_path / "run/metrics.json").read_text(encoding="utf-8"))
    assert metrics["pf"]["position_median_m"] < 0.5


def test_the_camera_alone_writes_its_way_and_its_odometry(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = _run(
        capsys, "odometry", street, "--out", tmp_path / "a.tum", "--csv", tmp_path / "o.csv"
    )
    assert "known" in shown
    rows = np.loadtxt(tmp_path / "a.tum")
    assert rows[0, 1:] == pytest.approx([0, 0, 0, 0, 0, 0, 1])
    # forward is the camera's z
    way = _table(street / "reference.csv")
    length = float(way[-1]["east_m"]) - float(way[0]["east_m"])
    assert rows[-1, 3] == pytest.approx(length, rel=0.03)
    # what it writes is the odometry of a drive
    again = tmp_path / "again"
    shutil.copytree(street, again)
    planar = _table(tmp_path / "o.csv")
    columns = ("stamp_s", "speed_mps", "yaw_rate_radps")
    lines = [",".join(columns), *(",".join(row[c] for c in columns) for row in planar)]
    (again / "odometry.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert "odometry" in _run(capsys, "info", again)


def test_wheels_that_spin_are_the_cameras_and_it_is_told(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slips = tmp_path / "slips"
    shutil.copytree(street, slips)
    rows = _table(street / "odometry.csv")
    for row in rows:
        if 3.0 < float(row["stamp_s"]) < 4.0:
            row["speed_mps"] = f"{1.6 * float(row['speed_mps']):.4f}"
    lines = [",".join(rows[0]), *(",".join(row.values()) for row in rows)]
    (slips / "odometry.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    shown = _run(
        capsys, "localize", slips, "--without-poles", "--out", tmp_path / "run",
        "--odometry", "both", "--force",
    )  # fmt: skip
    count = int(shown.split(" steps where wheels contradict")[0].split()[-1])
    assert 5 <= count <= 12


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--odometry", "gyro"), "choose auto, wheels, camera, both, derived"),
        (("--odometry", "derived"), "needs an odometry derived from its reference"),
    ],
)
def test_a_choice_that_cannot_be_is_refused(
    street: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, str],
    told: str,
) -> None:
    for verb in (("detect",), ("map",), ("localize", "--without-poles")):
        assert cli.run([*verb, str(street), "--out", str(tmp_path / "m.gpkg"), *words]) == (
            cli.USER_ERROR
        )
        assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("choice", "made"), [("auto", False), ("camera", False), ("derived", True)]
)
def test_slam_refuses_the_odometry_that_is_used_not_the_one_that_was_recorded(
    street: Path, choice: str, made: bool
) -> None:
    """Drives that workers will open are looked at as recorded: KITTI's with a derived odometry."""
    recorded = replace(open_drive(street), odometry_is_derived=True)
    if made:
        with pytest.raises(InputError, match="made from its reference"):
            check_slam([recorded], choice, asked=True)
    else:
        check_slam([recorded], choice, asked=True)
