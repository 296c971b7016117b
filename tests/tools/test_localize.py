"""`polemap localize` from a drive on the disk to a run folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from polemap.drivelog.writers.folder import write_drive
from polemap.map.io import write_map
from polemap.tools import cli
from tests.localize.point_drives import street_drive

FEW = ["--set", "localize.particles=150", "--set", "localize.output.rate_hz=20"]


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    made = street_drive(2, duration_s=8.0)
    folder = tmp_path_factory.mktemp("street")
    write_drive(made.drive, folder / "drive")
    write_map(made.pole_map, folder / "map.gpkg")
    return folder / "drive", folder / "map.gpkg"


def localize(*words: object) -> int:
    return cli.run(["localize", *map(str, words)])


def test_a_run_of_many_is_the_run_of_its_seed(
    street: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, pole_map = street
    many, one = tmp_path / "many", tmp_path / "one"
    arguments = [drive, "--map", pole_map, *FEW]
    assert localize(*arguments, "--out", many, "--runs", 2, "--seed", 7) == cli.GOOD
    assert "±" in capsys.readouterr().out
    assert localize(*arguments, "--out", one, "--seed", 8) == cli.GOOD
    assert {"000", "001", "metrics.json"} <= {path.name for path in many.iterdir()}
    for name in ("pf.tum", "kf.tum", "health.csv", "output.csv"):
        assert (many / "001" / name).read_bytes() == (one / name).read_bytes()
    assert (many / "000" / "pf.tum").read_bytes() != (one / "pf.tum").read_bytes()
    summary = json.loads((many / "metrics.json").read_text())
    single = json.loads((one / "metrics.json").read_text())
    assert summary["runs"] == 2
    figure = summary["kf"]["lateral_rmse_m"]
    assert figure["min"] <= figure["mean"] <= figure["max"]
    assert single["kf"]["lateral_rmse_m"] in (figure["min"], figure["max"])
    assert {"perception", "particle_filter", "output_tick"} <= set(single["timing_ms"])
    assert single["real_time_factor"] > 0
    config = yaml.safe_load((one / "config.yaml").read_text())
    assert config["seed"] == 8
    assert config["settings"]["localize"]["particles"] == 150


def test_without_poles(
    street: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, _ = street
    assert localize(drive, "--without-poles", "--out", tmp_path / "run") == cli.GOOD
    assert f"next: polemap report {tmp_path / 'run'}" in capsys.readouterr().out
    assert (tmp_path / "run" / "pf.tum").read_text() == ""
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert "pf" not in metrics
    assert metrics["kf"]["poses"] > 100


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "give --map MAP"),
        (["--map", "MAP", "--without-poles"], "exclude each other"),
        (["--map", "MAP", "--lap", "none"], "no lap is called 'none'"),
        (["--map", "MAP", "--set", "localize.output.rate=5"], "unknown key 'localize.output.rate'"),
        (["--map", "MAP", "--set", "localize.output.rate_hz=0"], "localize.output.rate_hz"),
        (["--map", "nowhere.gpkg"], "nowhere.gpkg: no such map"),
    ],
)
def test_what_is_wrong_is_said_in_one_line_and_nothing_is_written(
    street: tuple[Path, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    message: str,
) -> None:
    drive, pole_map = street
    words = [str(pole_map) if word == "MAP" else word for word in words]
    assert localize(drive, *words, "--out", tmp_path / "run") == cli.USER_ERROR
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
