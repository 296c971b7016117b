"""Car files: round trip, and each thing that may be wrong with one."""

from __future__ import annotations

from pathlib import Path

import pytest

from polemap.vehicle.errors import VehicleError
from polemap.vehicle.io import car_names, dump_car, load_car, parse_car


@pytest.mark.parametrize("name", car_names())
def test_every_car_of_the_package_loads_and_comes_back(name: str) -> None:
    car = load_car(name)
    assert car.name == name
    assert parse_car(dump_car(car), "copy") == car


def test_a_file_of_the_users_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(dump_car(load_car("coms")))
    assert load_car(path) == load_car("coms")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[1, 2]", "holds `name: value`"),
        ("{", "not YAML"),
        ("name: x\nwings: 2\n", "unknown key wings"),
        ("name: x\nsource: y\n", "missing"),
        (dump_car(load_car("coms")).replace("380.0", "-1.0"), "mass_kg is -1.0"),
        (dump_car(load_car("coms")).replace("380.0", "heavy"), "not a number"),
        (dump_car(load_car("coms")).replace("380.0", ".nan"), "not a number"),
        (dump_car(load_car("coms")).replace("name: coms", "name: ''"), "a text is needed"),
    ],
)
def test_bad_car_files_say_what_is_wrong(content: str, message: str) -> None:
    with pytest.raises(VehicleError, match=message):
        parse_car(content, "car.yaml")


def test_unknown_names_and_missing_files() -> None:
    with pytest.raises(VehicleError, match="no car batmobile; known are"):
        load_car("batmobile")
    with pytest.raises(VehicleError, match="cannot be read"):
        load_car("nowhere/car.yaml")
