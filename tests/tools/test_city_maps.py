"""Commands with a city that is opened by tiles, however small it is here."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.build.history import COLUMN
from polemap.drivelog.writers.folder import write_drive
from polemap.evaluation.io import open_routes
from polemap.evaluation.runs.io import read_run_set
from polemap.evaluation.verdict import built_from
from polemap.map.city.city_map import CityMap
from polemap.map.city.io import open_map
from polemap.map.io import read_map
from polemap.map.plausibility import check_map_of_drive
from polemap.map.pole_map import PoleMap
from polemap.simulate.points.drive import PointDrive
from polemap.tools import cli
from polemap.tools.recording.opened import open_run
from tests.city_maps import opened, write_city
from tests.localize.place.town import drive_in, town
from tests.localize.point_drives import street_drive

FEW = ["--set", "localize.particles=60"]


@pytest.fixture(scope="module")
def made() -> PointDrive:
    """A drive, and its map with a history and a distant quarter."""
    made = street_drive(2, duration_s=8.0)
    drive, start = made.drive.name, made.drive.span_s[0]
    entry = json.dumps([{"drive": drive, "start_s": start}], separators=(",", ":"))
    known = made.pole_map
    points = np.vstack([known.points_m, known.points_m + np.array([5000.0, 0.0])])
    twice = PoleMap(
        known.frame, np.arange(2 * len(known)), points,
        *(np.concatenate([value, value]) for value in (
            known.covariance_m2, known.width_m, known.height_m, known.observations, known.drives,
            known.existence)),
        extra={COLUMN: np.array([entry] * len(points))},
    )  # fmt: skip
    return replace(made, pole_map=twice)


@pytest.fixture(scope="module")
def place(made: PointDrive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("city")
    write_drive(made.drive, folder / "drive")
    write_city(made.pole_map, folder / "maps")
    (folder / "districts").mkdir()
    (folder / "maps" / "city.parquet").rename(folder / "districts" / "city.parquet")
    return folder


@pytest.fixture
def small_cities(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("polemap.map.city.io.CITY_POLES", 100)


def run(*words: object) -> int:
    return cli.run([str(word) for word in words])


@pytest.mark.usefixtures("small_cities")
@pytest.mark.parametrize("name", ["maps/city.gpkg", "districts"])
def test_localize_in_a_city_gives_the_poses_of_the_whole_map(
    place: Path, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["localize", place / "drive", *FEW, "--seed", 3]
    assert run(*arguments, "--map", place / name, "--out", tmp_path / "tiles") == cli.GOOD
    counts = json.loads((tmp_path / "tiles" / "metrics.json").read_text())
    assert counts["verdict"]["map_built_from_this_drive"]
    monkeypatch.setattr("polemap.map.city.io.CITY_POLES", 10**9)
    whole = place / ("districts/city.parquet" if name == "districts" else name)
    assert run(*arguments, "--map", whole, "--out", tmp_path / "whole") == cli.GOOD
    for file in ("pf.tum", "kf.tum"):
        assert (tmp_path / "tiles" / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()


@pytest.mark.usefixtures("small_cities")
def test_runs_share_a_cache_and_reports_read_what_lies_along_the_way(
    made: PointDrive, place: Path, tmp_path: Path
) -> None:
    arguments = ["localize", place / "drive", *FEW, "--runs", 2, "--workers", 1]
    out, city = tmp_path / "runs", place / "districts"
    assert run(*arguments, "--map", city, "--out", out, "--cache", tmp_path / "c") == cli.GOOD
    opened_run = open_run(out)
    assert opened_run.pole_map is not None
    assert 0 < len(opened_run.pole_map) < len(made.pole_map)
    (route,) = open_routes([read_run_set(out)])
    assert route.pole_map is not None
    assert 0 < len(route.pole_map) < len(made.pole_map)
    assert built_from(route.pole_map, made.drive)
    assert any("built from this drive" in note for note in route.notes)


@pytest.mark.usefixtures("small_cities")
def test_info_says_the_same_of_tiles_and_of_the_whole_map(
    place: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run("info", place / "maps" / "city.gpkg") == cli.GOOD
    tiles = capsys.readouterr().out.splitlines()
    assert "opened     by tiles: its poles are read where they are needed" in tiles
    assert run("info", place / "districts") == cli.GOOD
    assert "by tiles" in capsys.readouterr().out
    monkeypatch.setattr("polemap.map.city.io.CITY_POLES", 10**9)
    assert run("info", place / "maps" / "city.gpkg") == cli.GOOD
    whole = capsys.readouterr().out.splitlines()
    assert [line for line in tiles if not line.startswith("opened ")] == whole


@pytest.mark.usefixtures("small_cities")
def test_a_city_far_away_is_refused(
    made: PointDrive, place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points = made.pole_map.points_m + np.array([90_000.0, 0.0])
    far = write_city(replace(made.pole_map, points_m=points), tmp_path / "far")["gpkg"]
    arguments = ["localize", place / "drive", "--map", far, "--out", tmp_path / "run"]
    assert run(*arguments) == cli.USER_ERROR
    said = capsys.readouterr().err
    assert "the nearest pole is 9" in said
    assert "km from gnss.csv" in said
    assert not check_map_of_drive(opened(place / "maps" / "city.gpkg"), made.drive)
    between = made.pole_map.rows(made.pole_map.points_m[:, 0] > 2000.0)
    (found,) = check_map_of_drive(
        opened(write_city(between, tmp_path / "beside")["parquet"]), made.drive
    )
    assert found.kind == "map_far"


def test_what_is_seen_of_a_map_in_a_hole_of_the_city(made: PointDrive, tmp_path: Path) -> None:
    """Inside the extent, and still no pole within 300 m."""
    points = made.pole_map.points_m
    middle = points[: len(points) // 2].mean(axis=0)
    corners = np.array([[-3000.0, -3000.0], [3000.0, 3000.0]])
    ring = np.concatenate([points[:100] - points[0] + middle + corner for corner in corners])
    city = replace(made.pole_map.rows(np.arange(200)), points_m=ring)
    files = write_city(city, tmp_path)
    (found,) = check_map_of_drive(opened(files["gpkg"]), made.drive)
    assert "301 m" in found.value


def test_a_base_map_is_read_as_ever(place: Path) -> None:
    path = place / "maps" / "city.gpkg"
    assert isinstance(open_map(path), PoleMap)
    assert not isinstance(read_map(path), CityMap)


def test_a_drive_without_any_fix_is_found_in_a_city_by_tiles(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither GNSS nor a start: the index is built before, and the poles tell where it is."""
    monkeypatch.setattr("polemap.map.city.io.CITY_POLES", 1000)
    path = write_city(town(0).surveyed(0.05, 0), tmp_path)["parquet"]
    drive, motion = drive_in(0, 1)
    write_drive(drive, tmp_path / "drive")
    arguments = ["localize", tmp_path / "drive", "--map", path, "--out", tmp_path / "run"]
    assert cli.run([*map(str, arguments), "--set", "localize.particles=50"]) == cli.GOOD
    assert capsys.readouterr().err.count("it has no index of patterns; it is built now") == 1
    rows = np.loadtxt(tmp_path / "run" / "pf.tum", comments="#")
    truth = motion.at(rows[:, 0])[:, :2]
    assert rows[0, 0] < 11.0
    assert np.hypot(*(rows[8:, 1:3] - truth[8:]).T).max() < 1.0
