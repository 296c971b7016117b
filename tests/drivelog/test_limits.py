"""Values that no drive can hold, and crowds of poles that would take the square of their number."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.images import read_grey
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.tables import largest, read_table
from polemap.drivelog.tum import read_tum
from polemap.map.io import read_map, write_map
from tests.drivelog.drives import edit, write_small
from tests.pole_maps import plain_map


@pytest.mark.parametrize(
    ("name", "most"),
    [("stamp_s", 1e20), ("speed_mps", 1e5), ("yaw_rate_radps", 1e5), ("width_m", 1e9),
     ("var_x_m2", 1e16), ("yaw_rad", 1e6), ("probability", 1e18)],
)  # fmt: skip
def test_the_unit_in_a_name_bounds_its_values(name: str, most: float) -> None:
    assert largest(name) == most


def test_a_row_beyond_its_bounds_is_left_out_and_counted(tmp_path: Path) -> None:
    drive = write_small(tmp_path / "drive")
    rows = len(open_drive(drive).odometry or ())
    edit(drive / "odometry.csv", ",10.000000", ",1e308")
    opened = open_drive(drive)
    assert opened.odometry is not None
    assert len(opened.odometry) == rows - 1
    assert opened.problems["odometry_out_of_range"] == 1


def test_where_no_row_may_be_lost_it_is_named(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text("east_m,north_m,width_m\n1,2,0.3\n3,4,1e300\n")
    with pytest.raises(InputError, match="line 3: width_m is 1e\\+300, beyond the 1e\\+09"):
        read_table(path, ("east_m", "north_m"), optional=("width_m",), drop_not_finite=False)


def test_a_scan_of_too_many_poles_is_refused(tmp_path: Path) -> None:
    drive = write_small(tmp_path / "drive")
    head = (drive / "poles.csv").read_text().splitlines()[0]
    fixed = {"stamp_s": "100.05", "arrival_s": "100.1"}

    def rows(count: int) -> list[str]:
        return [
            ",".join(
                fixed.get(name, str(1.0 + 0.01 * k) if name == "x_m" else
                          "0.001" if "cov" in name else "0.01")
                for name in head.split(",")
            )
            for k in range(count)
        ]  # fmt: skip

    (drive / "poles.csv").write_text("\n".join([head, *rows(300)]) + "\n")
    assert len(open_drive(drive).scans[0]) == 300
    (drive / "poles.csv").write_text("\n".join([head, *rows(5000)]) + "\n")
    with pytest.raises(InputError, match=r"5000 poles at stamp_s 100.05.*, a scan may have 300"):
        open_drive(drive)


def test_a_crowd_of_poles_in_a_map_is_refused(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(0.0, 0.9, (201, 2))
    path = tmp_path / "map.gpkg"
    write_map(plain_map(points[:200]), path)
    assert len(read_map(path)) == 200
    write_map(plain_map(points), path)
    with pytest.raises(InputError, match="201 poles within 1 m of 0, 0 m, a map may have 200"):
        read_map(path)
    write_map(plain_map([points[0], [1e10, 0.0]]), path)
    with pytest.raises(InputError, match=r"stands at 1e\+10, .* beyond 1e\+09 m"):
        read_map(path)


def test_a_geopackage_is_a_database_and_nothing_else(tmp_path: Path) -> None:
    utm = replace(plain_map([[5e5, 5e6]]), frame=EarthFrame("utm", 32632))
    write_map(utm, tmp_path / "a.geojson")
    (tmp_path / "a.geojson").rename(tmp_path / "a.gpkg")
    with pytest.raises(InputError, match="not a GeoPackage \\(no SQLite database\\)"):
        read_map(tmp_path / "a.gpkg")


def test_a_picture_of_another_size_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    drive = write_small(tmp_path / "drive")
    picture = next((drive).rglob("*.png"))
    assert read_grey(picture, (64, 48)).shape == (48, 64)
    with pytest.raises(InputError, match="64x48 pixels, but the camera of the drive has 65x48"):
        read_grey(picture, (65, 48))


def test_names_that_no_system_has_are_named(tmp_path: Path) -> None:
    for name in ("a" * 300, "a\0b"):
        for read in (open_drive, read_map, read_tum):
            with pytest.raises(InputError):
                read(tmp_path / name)
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(InputError):
        open_drive(tmp_path / "loop")


@pytest.mark.parametrize("index", [5, 1, 3])
def test_a_trajectory_beyond_its_bounds_is_refused(index: int, tmp_path: Path) -> None:
    values = ["100.0", "1", "2", "0", "0", "0", "0", "1"]
    values[index] = "1e308"
    (tmp_path / "a.tum").write_text(" ".join(values) + "\n")
    with pytest.raises(InputError, match=r"= 1e\+308; every value .* must be finite and at most"):
        read_tum(tmp_path / "a.tum")


@pytest.mark.parametrize("name", ["a" * 201, "a\\0b", "red\\e[31m", "two\\nlines", ""])
def test_a_name_that_cannot_be_printed_is_refused(name: str, tmp_path: Path) -> None:
    drive = write_small(tmp_path / "drive")
    edit(drive / "drive.yaml", "name: small", f'name: "{name}"')
    with pytest.raises(InputError, match=r"drive.yaml: name: "):
        open_drive(drive)


def test_a_lap_that_cannot_be_printed_is_refused(tmp_path: Path) -> None:
    drive = write_small(tmp_path / "drive")
    edit(drive / "laps.csv", "two", "t\x1bwo")
    with pytest.raises(InputError, match=r"line 3: lap 't\\x1bwo' is no name of up to 200"):
        open_drive(drive)
