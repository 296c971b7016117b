"""A folder of map files is one map."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.city.folder import io as folders
from polemap.map.city.io import open_city, open_map
from polemap.map.city.statistics import MapStatistics, together
from polemap.map.files.io import map_files
from polemap.map.io import write_map
from polemap.map.pole_map import PoleMap
from tests.city_maps import opened, write_city
from tests.polemap.map.city.cities import ORIGIN, SIDE_M, assert_same, by_id, make_city


@pytest.fixture(scope="module")
def city() -> PoleMap:
    return make_city(count=1500)


@pytest.fixture
def folder(city: PoleMap, tmp_path: Path) -> Path:
    """A city in four districts, of both formats, one of them in many tiles; and a note beside."""
    path = tmp_path / "districts"
    path.mkdir()
    quarter = ((city.points_m > ORIGIN + SIDE_M / 2) * [1, 2]).sum(axis=1)
    for number, ending in enumerate(("gpkg", "parquet", "gpkg")):
        write_map(city.rows(quarter == number), path / f"{number}.{ending}")
    tiled = write_city(city.rows(quarter == 3), tmp_path / "tiled")["parquet"]
    tiled.rename(path / "3.parquet")
    (path / "readme.txt").write_text("districts")
    return path


def test_it_holds_what_its_files_hold(city: PoleMap, folder: Path) -> None:
    together_ = open_map(folder)
    assert not isinstance(together_, PoleMap)
    assert len(together_) == len(city)
    for centre in (ORIGIN + SIDE_M / 2, ORIGIN + 100.0, ORIGIN + np.array([2900.0, 200.0])):
        distance = np.hypot(*(city.points_m - centre).T)
        assert_same(
            by_id(together_.poles_within(centre, 600.0)), by_id(city.rows(distance <= 600.0))
        )
    ids = np.concatenate([tile.poles.ids for tile in together_.tiles()])
    np.testing.assert_array_equal(np.sort(ids), np.sort(city.ids))
    again = copy.deepcopy(together_)  # by the protocol that sends it to another process
    assert_same(again.poles_within(ORIGIN, 500.0), together_.poles_within(ORIGIN, 500.0))


def test_its_statistics_are_those_of_all_poles(city: PoleMap, folder: Path) -> None:
    found, exact = opened(folder).statistics, MapStatistics.of(city)
    for name in ("poles", "extent_m", "kinds", "widths", "heights", "width_max_m", "wide",
                 "negative", "observations", "drives", "existence", "neighbours"):  # fmt: skip
        assert getattr(found, name) == getattr(exact, name), name
    assert found.spacing_m == pytest.approx(exact.spacing_m, rel=0.1)
    np.testing.assert_allclose(found.width_m, exact.width_m, rtol=0.1)
    empty = MapStatistics.of(PoleMap.empty(city.frame))
    assert together([empty, empty]).poles == together([]).poles == 0


def test_few_files_are_held_open(
    city: PoleMap, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "_OPEN", 1)
    found = opened(folder)
    box = [*ORIGIN - 1.0, *ORIGIN + SIDE_M + 1.0]
    assert_same(by_id(found.poles_in(box)), by_id(city))
    assert len(found._store._open) == 1


def test_a_file_that_goes_costs_its_poles_only(
    city: PoleMap, folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    found = opened(folder)
    (folder / "0.gpkg").unlink()
    found._store._open.clear()
    box = np.array([[*ORIGIN - 1.0, *ORIGIN + SIDE_M + 1.0]])
    area = found.area(box)
    assert len(area.unread) == 1
    assert set(area.poles.ids) == set(city.ids[(city.points_m > ORIGIN + SIDE_M / 2).any(axis=1)])
    assert [record.getMessage() for record in caplog.records] == [
        f"{folder / '0.gpkg'}: no such map; restore it; its poles are left out"
    ]


def test_a_district_that_is_mapped_anew_is_seen_by_who_opens_it_then(
    city: PoleMap, folder: Path
) -> None:
    write_map(city.rows([0, 1, 2]), folder / "0.gpkg")
    assert len(opened(folder)) < len(city)


def test_one_frame_for_all(city: PoleMap, folder: Path) -> None:
    other = replace(city.rows([0]), frame=EarthFrame("utm", 32632))
    write_map(other, folder / "9.gpkg")
    with pytest.raises(FrameError, match=r"0.gpkg is in EPSG:32633, 9.gpkg in EPSG:32632"):
        open_city(folder)


def test_what_cannot_be_opened_by_tiles_is_named(folder: Path, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    table = pq.read_table(folder / "1.parquet").replace_schema_metadata({})
    pq.write_table(table, folder / "5.parquet")
    with pytest.raises(InputError, match=r"5.parquet: cannot be opened by tiles; write it anew"):
        open_city(folder)
    (folder / "5.parquet").write_bytes(b"rubbish")
    with pytest.raises(InputError, match=r"5.parquet: not a Parquet file"):
        open_city(folder)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no such map; a folder of maps holds"):
        open_map(tmp_path / "empty")


def test_a_drive_is_no_folder_of_maps(folder: Path) -> None:
    assert len(map_files(folder)) == 4
    (folder / "drive.yaml").write_text("format_version: 1")
    assert map_files(folder) == []
    assert map_files(folder / "0.gpkg") == []
    (folder / "drive.yaml").unlink()
    (folder / ".city.checkpoints").mkdir()
    assert len(map_files(folder)) == 4
    (folder / "monday").mkdir()
    assert map_files(folder) == []
