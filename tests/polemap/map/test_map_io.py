"""Maps on the disk: every format keeps every column, other programs read them, damage is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import geopandas
import numpy as np
import pyogrio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid, point_scale
from polemap.map.io import MAP_ENDINGS, check_writable, read_map, write_map
from polemap.map.pole_map import PoleMap

UTM = EarthFrame("utm", 32632)
LOCAL = EarthFrame("local", name="yard")
ENDINGS = ("gpkg", "geojson", "parquet")


def make_map(frame: EarthFrame = UTM, n: int = 5, seed: int = 0) -> PoleMap:
    rng = np.random.default_rng(seed)
    a = rng.normal(0, 0.1, (n, 2, 2))
    return PoleMap(
        frame=frame,
        ids=np.arange(n, dtype=np.int64) * 7 + 3,
        points_m=rng.uniform(0, 100, (n, 2)) + ((458000.0, 5.43e6) if frame.is_utm else (0.0, 0.0)),
        covariance_m2=a @ a.transpose(0, 2, 1) + 0.01 * np.eye(2),
        width_m=np.where(np.arange(n) % 3 == 0, np.nan, rng.uniform(0.1, 0.5, n)),
        height_m=np.full(n, np.nan),
        observations=rng.integers(1, 90, n),
        drives=rng.integers(1, 4, n),
        existence=rng.uniform(0.5, 1.0, n),
        extra={"passes": np.arange(n), "history": np.array([f'["{i}", "ä"]' for i in range(n)])},
    )


def assert_same(one: PoleMap, other: PoleMap) -> None:
    assert one.frame == other.frame
    np.testing.assert_array_equal(one.ids, other.ids)
    np.testing.assert_allclose(one.points_m, other.points_m, atol=1e-6)
    for name in ("covariance_m2", "width_m", "height_m", "existence", "observations", "drives"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-12)
    assert set(one.extra) == set(other.extra)
    for name, values in one.extra.items():
        np.testing.assert_array_equal(values, other.extra[name])


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("frame", [UTM, LOCAL], ids=["utm", "local"])
def test_round_trip(tmp_path: Path, ending: str, frame: EarthFrame) -> None:
    pole_map = replace(make_map(frame), doubtful=make_map(frame, 2, seed=9))
    path = tmp_path / f"map.{ending}"
    write_map(pole_map, path)
    back = read_map(path)
    assert_same(pole_map, back)
    assert back.doubtful is not None
    assert pole_map.doubtful is not None
    assert_same(pole_map.doubtful, back.doubtful)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@settings(max_examples=20, deadline=None)
@given(
    points=hnp.arrays(
        np.float64, st.tuples(st.integers(1, 20), st.just(2)), elements=st.floats(-1e6, 1e6)
    ),
    ending=st.sampled_from(ENDINGS),
)
def test_any_local_positions_survive(
    tmp_path_factory: pytest.TempPathFactory, points: np.ndarray, ending: str
) -> None:
    pole_map = replace(make_map(LOCAL, len(points)), points_m=points, extra={}, _tree=None)
    path = tmp_path_factory.mktemp("maps") / f"m.{ending}"
    write_map(pole_map, path)
    assert_same(pole_map, read_map(path))


def test_a_gis_reads_layer_system_and_fields(tmp_path: Path) -> None:
    pole_map = make_map()
    write_map(pole_map, tmp_path / "m.gpkg")
    info = pyogrio.read_info(tmp_path / "m.gpkg", layer="poles")
    assert info["crs"] == "EPSG:32632"
    assert info["geometry_type"] == "Point"
    assert {"id", "width_m", "var_east_m2", "existence", "drives"} <= set(info["fields"])
    write_map(pole_map, tmp_path / "m.parquet")
    table = geopandas.read_parquet(tmp_path / "m.parquet")
    assert table.crs.to_epsg() == 32632
    np.testing.assert_array_equal(table.geometry.x, pole_map.points_m[:, 0])


@pytest.mark.parametrize("metadata", ["{", "[]", "{}"])
def test_metadata_that_name_no_frame_are_named(tmp_path: Path, metadata: str) -> None:
    path = tmp_path / "m.gpkg"
    write_map(make_map(), path)
    table = pyogrio.read_dataframe(path, layer="poles")
    broken = tmp_path / "b.gpkg"
    pyogrio.write_dataframe(table, broken, layer="poles", layer_metadata={"polemap": metadata})
    with pytest.raises(InputError, match=r"b.gpkg: the frame in its metadata cannot be read"):
        read_map(broken)


def test_geojson_is_wgs84_with_the_grid_beside_it(tmp_path: Path) -> None:
    pole_map = make_map()
    write_map(pole_map, tmp_path / "m.geojson")
    document = json.loads((tmp_path / "m.geojson").read_text())
    assert document["type"] == "FeatureCollection"
    assert "crs" not in document  # RFC 7946, section 4
    place = geographic_from_grid(UTM, pole_map.points_m)
    for feature, (latitude, longitude), grid in zip(
        document["features"], place, pole_map.points_m, strict=True
    ):
        assert feature["geometry"]["type"] == "Point"
        np.testing.assert_allclose(
            feature["geometry"]["coordinates"], [longitude, latitude], atol=1e-9
        )
        properties = feature["properties"]
        np.testing.assert_allclose([properties["east_m"], properties["north_m"]], grid)
    assert document["features"][0]["properties"]["width_m"] is None
    read = pyogrio.read_dataframe(tmp_path / "m.geojson")
    assert read.crs.to_epsg() == 4326


def test_a_map_of_the_neighbouring_zone_is_transformed(tmp_path: Path) -> None:
    pole_map = make_map()
    write_map(pole_map, tmp_path / "m.gpkg")
    east = EarthFrame("utm", 32633)
    there = read_map(tmp_path / "m.gpkg", east)
    assert there.frame == east
    assert any("transformed from EPSG:32632" in note for note in there.notes)
    np.testing.assert_allclose(
        geographic_from_grid(UTM, pole_map.points_m), geographic_from_grid(east, there.points_m)
    )
    scale = point_scale(east, there.points_m) / point_scale(UTM, pole_map.points_m)
    np.testing.assert_allclose(
        np.linalg.det(there.covariance_m2) / np.linalg.det(pole_map.covariance_m2),
        scale**4,
        rtol=1e-5,
    )


def test_another_local_frame_is_refused(tmp_path: Path) -> None:
    write_map(make_map(LOCAL), tmp_path / "m.gpkg")
    with pytest.raises(FrameError, match=r"m.gpkg: the map is in local frame 'yard', the drive in"):
        read_map(tmp_path / "m.gpkg", EarthFrame("local", name="other"))
    with pytest.raises(FrameError, match="no transformation"):
        read_map(tmp_path / "m.gpkg", UTM)


def test_an_empty_map_is_refused_where_poles_are_needed(tmp_path: Path) -> None:
    for ending in ENDINGS:
        path = tmp_path / f"m.{ending}"
        write_map(PoleMap.empty(LOCAL), path)
        with pytest.raises(InputError, match=rf"m.{ending}: the map holds no poles"):
            read_map(path)
        assert len(read_map(path, allow_empty=True)) == 0


def test_csv_takes_the_frame_of_the_drive(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("east_m,north_m,width_m\n1.5,2.5,0.3\n4,5,\n")
    pole_map = read_map(path, LOCAL)
    np.testing.assert_array_equal(pole_map.points_m, [[1.5, 2.5], [4.0, 5.0]])
    assert pole_map.width_m[0] == 0.3
    assert np.isnan(pole_map.width_m[1])
    assert any("carries no frame" in note for note in pole_map.notes)
    with pytest.raises(InputError, match="a CSV map carries no frame"):
        read_map(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("east,north_m\n1,2\n", r"m.csv: column 'east_m' is missing \(found: east, north_m\)"),
        ("east_m,north_m\n1,2\n3,nan\n", "m.csv, line 3: north_m is nan"),
        ("east_m,north_m\n1,two\n", "m.csv, line 2: north_m is 'two'"),
        ("east_m,north_m\n", "the map holds no poles"),
        ("east_m,north_m,var_east_m2,var_north_m2\n1,2,-1,1\n", "is not positive definite"),
        ("east_m,north_m,existence\n1,2,7\n", "existence 7.0, not 0 to 1"),
        ("east_m,north_m,id\n1,2,4\n1,3,4\n", "the ids are not unique"),
    ],
)
def test_csv_damage(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "m.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        read_map(path, LOCAL)
    assert "m.csv" in str(error.value)
    assert "\n" not in str(error.value)


def test_lidar_maps_in_a_local_frame(recording: Callable[[str], Path]) -> None:
    path = recording("kitti_odometry") / "poles" / "03.csv"
    pole_map = read_map(path, EarthFrame("local", name="kitti_odometry_03"))
    assert len(pole_map) == 163
    np.testing.assert_allclose(pole_map.points_m[0], [6.8775, -5.4197])
    with pytest.raises(InputError, match="columns 'east_m', 'north_m' are missing"):
        read_map(path, UTM)


@pytest.mark.parametrize("ending", ENDINGS)
def test_what_is_no_map(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"m.{ending}"
    with pytest.raises(InputError, match="no such map"):
        read_map(path)
    path.write_bytes(b"\x00\x01 not a map at all")
    with pytest.raises(InputError) as error:
        read_map(path)
    assert f"m.{ending}" in str(error.value)
    assert "\n" not in str(error.value)


def test_endings(tmp_path: Path) -> None:
    (tmp_path / "m.shp").write_text("x")
    with pytest.raises(InputError, match="a map ends in one of"):
        read_map(tmp_path / "m.shp")
    for name in ("m.csv", "m", "m.zip"):
        with pytest.raises(InputError, match="a map is written as one of"):
            check_writable(tmp_path / name)
    assert ".csv" in MAP_ENDINGS


def test_geojson_damage(tmp_path: Path) -> None:
    path = tmp_path / "m.geojson"
    for text, message in (
        ('{"type": "Feature"}', "no GeoJSON FeatureCollection"),
        ('{"type": "FeatureCollection"}', "has no features"),
        (
            '{"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": '
            '{"type": "Point", "coordinates": ["a", 1]}, "properties": {}}]}',
            "feature 0: coordinates",
        ),
        (
            '{"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": '
            '{"type": "Point", "coordinates": [8, 49]}, "properties": {"width_m": "wide"}}]}',
            "width_m holds 'wide'",
        ),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_map(path)


def test_a_public_inventory_is_a_first_map(tmp_path: Path) -> None:
    """Street lamps as a city publishes them: WGS84 points, their own properties, a line among."""
    lamps = [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": [8.4, 49.0 + i / 1000]},
         "properties": {"mast": "steel", "nr": i}}
        for i in range(3)
    ]  # fmt: skip
    line = {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": [[8, 49], [9, 49]]},
        "properties": {},
    }
    path = tmp_path / "lamps.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [*lamps, line]}))
    pole_map = read_map(path)
    assert pole_map.frame == UTM
    assert len(pole_map) == 3
    np.testing.assert_allclose(geographic_from_grid(UTM, pole_map.points_m)[1], [49.001, 8.4])
    assert pole_map.extra["mast"].tolist() == ["steel"] * 3
    assert any("1 features that are not points" in note for note in pole_map.notes)
    assert any("no covariance: 0.2 m" in note for note in pole_map.notes)
