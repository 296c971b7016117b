"""`polemap where` on a drive through a small town."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.writers.folder import write_drive
from polemap.map.city.parquet.io import write_tiles
from polemap.map.io import write_map
from polemap.map.pattern_index.io import index_file, write_index
from polemap.tools import cli
from tests.city_maps import write_city
from tests.localize.place.town import drive_in, town
from tests.pole_maps import plain_map


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A drive, the map of its town, and that of another."""
    folder = tmp_path_factory.mktemp("where")
    drive, _ = drive_in(0, 1)
    write_drive(drive, folder / "drive")
    write_map(town(0).surveyed(0.05, 0), folder / "town.gpkg")
    write_map(town(1).surveyed(0.05, 1), folder / "other.geojson")
    return folder / "drive", folder / "town.gpkg", folder / "other.geojson"


def where(*words: object) -> int:
    return cli.run(["where", *map(str, words)])


def test_the_place_is_told_with_what_speaks_for_it(
    places: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, pole_map, _ = places
    picture = tmp_path / "place.png"
    assert where(drive, "--map", pole_map, "--json", "--picture", picture) == cli.GOOD
    told = json.loads(capsys.readouterr().out)
    truth = drive_in(0, 1)[1].at(told["stamp_s"])[0]
    assert told["found"] is True
    assert np.hypot(told["east_m"] - truth[0], told["north_m"] - truth[1]) < 0.5
    assert told["wrong_at_most"] == told["bound"] < 1e-3
    assert told["runner_up"]["log_evidence_less"] > 10.0
    assert 0 < told["after_m"] < 100
    assert 0 < told["after_s"] < 13
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert index_file(pole_map).is_file()
    assert where(drive, "--map", pole_map, "--at", 5) == cli.GOOD
    said = capsys.readouterr()
    assert "found after" in said.out
    assert "wrong with a probability of" in said.out
    assert "times less" in said.out
    assert said.err == ""  # the index is there by now


def test_no_place_in_another_town(
    places: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    drive, _, other = places
    assert where(drive, "--map", other, "--at", 7) == cli.GOOD
    said = capsys.readouterr()
    assert "no place can be claimed after" in said.out
    assert "it has no index of patterns; it is built now" in said.err
    assert where(drive, "--map", other, "--at", 7, "--json") == cli.GOOD
    told = json.loads(capsys.readouterr().out)
    assert (told["found"], told["east_m"], told["stamp_s"]) == (False, None, None)
    # of what is not claimed no probability is stated
    assert told["wrong_at_most"] is None
    assert told["bound"] > 0.01


def test_near_the_end_of_the_drive_nothing_is_known_yet(
    places: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, pole_map, _ = places
    assert where(drive, "--map", pole_map, "--at", 12.3, "--json") == cli.GOOD
    told = json.loads(capsys.readouterr().out)
    assert (told["found"], told["poles"], told["runner_up"]) == (False, 0, None)
    arguments = [drive, "--map", pole_map, "--at", 12.3, "--picture", tmp_path / "a.png"]
    assert where(*arguments) == cli.USER_ERROR
    assert "no place to draw" in capsys.readouterr().err


def test_beyond_the_end_of_the_drive_there_is_nothing_to_begin_at(
    places: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    drive, pole_map, _ = places
    assert where(drive, "--map", pole_map, "--at", 1000) == cli.USER_ERROR
    said = capsys.readouterr().err
    assert "--at 1000: drive points lasts 12.5 s; begin earlier" in said
    assert said.count("\n") == 1


def test_a_folder_of_maps_is_indexed_and_searched(
    places: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two districts, each a file; one is mapped anew, and the index knows."""
    drive, _, _ = places
    whole = town(0).surveyed(0.05, 0)
    south = whole.points_m[:, 1] < np.median(whole.points_m[:, 1])
    folder = tmp_path / "districts"
    for name, rows in (("south", south), ("north", ~south)):
        write_city(whole.rows(rows), tmp_path / name)
        folder.mkdir(exist_ok=True)
        (tmp_path / name / "city.parquet").rename(folder / f"{name}.parquet")
    assert cli.run(["map", "--index", str(folder), "--workers", "2"]) == cli.GOOD
    assert f"triangles of {len(whole)} poles" in capsys.readouterr().out
    assert index_file(folder) == tmp_path / "districts.patterns"
    assert where(drive, "--map", folder, "--json") == cli.GOOD
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert (told["found"], said.err) == (True, "")
    truth = drive_in(0, 1)[1].at(told["stamp_s"])[0]
    assert np.hypot(told["east_m"] - truth[0], told["north_m"] - truth[1]) < 0.5
    write_tiles(whole.rows(south).rows(np.arange(10, south.sum())), folder / "south.parquet", 64)
    assert where(drive, "--map", folder, "--at", 12) == cli.GOOD
    assert "is of another map, or of another version; it is built now" in capsys.readouterr().err
    (folder / "north.parquet").unlink()
    assert where(drive, "--map", folder, "--at", 12) == cli.GOOD
    assert "is of another map" in capsys.readouterr().err
    (folder / "south.parquet").unlink()
    assert where(drive, "--map", folder) == cli.USER_ERROR
    assert "a folder of maps holds .gpkg or .parquet files" in capsys.readouterr().err


@pytest.mark.parametrize("points", [np.empty((0, 2)), np.array([[1.0, 2.0]])])
def test_a_map_without_patterns_finds_nobody_and_says_why(
    places: tuple[Path, Path, Path],
    points: np.ndarray,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    frame = town(0).surveyed(0.05, 0).frame
    write_map(replace(plain_map(points), frame=frame), tmp_path / "few.gpkg")
    assert where(places[0], "--map", tmp_path / "few.gpkg") == cli.USER_ERROR
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"{len(points)} poles of which no three stand within 30 m" in said


def test_a_damaged_index_is_told_and_built_anew(
    places: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    drive, pole_map, _ = places
    assert where(drive, "--map", pole_map, "--at", 12) == cli.GOOD
    index_file(pole_map).write_bytes(index_file(pole_map).read_bytes()[:-7])
    capsys.readouterr()
    assert where(drive, "--map", pole_map, "--at", 12) == cli.GOOD
    said = capsys.readouterr().err
    assert "its head tells of" in said
    assert said.count("\n") == 1


def test_what_is_missing_is_named(
    places: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, pole_map, _ = places
    assert where(drive, "--map", tmp_path / "none.gpkg") == cli.USER_ERROR
    assert "none.gpkg: no such map" in capsys.readouterr().err
    for words in (["where", str(drive), "--map", str(drive)], ["map", "--index", str(drive)]):
        assert cli.run(words) == cli.USER_ERROR
        said = capsys.readouterr().err
        assert "a folder of maps holds .gpkg or .parquet files" in said
        assert said.count("\n") == 1
    assert cli.run(["map", "--index", str(tmp_path / "none.gpkg")]) == cli.USER_ERROR
    assert "none.gpkg: no such map" in capsys.readouterr().err
    assert where(drive, "--map", pole_map, "--picture", "a.txt") == cli.USER_ERROR
    assert "a picture ends in" in capsys.readouterr().err
    made, _ = drive_in(0, 1)
    write_drive(replace(made, odometry=None, path=tmp_path), tmp_path / "still")
    assert where(tmp_path / "still", "--map", pole_map) == cli.USER_ERROR
    assert "it has no odometry" in capsys.readouterr().err
    write_drive(replace(made, scans=()), tmp_path / "blind")
    assert where(tmp_path / "blind", "--map", pole_map) == cli.USER_ERROR
    assert "neither images nor poles.csv" in capsys.readouterr().err


def test_flipped_bits_of_an_index_are_one_line(
    places: tuple[Path, Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, _, _ = places
    file = tmp_path / "town.geojson"
    write_map(town(0).surveyed(0.05, 0), file)
    index = write_index(town(0).surveyed(0.05, 0), file)
    data = bytearray(index_file(file).read_bytes())
    # the last array but one names the poles of triangles
    end = len(data) - 2 * index.triangles - 128
    data[end - 2 * index.triangles : end] = b"\xff" * (2 * index.triangles)
    index_file(file).write_bytes(data)
    assert where(drive, "--map", file) == cli.USER_ERROR
    said = capsys.readouterr().err
    assert re.fullmatch(
        r"polemap: .*town\.geojson\.patterns: its block .* is damaged; delete .*\n", said
    )
