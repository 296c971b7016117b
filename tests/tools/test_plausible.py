"""What the commands do with inputs that cannot be right: said, refused, forced."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.drive import Drive
from polemap.drivelog.writers.folder import write_drive
from polemap.map.io import write_map
from polemap.tools.cli import run
from tests.drivelog.plausibility.made import EAST_M, NORTH_M, clean_drive, with_odometry
from tests.pole_maps import plain_map

Written = Callable[[str, Drive], Path]
# what is said of the input depends on neither
FEW = ["--set", "localize.particles=100", "--set", "localize.output.rate_hz=20"]


@pytest.fixture(scope="module")
def clean() -> Drive:
    return clean_drive(0, duration_s=25.0)


@pytest.fixture
def written(tmp_path: Path) -> Written:
    def write(name: str, drive: Drive) -> Path:
        write_drive(drive, tmp_path / name)
        return tmp_path / name

    return write


@pytest.fixture
def pole_map(tmp_path: Path, clean: Drive) -> Path:
    points = np.array([EAST_M, NORTH_M]) + np.array([[20.0, 8.0], [40.0, 3.0], [60.0, 22.0]])
    write_map(replace(plain_map(points), frame=clean.frame), tmp_path / "map.gpkg")
    return tmp_path / "map.gpkg"


def _wrong(drive: Drive) -> Drive:
    return with_odometry(drive, speed_mps=3.6 * drive.odometry.speed_mps)


def test_info_lists_findings_and_json_exits_with_2(
    clean: Drive, written: Written, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["info", str(written("good", clean)), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == []
    wrong = written("wrong", _wrong(clean))
    assert run(["info", str(wrong), "--json"]) == 2
    (finding,) = json.loads(capsys.readouterr().out)
    assert set(finding) == {"kind", "severity", "stream", "value", "expected", "remedy"}
    assert (finding["kind"], finding["severity"]) == ("speed_unit", "error")
    assert run(["info", str(wrong)]) == 0
    text = capsys.readouterr().out
    assert "plausible?" in text
    assert "km/h" in text


def test_what_cannot_be_read_is_a_finding_of_json(
    clean: Drive, written: Written, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written("bad", clean)
    (path / "odometry.csv").write_text("stamp_s,speed_mps\n0,1\n", "utf-8")
    assert run(["info", str(path), "--json"]) == 2
    (finding,) = json.loads(capsys.readouterr().out)
    assert finding["kind"] == "unreadable"
    assert "yaw_rate_radps" in finding["value"]


@pytest.mark.parametrize("command", ["localize", "map"])
def test_errors_refuse_and_force_goes_on(
    command: str,
    clean: Drive,
    written: Written,
    pole_map: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    wrong = str(written("wrong", _wrong(clean)))
    out = tmp_path / ("new.gpkg" if command == "map" else "run")
    arguments = [command, wrong, "--out", str(out)]
    arguments += ["--map", str(pole_map), *FEW] if command == "localize" else []
    assert run(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "km/h" in said
    assert "--force" in said
    assert not out.exists()
    assert run([*arguments, "--force"]) == 0
    assert "error: made: odometry.csv" in capsys.readouterr().err
    assert out.exists()


def test_a_map_far_away_is_refused(
    clean: Drive,
    written: Written,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    far = replace(plain_map([[EAST_M + 9e4, NORTH_M]]), frame=clean.frame)
    write_map(far, tmp_path / "far.gpkg")
    path = str(written("good", clean))
    arguments = ["localize", path, "--map", str(tmp_path / "far.gpkg"), "--out"]
    assert run([*arguments, str(tmp_path / "run")]) == 2
    assert "90 km" in capsys.readouterr().err


def test_localize_ends_with_a_verdict_and_what_was_left_out(
    clean: Drive,
    written: Written,
    pole_map: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = written("good", replace(clean, reference=None))
    with (path / "odometry.csv").open("a", encoding="utf-8") as file:
        file.write("24.99,nan,0.0,25.0\n")
    arguments = ["localize", str(path), "--map", str(pole_map), "--out", str(tmp_path / "run")]
    arguments += FEW
    assert run(arguments) == 0
    said = capsys.readouterr().out
    assert "verdict: " in said
    assert "left out: 1 x odometry not finite" in said
    verdict = json.loads((tmp_path / "run" / "metrics.json").read_text("utf-8"))["verdict"]
    assert verdict["trust"] in ("trustworthy", "partly", "not")
    assert verdict["sentence"]
