"""Maps that came back from a GIS: reprojected, with points added, moved, exploded or renamed."""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
import pyarrow as pa
import pyogrio
import pytest
import shapely
from pyarrow import parquet

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.drivelog.streams import ReferenceStream
from polemap.map.formats.osm import from_xml
from polemap.map.io import read_map, write_map
from polemap.map.plausibility import check_map, check_map_of_drive
from polemap.map.pole_map import PoleMap
from tests.pole_maps import plain_map


def make_map(points_m: np.ndarray, **changes: object) -> PoleMap:
    return replace(plain_map(points_m), **changes)


@pytest.fixture(params=["gpkg", "parquet"])
def made(tmp_path: Path, request: pytest.FixtureRequest) -> tuple[PoleMap, Path]:
    rng = np.random.default_rng(0)
    points = np.array([388_500.0, 5_819_500.0]) + 200.0 * rng.random((12, 2))
    pole_map = make_map(points, frame=EarthFrame("utm", 32633), ids=10 + 3 * np.arange(12))
    path = tmp_path / f"map.{request.param}"
    write_map(pole_map, path)
    return pole_map, path


def _edit(path: Path, change, **options) -> Path:  # type: ignore[no-untyped-def]
    """Rewrite the layer as a GIS does: the metadata stay."""
    if path.suffix == ".parquet":
        out = path.with_name("edited.parquet")
        change(geopandas.read_parquet(path)).to_parquet(out)
        ours = parquet.read_schema(path).metadata[b"polemap"]
        edited = parquet.read_table(out)
        metadata = {**edited.schema.metadata, b"polemap": ours}
        parquet.write_table(edited.replace_schema_metadata(metadata), out)
        return out
    metadata = pyogrio.read_info(path, layer="poles")["layer_metadata"]
    table = change(geopandas.read_file(path, layer="poles"))
    out = path.with_name("edited.gpkg")
    pyogrio.write_dataframe(
        table, out, layer="poles", driver="GPKG",
        layer_metadata={"polemap": metadata["polemap"]} | options,
    )  # fmt: skip
    return out


@pytest.mark.parametrize("epsg", [32632, 25833, 3857, 4326])
def test_the_layers_own_reference_system_counts(made: tuple[PoleMap, Path], epsg: int) -> None:
    pole_map, path = made
    edited = read_map(_edit(path, lambda table: table.to_crs(epsg)))
    assert any(f"EPSG:{epsg}" in note and "counts" in note for note in edited.notes)
    there = geographic_from_grid(edited.frame, edited.points_m)
    here = geographic_from_grid(pole_map.frame, pole_map.points_m)
    assert np.abs(there - here).max() < 1e-6
    assert edited.ids.tolist() == pole_map.ids.tolist()


def test_a_point_added_by_hand_is_a_pole_without_history(made: tuple[PoleMap, Path]) -> None:
    pole_map, path = made

    def add(table: geopandas.GeoDataFrame) -> geopandas.GeoDataFrame:
        point = shapely.Point(388_600.0, 5_819_600.0)
        new = geopandas.GeoDataFrame({"geometry": [point]}, crs=table.crs)
        return geopandas.GeoDataFrame(pd.concat([table, new], ignore_index=True), crs=table.crs)

    edited = read_map(_edit(path, add))
    assert edited.ids[:-1].tolist() == pole_map.ids.tolist()
    assert edited.ids[-1] == pole_map.ids.max() + 1
    assert edited.observations[-1] == 0
    assert np.isnan(edited.width_m[-1])
    assert any("had no id" in note for note in edited.notes)


def test_multipoints_heights_and_missing_places(made: tuple[PoleMap, Path]) -> None:
    pole_map, path = made

    def change(table: geopandas.GeoDataFrame) -> geopandas.GeoDataFrame:
        geometry = [shapely.MultiPoint([(p.x, p.y)]) for p in table.geometry]
        first = table.geometry[0]
        geometry[0] = shapely.MultiPoint([(first.x, first.y), (388e3, 58e5)])
        geometry[3] = None
        return table.set_geometry(geopandas.GeoSeries(geometry, crs=table.crs))

    edited = read_map(_edit(path, change))
    assert len(edited) == len(pole_map)
    assert set(edited.ids) >= set(pole_map.ids) - {pole_map.ids[3]}
    assert any("multipoints" in note for note in edited.notes)
    assert any("without a place" in note for note in edited.notes)
    raised = _edit(path, lambda t: t.set_geometry(shapely.force_3d(t.geometry.array, 35.0)))
    solid = read_map(raised)
    assert solid.points_m == pytest.approx(pole_map.points_m)
    assert any("(z)" in note for note in solid.notes)


def test_ids_that_are_texts_are_kept_beside(made: tuple[PoleMap, Path]) -> None:
    pole_map, path = made
    texts = read_map(_edit(path, lambda t: t.assign(id=[f"lamp-{i}" for i in t.id])))
    assert texts.extra["id_text"][0] == f"lamp-{pole_map.ids[0]}"
    assert any("numbered anew" in note for note in texts.notes)
    numbers = read_map(_edit(path, lambda t: t.assign(id=t.id.astype(str))))
    assert numbers.ids.tolist() == pole_map.ids.tolist()


def test_lines_and_words_for_numbers_are_refused(made: tuple[PoleMap, Path]) -> None:
    _, path = made
    lines = _edit(path, lambda t: t.set_geometry(t.geometry.buffer(1.0)))
    with pytest.raises(InputError, match="it holds Polygon"):
        read_map(lines)
    words = _edit(path, lambda t: t.assign(width_m="wide"))
    with pytest.raises(InputError, match="width_m holds 'wide'"):
        read_map(words)


def test_parquet_without_a_system_of_its_own_is_longitude_and_latitude(tmp_path: Path) -> None:
    points = shapely.points([[13.35, 52.51], [13.36, 52.52]])
    table = geopandas.GeoDataFrame({"width_m": [0.2, None]}, geometry=points, crs=4326)
    table.to_parquet(tmp_path / "lamps.parquet")
    written = parquet.read_table(tmp_path / "lamps.parquet")
    geo = json.loads(written.schema.metadata[b"geo"])
    del geo["columns"]["geometry"]["crs"]
    parquet.write_table(
        written.replace_schema_metadata({"geo": json.dumps(geo)}), tmp_path / "lamps.parquet"
    )
    pole_map = read_map(tmp_path / "lamps.parquet")
    assert pole_map.frame == EarthFrame("utm", 32633)
    there = geographic_from_grid(pole_map.frame, pole_map.points_m)
    assert there == pytest.approx(np.array([[52.51, 13.35], [52.52, 13.36]]), abs=1e-7)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"encoding": "point"}, "encoded as 'point'"),
        ({"crs": "EPSG:1"}, "reference system cannot be read"),
    ],
)
def test_parquet_whose_geometry_cannot_be_read(
    change: dict[str, str], said: str, tmp_path: Path
) -> None:
    write_map(make_map(np.array([[1.0, 2.0]])), tmp_path / "m.parquet")
    table = parquet.read_table(tmp_path / "m.parquet")
    geo = json.loads(table.schema.metadata[b"geo"])
    geo["columns"]["geometry"].update(change)
    metadata = {**table.schema.metadata, b"geo": json.dumps(geo)}
    parquet.write_table(table.replace_schema_metadata(metadata), tmp_path / "m.parquet")
    with pytest.raises(InputError, match=said):
        read_map(tmp_path / "m.parquet")


def test_parquet_with_numbers_for_its_points_is_refused(tmp_path: Path) -> None:
    table = pa.table({"geometry": [1, 2], "width_m": [0.1, 0.2]})
    parquet.write_table(table, tmp_path / "m.parquet")
    with pytest.raises(InputError, match="holds no WKB"):
        read_map(tmp_path / "m.parquet", EarthFrame("utm", 32633))


@pytest.mark.parametrize(
    ("tags", "width_m", "height_m"),
    [
        ({"diameter": "150"}, 0.15, None),
        ({"diameter": "15 cm"}, 0.15, None),
        ({"diameter": "0.15 m"}, 0.15, None),
        ({"diameter": '6"'}, 0.1524, None),
        ({"circumference": "1.57"}, 0.4997, None),
        ({"circumference": "157 cm"}, 0.4997, None),
        ({"height": "39'4\""}, None, 11.989),
        ({"height": "39 ft 4 in"}, None, 11.989),
        ({"height": "12,5"}, None, 12.5),
        ({"height": "about 12"}, None, None),
        ({"height": "12 13"}, None, None),
    ],
)
def test_openstreetmap_lengths(
    tags: dict[str, str], width_m: float | None, height_m: float | None
) -> None:
    inner = "".join(
        f"<tag k='{key}' v='{value.replace(chr(39), '&apos;')}'/>" for key, value in tags.items()
    )
    document = (
        "<osm><node id='1' lat='52.5' lon='13.4'><tag k='highway' v='street_lamp'/>"
        f"{inner}</node></osm>"
    )
    pole_map = from_xml(document.encode(), None)
    for value, expected in ((pole_map.width_m[0], width_m), (pole_map.height_m[0], height_m)):
        assert value == pytest.approx(
            np.nan if expected is None else expected, abs=1e-3, nan_ok=True
        )


@pytest.mark.parametrize("factor", [1000.0, 100.0, -1.0])
def test_widths_that_no_pole_has_are_found(factor: float) -> None:
    points = 10.0 * np.arange(20.0).reshape(-1, 2)
    width = np.full(10, 0.2)
    assert check_map(make_map(points, width_m=width)) == []
    assert [f.severity for f in check_map(make_map(points, width_m=factor * width))] == ["error"]


def _without_layer(path: Path, layer: str) -> Path:
    """The layer's table is gone, its row in the contents stays."""
    out = path.with_name(f"no_{layer}.gpkg")
    shutil.copy(path, out)
    with closing(sqlite3.connect(out)) as database, database:
        database.execute(f"DROP TABLE {layer}")
    return out


def test_a_layer_that_is_gone_is_said_once_and_doubtful_poles_are_no_map(
    tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    points = np.array([388_500.0, 5_819_500.0]) + 20.0 * np.arange(8.0).reshape(4, 2)
    frame = EarthFrame("utm", 32633)
    pole_map = make_map(points, frame=frame, doubtful=make_map(points[:1] + 5.0, frame=frame))
    write_map(pole_map, tmp_path / "m.gpkg")
    left = read_map(_without_layer(tmp_path / "m.gpkg", "doubtful"))
    assert len(left) == 4
    assert len([note for note in left.notes if "doubtful" in note]) == 1
    assert not recwarn.list
    with pytest.raises(InputError, match="'poles' is missing, 'doubtful' alone is no map"):
        read_map(_without_layer(tmp_path / "m.gpkg", "poles"))


@pytest.mark.parametrize("zone", [32632, 32634, 32631])
def test_a_drive_in_another_zone_than_its_map_is_told_which(zone: int) -> None:
    points = np.array([388_500.0, 5_819_500.0]) + 20.0 * np.arange(40.0).reshape(20, 2)
    pole_map = make_map(points, frame=EarthFrame("utm", 32633))
    poses = np.column_stack([points, np.zeros(len(points))])
    stamps = np.arange(20.0)
    reference = ReferenceStream(stamps, poses, np.full(20, np.nan))
    drive = Drive("d", Path("d"), EarthFrame("utm", zone), 2.7, reference=reference)
    (found,) = check_map_of_drive(pole_map.to_frame(drive.frame), drive)
    assert (found.kind, found.severity) == ("map_far", "error")
    assert found.remedy == f"write epsg 32633 in {drive.names.head}"
    right = replace(drive, frame=pole_map.frame)
    assert check_map_of_drive(pole_map, right) == []
    far = replace(right, reference=replace(reference, poses=poses + np.array([5e4, 0, 0])))
    assert "use a map of this place" in check_map_of_drive(pole_map, far)[0].remedy
