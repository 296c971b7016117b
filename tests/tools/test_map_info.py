"""`polemap map` and `polemap info` from the command line: what they write, and what they refuse."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from polemap.build.map_diff import match_points
from polemap.drivelog.drive import Lap
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.writers.folder import folder_writer
from polemap.map.io import read_map, write_map
from polemap.map.pattern_index.io import read_index
from polemap.map.pole_map import PoleMap
from polemap.tools.cli import run
from tests.polemap.town import FRAME, Town, drive_through, make_town, route


def write_drive(path: Path, town: Town, seed: int, frame: EarthFrame = FRAME) -> Path:
    poses = route(1)[:600]
    rng = np.random.default_rng(seed)
    drive = drive_through(town, rng, start_s=1000.0 * seed, poses=poses, vans=0)
    with folder_writer(
        path, name=path.name, frame=frame, wheelbase_m=2.7, pole_view=drive.scans[0].view
    ) as writer:
        writer.scans(drive.scans)
        writer.reference(drive.reference)
        writer.laps([Lap("half", 1000.0 * seed, 1000.0 * seed + 30.0)])
    return path


@pytest.fixture(scope="module")
def town() -> Town:
    return make_town(np.random.default_rng(2), 1)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, town: Town) -> Path:
    folder = tmp_path_factory.mktemp("cli")
    write_drive(folder / "monday", town, 1)
    write_drive(folder / "friday", town, 2)
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        assert run(["map", str(folder / "monday"), "--out", str(folder / "a.gpkg")]) == 0
    assert f"next: polemap localize DRIVE --map {folder / 'a.gpkg'}" in said.getvalue()
    return folder


def test_a_map_of_one_drive(place: Path, town: Town, capsys: pytest.CaptureFixture[str]) -> None:
    pole_map = read_map(place / "a.gpkg")
    pairs = match_points(pole_map.points_m, town.points_m, 0.5)
    assert len(pairs) >= 0.9 * len(pole_map)
    assert run(["info", str(place / "a.gpkg")]) == 0
    said = capsys.readouterr().out
    assert f"poles      {len(pole_map)}" in said
    assert "EPSG:32632" in said
    assert "point scale" in said
    assert run(["info", str(place / "monday")]) == 0
    said = capsys.readouterr().out
    assert "pole scans 599 at 10.0 Hz, no gaps" in said
    assert "lap        half" in said


def test_update_diff_picture_and_layer(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["map", str(place / "friday"), "--update", str(place / "a.gpkg"), "--align"]
    arguments += ["--out", str(place / "b.geojson"), "--picture", str(place / "b.png")]
    assert run([*arguments, "--localizability", str(place / "route.geojson")]) == 0
    assert read_map(place / "b.geojson").drives.max() == 2
    assert (place / "b.png").read_bytes().startswith(b"\x89PNG")
    features = json.loads((place / "route.geojson").read_text())["features"]
    bounds = [f["properties"]["lateral_sd_m"] for f in features]
    assert 0.0 < np.median([b for b in bounds if b is not None]) < 1.0
    capsys.readouterr()
    changes = str(place / "changes.geojson")
    maps = [str(place / "a.gpkg"), str(place / "b.geojson")]
    assert run(["map", "--diff", *maps, "--out", changes]) == 0
    said = capsys.readouterr().out
    assert "as before" in said
    marked = json.loads(Path(changes).read_text())["features"]
    assert all(f["properties"]["change"] in ("added", "removed", "moved") for f in marked)


@pytest.mark.slow
def test_workers_and_tiles_give_the_same_rows(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drives = [str(place / "monday"), str(place / "friday")]
    assert run(["map", *drives, "--out", str(place / "one.parquet")]) == 0
    monkeypatch.setattr("polemap.tools.map_job.TILE_M", 60.0)
    tiles = ["--workers", "2"]
    assert run(["map", *drives[::-1], "--out", str(place / "many.parquet"), *tiles]) == 0
    assert not list(place.glob(".*checkpoints"))
    one, many = read_map(place / "one.parquet"), read_map(place / "many.parquet")
    for name in ("ids", "points_m", "covariance_m2", "existence", "observations"):
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name))
    np.testing.assert_array_equal(one.extra["history"], many.extra["history"])


def test_conversions(place: Path) -> None:
    pole_map = read_map(place / "a.gpkg")
    for name in ("a.osm", "a.osm.pbf", "a.xodr", "a.parquet"):
        arguments = ["map", "--convert", str(place / "a.gpkg"), "--out", str(place / name)]
        assert run(arguments) == 0
    back = read_map(place / "a.osm")
    assert len(match_points(back.points_m, pole_map.points_m, 0.01)) == len(pole_map)
    np.testing.assert_allclose(np.sort(back.width_m), np.sort(pole_map.width_m), atol=6e-4)
    root = ElementTree.parse(place / "a.xodr").getroot()
    header, road = root.find("header"), root.find("road")
    assert header is not None
    assert road is not None
    assert header.findtext("geoReference") == "+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs"
    geometry = road.find("planView/geometry")
    assert geometry is not None
    start = np.array([float(geometry.get(k, "nan")) for k in ("x", "y")])
    heading, length = float(geometry.get("hdg", "nan")), float(geometry.get("length", "nan"))
    along = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-along[1], along[0]])
    entries = road.findall("objects/object")
    assert len(entries) == len(pole_map)
    for entry, point in zip(entries, pole_map.points_m, strict=True):
        s, t = float(entry.get("s", "nan")), float(entry.get("t", "nan"))
        assert 0.0 <= s <= length
        np.testing.assert_allclose(start + s * along + t * left, point, atol=1e-3)
        assert entry.get("type") == "pole"
        assert float(entry.get("radius", "nan")) > 0
        assert float(entry.get("height", "nan")) > 0


def one_line(capsys: pytest.CaptureFixture[str], *parts: str) -> None:
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for part in parts:
        assert part in error


def test_refusals(place: Path, town: Town, capsys: pytest.CaptureFixture[str]) -> None:
    monday, out = str(place / "monday"), place / "never.gpkg"
    cases: list[tuple[list[str], str]] = [
        (["map", "--out", str(out)], "no drive is given"),
        (["map", monday], "--out is missing"),
        (["map", monday, "--out", str(place / "never.shp")], "a map is written as one of"),
        (["map", monday, "--out", str(out), "--lap", "third"], "no lap is called 'third'"),
        (["map", monday, "--out", str(out), "--update", str(place / "x.gpkg")], "no such map"),
        (["map", monday, "--out", str(out), "--picture", "a.bmp"], "a picture ends in"),
        (["map", "--diff", monday], "--diff compares two maps, 1 are given"),
        (["map", str(place / "nowhere"), "--out", str(out)], "no such drive"),
        (["map", "--convert", str(place / "a.gpkg"), "--out", "a.dwg"], "exported as one of"),
        (["info", str(place)], "not a drive that can be read"),
        (
            ["map", monday, "--out", str(out), "--set", "polemap.mapping.observations_min=100000"],
            "no pole was found",
        ),
    ]
    for arguments, message in cases:
        assert run(arguments) == 2, arguments
        one_line(capsys, message)
    assert not list(place.glob("*never*"))


def test_frames_are_not_mixed(
    place: Path, town: Town, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    local = write_drive(tmp_path / "local", town, 3, EarthFrame("local", name="yard"))
    out = str(tmp_path / "c.gpkg")
    assert run(["map", str(local), "--update", str(place / "a.gpkg"), "--out", out]) == 2
    one_line(capsys, "local frame 'yard'", "EPSG:32632")
    assert not (tmp_path / "c.gpkg").exists()


def test_a_csv_map_asks_for_its_drive(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = place / "poles.csv"
    path.write_text("east_m,north_m\n458000,5430000\n")
    assert run(["info", str(path)]) == 2
    one_line(capsys, "carries no frame")
    assert run(["info", str(path), "--drive", str(place / "monday")]) == 0
    assert "it is taken to be in EPSG:32632" in capsys.readouterr().out


def test_an_empty_map_is_described(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_map(PoleMap.empty(FRAME), tmp_path / "e.gpkg")
    assert run(["info", str(tmp_path / "e.gpkg")]) == 0
    assert "poles      0" in capsys.readouterr().out


def test_an_index_of_patterns_is_written_beside_a_map_on_demand(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "city.gpkg"
    first, second = tmp_path / "one.gpkg", tmp_path / "two.gpkg"
    assert run(["map", str(place / "monday"), "--out", str(first), "--index"]) == 0
    assert "triangles of" in capsys.readouterr().out
    assert read_index(first) is not None
    words = ["map", str(place / "monday"), "--out", str(second), "--index", "--workers", "2"]
    assert run(words) == 0
    one, two = read_index(first), read_index(second)
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.pole, two.pole)
    assert run(["map", "--convert", str(first), "--out", str(out), "--index"]) == 0
    assert read_index(out) is not None
