"""Tiles that are damaged, files that were edited, and what is no such map."""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.map.city.io import open_city, open_map
from polemap.map.pole_map import PoleMap
from tests.city_maps import write_city
from tests.polemap.map.city.cities import (
    ENDINGS,
    ORIGIN,
    SIDE_M,
    assert_same,
    by_id,
    damage,
    make_city,
)


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
