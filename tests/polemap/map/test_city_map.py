"""A map that is opened by tiles holds what the whole map holds."""

import copy
import json
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.city.city_map import CityMap
from polemap.map.city.geopackage.io import TILE_M, GeoPackageTiles
from polemap.map.city.io import open_city, open_map
from polemap.map.city.packing import boxes_of, packed_order
from polemap.map.city.parquet.io import ParquetTiles
from polemap.map.city.statistics import MapStatistics
from polemap.map.city.tiles import box_around
from polemap.map.io import read_map, write_map
from polemap.map.pole_map import PoleMap
from tests.city_maps import write_city
from tests.pole_maps import plain_map

ORIGIN = np.array([450_000.0, 5_400_000.0])
SIDE_M, COUNT = 3000.0, 4000


def make_city(seed: int = 0, count: int = COUNT) -> PoleMap:
    """Poles in no order; some exactly on the borders of tiles, and at their corners."""
    rng = np.random.default_rng(seed)
    points = ORIGIN + rng.uniform(0.0, SIDE_M, (count, 2))
    points[:40, 0] = ORIGIN[0] + TILE_M * (1 + np.arange(40) % 5)
    points[20:60, 1] = ORIGIN[1] + TILE_M * (1 + np.arange(40) % 4)
    plain = plain_map(points)
    return replace(
        plain,
        frame=EarthFrame("utm", 32633),
        ids=rng.permutation(count) + 7,
        width_m=np.where(rng.random(count) < 0.3, np.nan, rng.uniform(0.1, 0.5, count)),
        existence=rng.uniform(0.2, 1.0, count),
        extra={"history": np.array([f'"{i}"' for i in range(count)])},
    )


@pytest.fixture(scope="module")
def city() -> PoleMap:
    return make_city()


@pytest.fixture(scope="module")
def files(city: PoleMap, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The city in every format that is read by tiles, however small it is."""
    folder = tmp_path_factory.mktemp("city")
    return write_city(city, folder)


def by_id(pole_map: PoleMap) -> PoleMap:
    return pole_map.rows(np.argsort(pole_map.ids, kind="stable"))


def assert_same(first: PoleMap, second: PoleMap) -> None:
    assert first.frame == second.frame
    for name in ("ids", "points_m", "covariance_m2", "width_m", "observations", "drives",
                 "existence"):  # fmt: skip
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), name)


ENDINGS = pytest.mark.parametrize("ending", ["gpkg", "parquet"])


@ENDINGS
@settings(max_examples=40, deadline=None)
@given(
    east=st.floats(-0.2, 1.2), north=st.floats(-0.2, 1.2), radius_m=st.floats(0.0, 900.0),
    on_border=st.booleans(),
)  # fmt: skip
def test_a_window_holds_what_the_whole_map_holds(
    city: PoleMap, files: dict[str, Path], ending: str, east: float, north: float,
    radius_m: float, on_border: bool,
) -> None:  # fmt: skip
    opened = open_city(files[ending])
    assert opened is not None
    centre = ORIGIN + SIDE_M * np.array([east, north])
    if on_border:
        centre, radius_m = np.round(centre / TILE_M) * TILE_M, np.round(radius_m / TILE_M) * TILE_M
    distance = np.hypot(*(city.points_m - centre).T)
    assert_same(
        by_id(opened.poles_within(centre, radius_m)), by_id(city.rows(distance <= radius_m))
    )
    box = box_around(centre, radius_m)
    within = ((city.points_m >= box[:2]) & (city.points_m <= box[2:])).all(axis=1)
    assert_same(by_id(opened.poles_in(box)), by_id(city.rows(within)))


@ENDINGS
def test_poles_come_in_the_order_in_which_the_file_is_read_whole(
    files: dict[str, Path], ending: str
) -> None:
    opened, whole = open_city(files[ending]), read_map(files[ending])
    assert opened is not None
    centre = ORIGIN + SIDE_M / 2
    assert_same(opened.poles_within(centre, 700.0), whole.rows(whole.within(centre, 700.0)))


@ENDINGS
def test_two_boxes_that_overlap_give_each_pole_once(
    city: PoleMap, files: dict[str, Path], ending: str
) -> None:
    opened = open_city(files[ending])
    assert opened is not None
    boxes = np.array([box_around(ORIGIN + 800.0, 300.0), box_around(ORIGIN + 1000.0, 300.0)])
    area = opened.area(boxes)
    assert_same(by_id(area.poles), by_id(city.rows(area.known(city.points_m))))
    assert len(area.unread) == 0


@ENDINGS
def test_all_tiles_together_are_the_map(city: PoleMap, files: dict[str, Path], ending: str) -> None:
    opened = open_city(files[ending])
    assert opened is not None
    tiles = list(opened.tiles(("history",)))
    ids = np.concatenate([tile.poles.ids for tile in tiles])
    texts = np.concatenate([tile.poles.extra["history"] for tile in tiles])
    order = np.argsort(ids)
    np.testing.assert_array_equal(ids[order], np.sort(city.ids))
    np.testing.assert_array_equal(texts[order], by_id(city).extra["history"])
    rows = np.concatenate([tile.rows for tile in tiles])
    assert len(np.unique(rows)) == len(city)
    assert len(opened) == len(city)


@ENDINGS
def test_opening_reads_no_poles_and_knows_all_of_them(
    city: PoleMap, files: dict[str, Path], ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(*_: object) -> None:
        raise AssertionError("a tile was read")

    for store in (GeoPackageTiles, ParquetTiles):
        monkeypatch.setattr(store, "read", read)
    opened = open_city(files[ending])
    assert opened is not None
    assert opened.statistics == replace(
        MapStatistics.of(city), further=opened.statistics.further
    ) or str(opened.statistics) == str(MapStatistics.of(city))
    assert opened.kinds == (0,)


@ENDINGS
def test_memory_is_bounded_by_what_is_kept(files: dict[str, Path], ending: str) -> None:
    first = open_city(files[ending])
    assert first is not None
    opened = CityMap(first._store, cached_poles=500)
    for east in np.linspace(0.0, SIDE_M, 30):
        opened.poles_within(ORIGIN + np.array([east, SIDE_M / 2]), 50.0)
        assert sum(len(tile.rows) for tile in opened._cache.values()) == opened._cached
        assert opened._cached <= 500 or len(opened._cache) == 1


@ENDINGS
def test_another_zone_is_transformed_tile_by_tile(
    city: PoleMap, files: dict[str, Path], ending: str
) -> None:
    other = EarthFrame("utm", 32632)
    opened, moved = open_city(files[ending], other), by_id(city.to_frame(other))
    assert opened is not None
    assert opened.notes == moved.notes
    centre = moved.points_m.mean(axis=0)
    chosen = moved.rows(np.hypot(*(moved.points_m - centre).T) <= 400.0)
    assert_same(by_id(opened.poles_within(centre, 400.0)), chosen)
    extent = np.array(opened.statistics.extent_m)
    assert (moved.points_m >= extent[:2]).all()
    assert (moved.points_m <= extent[2:]).all()
    with pytest.raises(FrameError, match="no transformation leads"):
        open_city(files[ending], EarthFrame("local", name="park"))


@ENDINGS
def test_it_can_be_sent_to_another_process(files: dict[str, Path], ending: str) -> None:
    opened = open_city(files[ending])
    assert opened is not None
    again = copy.deepcopy(opened)
    assert_same(
        again.poles_within(ORIGIN + 500.0, 200.0), opened.poles_within(ORIGIN + 500.0, 200.0)
    )


@ENDINGS
def test_distances_to_the_nearest_pole(city: PoleMap, files: dict[str, Path], ending: str) -> None:
    opened = open_city(files[ending])
    assert opened is not None
    places = ORIGIN + np.array([[10.0, 10.0], [1500.0, 700.0], [-500.0, 0.0]])
    nearest = city.nearest(places, 300.0)[0]
    np.testing.assert_allclose(opened.nearest_m(places, 300.0), nearest, rtol=1e-12)


def damage(path: Path, opened: CityMap) -> Path:
    """Overwrites the middle of what holds the poles; whether in place is for the caller."""
    data = bytearray(path.read_bytes())
    if path.suffix == ".parquet":
        # row group 20 of 63, somewhere in the first two thirds, which hold the columns
        start = len(data) // 4
        data[start : start + 64] = bytes(64)
    else:
        with closing(sqlite3.connect(path)) as database:
            (size,) = database.execute("PRAGMA page_size").fetchone()
        page = next(
            n for n in range(len(data) // size // 3, len(data) // size) if data[n * size] == 13
        )
        data[page * size : page * size + 200] = b"\xff" * 200
    copy = path.with_name(f"damaged{path.suffix}")
    copy.write_bytes(bytes(data))
    return copy


@ENDINGS
def test_a_damaged_tile_is_one_line_and_costs_its_poles_only(
    city: PoleMap, files: dict[str, Path], ending: str, caplog: pytest.LogCaptureFixture
) -> None:
    sound = open_city(files[ending])
    assert sound is not None
    opened = open_city(damage(files[ending], sound))
    assert opened is not None
    everywhere = np.array([[*ORIGIN - 10.0, *ORIGIN + SIDE_M + 10.0]])
    for _ in range(2):
        area = opened.area(everywhere)
    assert 1 <= len(area.unread) < 40
    assert len(opened.damaged) == len(area.unread) == len(caplog.records)
    assert all("restore it" in text and "\n" not in text for text in opened.damaged.values())
    known = area.known(city.points_m)
    assert known.mean() > 0.5
    # what stands on the edge of a damaged box may still be known
    assert set(city.ids[known]) <= set(area.poles.ids)
    with pytest.raises(InputError, match=r"(is damaged|cannot be read) .*restore it"):
        opened.poles_in(everywhere[0])


def test_a_parquet_map_that_is_written_on_in_place_is_not_believed(
    city: PoleMap, tmp_path: Path
) -> None:
    path = write_city(city, tmp_path)["parquet"]
    opened = open_city(path)
    assert opened is not None
    other = write_city(make_city(1), tmp_path / "other")["parquet"]
    path.write_bytes(other.read_bytes())
    with pytest.raises(InputError, match="has changed since it was opened"):
        opened.poles_within(ORIGIN + 500.0, 100.0)


@ENDINGS
def test_a_map_that_is_exchanged_whole_stays_as_it_was_opened(
    city: PoleMap, tmp_path: Path, ending: str
) -> None:
    path = write_city(city, tmp_path)[ending]
    opened = open_city(path)
    assert opened is not None
    shutil.move(write_city(make_city(1), tmp_path / "new")[ending], path)
    distance = np.hypot(*(city.points_m - ORIGIN - 500.0).T)
    assert_same(
        by_id(opened.poles_within(ORIGIN + 500.0, 300.0)), by_id(city.rows(distance <= 300.0))
    )


def test_poles_that_a_gis_adds_or_takes_are_read_whole(city: PoleMap, tmp_path: Path) -> None:
    path = write_city(city, tmp_path)["gpkg"]
    import pyogrio

    table = pyogrio.read_dataframe(path, layer="poles").iloc[:10]
    pyogrio.write_dataframe(table, path, layer="poles", driver="GPKG", append=True)
    assert open_city(path) is None


def test_a_reprojected_or_rewritten_table_is_read_whole(city: PoleMap, tmp_path: Path) -> None:
    paths = write_city(city, tmp_path)
    import pyarrow.parquet as pq

    table = pq.read_table(paths["parquet"])
    pq.write_table(table, paths["parquet"], row_group_size=100)
    assert open_city(paths["parquet"]) is None
    with closing(sqlite3.connect(paths["gpkg"])) as database, database:
        database.execute(
            "INSERT OR IGNORE INTO gpkg_spatial_ref_sys VALUES ('x', 32632, 'EPSG', 32632, '', '')"
        )
        database.execute("UPDATE gpkg_geometry_columns SET srs_id = 32632")
    assert open_city(paths["gpkg"]) is None


NO_STATISTICS = {"format_version": 1, "frame": {"kind": "utm", "epsg": 32633}, "statistics": 3}


@pytest.mark.parametrize("text", ["{", "[]", '{"format_version": 1}', json.dumps(NO_STATISTICS)])
def test_metadata_that_cannot_be_read_are_one_line(
    city: PoleMap, tmp_path: Path, text: str
) -> None:
    paths = write_city(city, tmp_path)
    with closing(sqlite3.connect(paths["gpkg"])) as database, database:
        database.execute(
            "UPDATE gpkg_metadata SET metadata = ? WHERE md_standard_uri LIKE 'urn:%'", (text,)
        )
    with pytest.raises(InputError, match="metadata 'polemap_city' cannot be read"):
        open_city(paths["gpkg"])
    import pyarrow.parquet as pq

    table = pq.read_table(paths["parquet"])
    metadata = {**table.schema.metadata, b"polemap_city": text.encode()}
    pq.write_table(table.replace_schema_metadata(metadata), paths["parquet"])
    with pytest.raises(InputError, match="metadata 'polemap_city' cannot be read"):
        open_city(paths["parquet"])


def test_a_later_version_is_read_whole(city: PoleMap, tmp_path: Path) -> None:
    path = write_city(city, tmp_path)["gpkg"]
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(
            "UPDATE gpkg_metadata SET metadata = ? WHERE md_standard_uri LIKE 'urn:%'",
            (json.dumps({"format_version": 99}),),
        )
    assert isinstance(open_map(path), PoleMap)


def test_what_is_no_such_file_is_one_line(tmp_path: Path) -> None:
    for name in ("none.gpkg", "none.parquet"):
        with pytest.raises(InputError, match="no such map"):
            open_map(tmp_path / name)
        (tmp_path / f"bad_{name}").write_bytes(b"rubbish" * 100)
        with pytest.raises(InputError, match=r"not a (GeoPackage|Parquet file)"):
            open_map(tmp_path / f"bad_{name}")


@ENDINGS
def test_crowds_are_refused_where_they_stand(tmp_path: Path, ending: str) -> None:
    city = make_city()
    points = city.points_m.copy()
    points[:300] = ORIGIN + 700.0 + np.random.default_rng(0).uniform(0.0, 0.9, (300, 2))
    opened = open_city(write_city(replace(city, points_m=points), tmp_path)[ending])
    assert opened is not None
    if ending == "parquet":  # 64 poles a tile are no crowd
        return
    with pytest.raises(InputError, match="poles within 1 m of"):
        opened.poles_within(ORIGIN + 700.0, 50.0)
    assert len(opened.poles_within(ORIGIN + 2500.0, 50.0))


def test_a_large_map_is_written_and_opened_by_tiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is smaller than a city stays a map in memory, row for row."""
    small = make_city(count=300)
    for ending in ("gpkg", "parquet"):
        write_map(small, tmp_path / f"small.{ending}")
        read = open_map(tmp_path / f"small.{ending}")
        assert isinstance(read, PoleMap)
        assert_same(read, small)
    for module in ("city.io", "formats.geopackage.io", "io"):
        monkeypatch.setattr(f"polemap.map.{module}.CITY_POLES", 300)
    for ending in ("gpkg", "parquet"):
        write_map(small, tmp_path / f"city.{ending}")
        assert isinstance(open_map(tmp_path / f"city.{ending}"), CityMap)
        assert_same(by_id(read_map(tmp_path / f"city.{ending}")), by_id(small))
    write_map(small, tmp_path / "city.geojson")
    read = open_map(tmp_path / "city.geojson")
    assert isinstance(read, PoleMap)
    assert any("all of its 300 poles were read" in note for note in read.notes)


@pytest.mark.parametrize("count", [0, 1, 63, 64, 65, 1000])
def test_packed_tiles_hold_neighbours(count: int) -> None:
    points = np.random.default_rng(count).uniform(0.0, 1000.0, (count, 2))
    order = packed_order(points, 64)
    np.testing.assert_array_equal(np.sort(order), np.arange(count))
    boxes = boxes_of(points[order], 64)
    assert len(boxes) == -(-count // 64)
    if count == 1000:
        # 16 squares of a quarter of the side each, were they perfect
        assert np.prod(boxes[:, 2:] - boxes[:, :2], axis=1).sum() < 1.3 * 1000.0**2


def test_statistics_of_a_map_without_poles_and_of_one(tmp_path: Path) -> None:
    for pole_map in (PoleMap.empty(EarthFrame("local", name="x")), plain_map([[1.0, 2.0]])):
        found = MapStatistics.of(pole_map)
        assert str(MapStatistics.from_dict(json.loads(json.dumps(found.to_dict())))) == str(found)
        assert found.poles == len(pole_map)


def test_neighbours_of_a_large_map_are_looked_for_in_some_tiles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    city = make_city()
    exact = MapStatistics.of(city)
    monkeypatch.setattr("polemap.map.city.statistics._ALL_NEIGHBOURS", 100)
    monkeypatch.setattr("polemap.map.city.statistics.TILE_POLES", 256)
    sampled = MapStatistics.of(city)
    assert sampled.spacing_m == pytest.approx(exact.spacing_m, rel=0.15)
    assert replace(sampled, spacing_m=0.0, doubled=0, neighbours=0, height_m=(0.0,) * 3) == replace(
        exact, spacing_m=0.0, doubled=0, neighbours=0, height_m=(0.0,) * 3
    )
