"""GeoJSON that was edited elsewhere: systems, MultiPoints, heights and points that were moved."""

from __future__ import annotations

import json
from pathlib import Path

import geopandas
import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.io import read_map, write_map
from polemap.map.pole_map import PoleMap
from tests.polemap.map.test_gis_edits import make_map


def _geojson(pole_map: PoleMap, path: Path) -> dict:  # type: ignore[type-arg]
    write_map(pole_map, path)
    return json.loads(path.read_text("utf-8"))  # type: ignore[no-any-return]


def test_geojson_comes_back_with_multipoints_heights_and_text_ids(tmp_path: Path) -> None:
    points = np.array([388_500.0, 5_819_500.0]) + 20.0 * np.arange(8.0).reshape(4, 2)
    pole_map = make_map(points, frame=EarthFrame("utm", 32633), ids=np.array([4, 7, 9, 12]))
    path = tmp_path / "m.geojson"
    document = _geojson(pole_map, path)
    first, second = document["features"][0]["geometry"], document["features"][1]["geometry"]
    place = first["coordinates"]
    first.update(type="MultiPoint", coordinates=[place, [place[0] + 1e-4, place[1]]])
    second["coordinates"].append(35.0)
    path.write_text(json.dumps(document), "utf-8")
    edited = read_map(path)
    assert edited.ids.tolist() == [4, 13, 7, 9, 12]
    assert edited.points_m[[0, 2, 3, 4]] == pytest.approx(points)
    for word in ("multipoints hold 2", "(z)", "had no id"):
        assert any(word in note for note in edited.notes)
    for feature in document["features"]:
        feature["properties"]["id"] = f"lamp-{feature['properties']['id']}"
    path.write_text(json.dumps(document), "utf-8")
    texts = read_map(path)
    assert texts.extra["id_text"][0] == "lamp-4"
    document["features"][0]["properties"]["width_m"] = "wide"
    path.write_text(json.dumps(document), "utf-8")
    with pytest.raises(InputError, match="width_m holds 'wide'"):
        read_map(path)


def test_geojson_in_the_system_that_it_names(tmp_path: Path) -> None:
    points = np.array([388_500.0, 5_819_500.0]) + 20.0 * np.arange(8.0).reshape(4, 2)
    pole_map = make_map(points, frame=EarthFrame("utm", 32633))
    path = tmp_path / "m.geojson"
    document = _geojson(pole_map, path)
    for feature, point in zip(document["features"], pole_map.to_frame(
        EarthFrame("utm", 32632)).points_m, strict=True):  # fmt: skip
        feature["geometry"]["coordinates"] = point.tolist()
    name = "urn:ogc:def:crs:EPSG::32632"
    document["crs"] = {"type": "name", "properties": {"name": name}}
    path.write_text(json.dumps(document), "utf-8")
    moved = read_map(path)
    assert moved.points_m == pytest.approx(points, abs=1e-3)
    assert any("member crs" in note for note in moved.notes)
    document["crs"]["properties"]["name"] = "urn:ogc:def:crs:OGC:1.3:CRS84"
    path.write_text(json.dumps(document), "utf-8")
    with pytest.raises(InputError):
        read_map(path)
    document["crs"]["properties"]["name"] = "no system"
    path.write_text(json.dumps(document), "utf-8")
    with pytest.raises(InputError, match="'no system' cannot be read"):
        read_map(path)
    document["crs"]["properties"]["name"] = name
    document["features"][0]["geometry"]["coordinates"] = [1e300, 1e300]
    path.write_text(json.dumps(document), "utf-8")
    with pytest.raises(InputError, match="have no place"):
        read_map(path)


def test_a_point_moved_in_geojson_counts_and_is_said(tmp_path: Path) -> None:
    points = np.array([388_500.0, 5_819_500.0]) + 20.0 * np.arange(24.0).reshape(12, 2)
    pole_map = make_map(points, frame=EarthFrame("utm", 32633))
    write_map(pole_map, tmp_path / "m.geojson")
    assert not read_map(tmp_path / "m.geojson").notes
    document = json.loads((tmp_path / "m.geojson").read_text("utf-8"))
    document["features"][2]["geometry"]["coordinates"][1] += 1e-4
    (tmp_path / "m.geojson").write_text(json.dumps(document), "utf-8")
    moved = read_map(tmp_path / "m.geojson")
    assert np.hypot(*(moved.points_m[2] - pole_map.points_m[2])) == pytest.approx(11.1, abs=0.2)
    assert moved.points_m[3].tolist() == pole_map.points_m[3].tolist()
    assert any("1 points do not stand" in note for note in moved.notes)


def test_geojson_of_a_local_frame_does_not_look_like_wgs84(tmp_path: Path) -> None:
    local = make_map(np.array([[1.0, 2.0], [3.0, 4.0]]), frame=EarthFrame("local", name="park"))
    write_map(local, tmp_path / "m.geojson")
    system = geopandas.read_file(tmp_path / "m.geojson").crs
    assert system is None or not system.is_geographic
    assert read_map(tmp_path / "m.geojson").frame == local.frame


@pytest.mark.parametrize("name", ["id", "observations"])
@pytest.mark.parametrize("value", [2**63, 1e300, -1e19])
def test_numbers_that_no_whole_number_holds_are_one_line(
    tmp_path: Path, name: str, value: float
) -> None:
    points = np.array([388_500.0, 5_819_500.0]) + 20.0 * np.arange(8.0).reshape(4, 2)
    path = tmp_path / "m.geojson"
    document = _geojson(make_map(points, frame=EarthFrame("utm", 32633)), path)
    document["features"][2]["properties"][name] = value
    path.write_text(json.dumps(document), "utf-8")
    with pytest.raises(InputError, match=f"{name}.*beyond what a whole number holds"):
        read_map(path)
