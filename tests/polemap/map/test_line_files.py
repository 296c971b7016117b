"""Lines of a map in its files."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pyogrio
import pytest
import shapely
from pyproj import Transformer

from polemap.drivelog.errors import InputError, OutputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.map.city.io import open_city
from polemap.map.io import export_map, read_map, write_map
from polemap.map.line_map import LineMap
from polemap.map.pole_map import KIND_COLUMN, PoleMap, join_maps


def _map(frame: EarthFrame, origin: tuple[float, float]) -> PoleMap:
    rng = np.random.default_rng(3)
    lines = LineMap(
        frame=frame, vertices_m=rng.uniform(0, 99, (7, 2)) + origin,
        vertex_sd_m=rng.uniform(0.02, 0.2, 7), ids=np.array([4, 9]),
        kind=np.array([2, 3], dtype=np.int8), style=np.array([3, 0], dtype=np.int8),
        count=np.array([3, 4]), observations=np.array([30, 7]), drives=np.array([2, 1]),
        existence=np.array([0.98, 0.7]),
    )  # fmt: skip
    one = PoleMap(
        frame, np.array([4]), np.array([origin]) + 5.0, np.eye(2)[None] * 0.01, np.array([0.2]),
        np.array([np.nan]), np.array([9]), np.array([1]), np.array([0.9]),
    )  # fmt: skip
    return replace(one, lines=lines)


@pytest.mark.parametrize("ending", ["gpkg", "geojson"])
@pytest.mark.parametrize(
    ("frame", "origin"),
    [(EarthFrame("utm", 32633), (388500.0, 5819500.0)),
     (EarthFrame("local", name="y"), (0.0, 0.0))],
)  # fmt: skip
def test_lines_come_back_beside_the_poles(
    tmp_path: Path, ending: str, frame: EarthFrame, origin: tuple[float, float]
) -> None:
    made = _map(frame, origin)
    write_map(made, tmp_path / f"m.{ending}")
    write_map(made, tmp_path / f"m.{ending}")  # its own layers are no one else's
    again = read_map(tmp_path / f"m.{ending}")
    assert len(again) == 1
    assert again.lines is not None
    assert made.lines is not None
    assert again.lines.frame == frame
    np.testing.assert_array_equal(again.lines.vertices_m, made.lines.vertices_m)
    np.testing.assert_array_equal(again.lines.vertex_sd_m, made.lines.vertex_sd_m)
    for name, values in made.lines.arrays().items():
        np.testing.assert_array_equal(again.lines.arrays()[name], values, err_msg=name)


def test_a_kind_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.geojson"
    write_map(_map(EarthFrame("local", name="y"), (0.0, 0.0)), path)
    document = json.loads(path.read_text())
    document["features"][1]["properties"]["kind"] = "hedge"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match="line 4: its kind is 'hedge'; write one of"):
        read_map(path)


UTM = EarthFrame("utm", 32633)
PLACE = (388500.0, 5819500.0)


def _add_streets(path: Path) -> None:
    streets = geopandas.GeoDataFrame(
        {"street": ["High Street"]}, geometry=[shapely.linestrings([[0, 0], [9, 9]])], crs=32633
    )
    pyogrio.write_dataframe(streets, path, layer="lines", append=path.exists())


@pytest.mark.parametrize("beside_poles", [False, True])
def test_streets_that_a_gis_calls_lines_are_never_replaced(
    tmp_path: Path, beside_poles: bool
) -> None:
    path = tmp_path / "m.gpkg"
    if beside_poles:
        write_map(replace(_map(UTM, PLACE), lines=None), path)
    _add_streets(path)
    before = path.read_bytes()
    with pytest.raises(OutputError, match="holds the layer 'lines', which polemap did not write"):
        write_map(_map(UTM, PLACE), path)
    assert path.read_bytes() == before


def test_poles_beside_streets_of_a_gis_are_still_read(tmp_path: Path) -> None:
    path = tmp_path / "m.gpkg"
    write_map(replace(_map(UTM, PLACE), lines=None), path)
    _add_streets(path)
    again = read_map(path)
    assert again.lines is None
    assert any("layer 'lines' has not the columns" in note for note in again.notes)


def test_a_street_in_a_geojson_is_left_out_with_a_note(tmp_path: Path) -> None:
    path = tmp_path / "m.geojson"
    write_map(_map(UTM, PLACE), path)
    document = json.loads(path.read_text())
    document["features"][1]["properties"] = {"name": "High Street"}
    path.write_text(json.dumps(document))
    again = read_map(path)
    assert again.lines is not None
    assert again.lines.ids.tolist() == [9]
    assert any("1 features that are not points were left out" in note for note in again.notes)


@pytest.mark.parametrize("ending", ["gpkg", "geojson"])
def test_a_map_that_lost_its_last_line_is_written(tmp_path: Path, ending: str) -> None:
    bare = replace(_map(UTM, PLACE), lines=LineMap.empty(UTM))
    write_map(bare, tmp_path / f"m.{ending}")
    assert read_map(tmp_path / f"m.{ending}").lines is None


def test_multilines_of_one_part_are_lines(tmp_path: Path) -> None:
    path, made = tmp_path / "m.gpkg", _map(UTM, PLACE)
    write_map(made, path)
    table = pyogrio.read_dataframe(path, layer="lines")
    table.geometry = [shapely.multilinestrings([shape]) for shape in table.geometry]
    pyogrio.write_dataframe(table, path, layer="lines", promote_to_multi=True)
    again = read_map(path).lines
    assert again is not None
    assert made.lines is not None
    np.testing.assert_array_equal(again.vertices_m, made.lines.vertices_m)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [("vertex_sd_m", [-1.0, 0.1, 0.1], "line 4: a deviation of vertex_sd_m is -1; write"),
     ("vertex_sd_m", [0.0, 0.1, 0.1], "line 4: a deviation of vertex_sd_m is 0; write"),
     ("observations", -5, "line 4: id, observations and drives are"),
     ("observations", float("inf"), "line 4: id, observations, drives, existence and sd_m must be"),
     ("drives", 10**30, "line 4: id, observations and drives are"),
     ("existence", 2.0, "line 4: its existence is 2, not 0 to 1"),
     ("kind", ["kerb"], "line 4: its kind is")],
)  # fmt: skip
def test_values_that_no_line_has_are_refused(
    tmp_path: Path, name: str, value: object, said: str
) -> None:
    path = tmp_path / "m.geojson"
    write_map(_map(UTM, PLACE), path)
    document = json.loads(path.read_text())
    document["features"][1]["properties"][name] = value
    path.write_text(json.dumps(document).replace("Infinity", "1e999"))
    with pytest.raises(InputError, match=said):
        read_map(path)


@pytest.mark.parametrize("ending", ["parquet", "osm"])
def test_what_a_format_has_no_place_for_is_told(tmp_path: Path, ending: str) -> None:
    made = _map(UTM, PLACE)
    with pytest.warns(UserWarning, match=rf"m.{ending}: has no place for 1 lane marking, 1 kerb"):
        export_map(made, tmp_path / f"m.{ending}")


def test_other_programs_are_given_poles_alone(tmp_path: Path) -> None:
    path = tmp_path / "m.osm"
    made = replace(_map(UTM, PLACE), lines=None)
    corner = np.array([LandmarkKind.CORNER], dtype=np.int8)
    both = join_maps(made, replace(made, ids=np.array([5]), extra={KIND_COLUMN: corner}))
    with pytest.warns(UserWarning, match="no place for 1 corner"):
        export_map(both, path)
    assert path.read_text().count("<node ") == 1


@pytest.mark.parametrize("layer", ["poles", "doubtful"])
def test_an_inventory_that_somebody_keeps_is_never_replaced(tmp_path: Path, layer: str) -> None:
    path = tmp_path / "city.gpkg"
    inventory = geopandas.GeoDataFrame({"owner": ["city"]}, geometry=shapely.points([[1, 2]]))
    pyogrio.write_dataframe(inventory.set_crs(32633), path, layer=layer)
    before = path.read_bytes()
    with pytest.raises(OutputError, match=f"holds the layer '{layer}', which polemap did not"):
        write_map(_map(UTM, PLACE), path)
    assert path.read_bytes() == before


def test_lines_of_a_city_are_read_where_they_are_asked_for(tmp_path: Path) -> None:
    made = _map(UTM, PLACE)
    assert made.lines is not None
    write_map(made, tmp_path / "a.gpkg")
    far = replace(made.lines, vertices_m=made.lines.vertices_m + 50_000.0)
    write_map(replace(made, points_m=made.points_m + 50_000.0, lines=far), tmp_path / "b.gpkg")
    around = np.array([*PLACE, *PLACE]) + np.array([-50.0, -50.0, 150.0, 150.0])
    for path in (tmp_path / "a.gpkg", tmp_path):
        city = open_city(path)
        assert city is not None
        (again,) = [area.poles.lines for area in [city.area([around, around + 9.0])]]
        assert again is not None
        np.testing.assert_array_equal(again.vertices_m, made.lines.vertices_m)
        np.testing.assert_array_equal(again.vertex_sd_m, made.lines.vertex_sd_m)
        np.testing.assert_array_equal(again.ids, made.lines.ids)
        assert not len(city.area(around + 5_000.0).poles.lines or ())
    both = open_city(tmp_path)
    assert both is not None
    lines = both.area([around, around + 50_000.0]).poles.lines
    assert lines is not None
    assert len(set(lines.ids.tolist())) == 4


def test_damaged_lines_of_a_city_cost_the_lines_alone(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.gpkg"
    write_map(_map(UTM, PLACE), path)
    with closing(sqlite3.connect(path)) as database, database:
        for (name,) in database.execute(
            "SELECT name FROM sqlite_master WHERE type = 'trigger' AND tbl_name = 'lines'"
        ).fetchall():
            database.execute(f'DROP TRIGGER "{name}"')
        database.execute("UPDATE lines SET geom = x'4750000100000000'")
    city = open_city(path)
    assert city is not None
    found = city.area(np.array([*PLACE, *PLACE]) + np.array([-50.0, -50.0, 150.0, 150.0])).poles
    assert len(found) == 1
    assert found.lines is None
    assert "has a row that is no line" in caplog.text


def test_lines_in_another_system_and_moved_by_hand(tmp_path: Path) -> None:
    """A GIS writes GeoJSON in its own system, and moves vertices without their grid_m."""
    made = _map(UTM, PLACE)
    assert made.lines is not None
    path = tmp_path / "m.geojson"
    write_map(made, path)
    document = json.loads(path.read_text())
    move = Transformer.from_crs(4326, 3857, always_xy=True).transform
    for feature in document["features"]:
        geometry = feature["geometry"]
        is_line = geometry["type"] == "LineString"
        geometry["coordinates"] = (
            [list(move(*point)) for point in geometry["coordinates"]]
            if is_line
            else move(*geometry["coordinates"])
        )
    document["crs"] = {"type": "name", "properties": {"name": "EPSG:3857"}}
    path.write_text(json.dumps(document))
    again = read_map(path)
    assert again.lines is not None
    np.testing.assert_allclose(again.lines.vertices_m, made.lines.vertices_m, atol=0.001)
    assert not any("moved by hand" in note for note in again.notes)
    document["features"][1]["geometry"]["coordinates"][0][0] += 5.0
    path.write_text(json.dumps(document))
    assert any(note.startswith("1 lines do not run through") for note in read_map(path).notes)


def _edited(path: Path, edit: Callable[[list[dict[str, Any]]], None]) -> None:
    """A GeoJSON of one pole and two lines, changed as another program would."""
    write_map(_map(UTM, PLACE), path)
    document = json.loads(path.read_text())
    edit(document["features"])
    path.write_text(json.dumps(document))


def _as_multilines(features: list[dict[str, Any]]) -> None:
    for feature in features[1:]:
        shape = feature["geometry"]
        feature["geometry"] = {"type": "MultiLineString", "coordinates": [shape["coordinates"]]}


def test_multilines_of_a_geojson_are_lines(tmp_path: Path) -> None:
    path = tmp_path / "m.geojson"
    _edited(path, _as_multilines)
    again, made = read_map(path).lines, _map(UTM, PLACE).lines
    assert again is not None
    assert made is not None
    np.testing.assert_allclose(again.vertices_m, made.vertices_m, atol=0.001)


@pytest.mark.parametrize("geometry", [None, {"type": "Polygon", "coordinates": []}])
def test_a_line_landmark_of_another_shape_is_refused(tmp_path: Path, geometry: Any) -> None:
    path = tmp_path / "m.geojson"
    _edited(path, lambda features: features[1].update(geometry=geometry))
    with pytest.raises(InputError, match=r"feature 1: a line landmark whose shape is .*delete it"):
        read_map(path)


def test_what_else_a_geojson_holds_is_never_lost(tmp_path: Path) -> None:
    path = tmp_path / "m.geojson"
    park = {"type": "Polygon", "coordinates": [[[0, 0], [0, 1], [1, 1], [0, 0]]]}
    _edited(path, lambda f: f.append({"type": "Feature", "geometry": park, "properties": {}}))
    before = path.read_bytes()
    with pytest.raises(OutputError, match="holds 1 features that are no landmarks"):
        write_map(_map(UTM, PLACE), path)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("words", "kinds", "said"),
    [(["corner", None], [1, 0], "1 landmarks have no landmark_kind"), ([None, 1], [0, 1], "1 land"),
     (["hedge", "pole"], None, "holds 'hedge'; write one of pole, corner")],
)  # fmt: skip
@pytest.mark.parametrize("ending", ["geojson", "gpkg"])
def test_kinds_of_points_in_words_or_none(
    tmp_path: Path, ending: str, words: list[Any], kinds: list[int] | None, said: str
) -> None:
    path = tmp_path / f"m.{ending}"
    points = geopandas.GeoDataFrame(
        {"id": [4, 5], "existence": [0.9, 0.9], KIND_COLUMN: words},
        geometry=shapely.points([PLACE, np.array(PLACE) + 9.0]), crs=32633,
    )  # fmt: skip
    pyogrio.write_dataframe(
        points.to_crs(4326) if ending == "geojson" else points,
        path, driver={"geojson": "GeoJSON", "gpkg": "GPKG"}[ending], layer="poles",
    )  # fmt: skip
    if kinds is None:
        with pytest.raises(InputError, match=said):
            read_map(path)
        return
    read = read_map(path)
    assert read.kind.tolist() == kinds
    assert any(note.startswith(said) for note in read.notes)


def test_degrees_in_a_system_of_metres_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.geojson"
    write_map(_map(UTM, PLACE), path)
    document = json.loads(path.read_text())
    document["crs"] = {"type": "name", "properties": {"name": "EPSG:32633"}}
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match="in metres, and its positions are degrees; delete"):
        read_map(path)
