"""Car files: `cars/*.yaml` of this package, or a file of the user's."""

from __future__ import annotations

from dataclasses import asdict, fields
from importlib.resources import files
from pathlib import Path

import yaml

from polemap.parsing.errors import named
from polemap.parsing.text import read_text
from polemap.parsing.yaml_text import LARGEST_BYTES, parse_yaml
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.parameters import Car


def car_names() -> list[str]:
    """Names of the cars that come with the package."""
    folder = files("polemap.vehicle") / "cars"
    return sorted(
        f.name.removesuffix(".yaml") for f in folder.iterdir() if f.name.endswith(".yaml")
    )


def load_car(name_or_file: str | Path) -> Car:
    """A car of the package by name, or a car file by path.

    Raises:
        VehicleError: no such car, or a file that is not a car; the message names what is wrong.
    """
    text = str(name_or_file)
    if text in car_names():
        shipped = files("polemap.vehicle") / "cars" / f"{text}.yaml"
        return parse_car(shipped.read_text("utf-8"), text)
    path = Path(text)
    if path.suffix not in (".yaml", ".yml"):
        raise VehicleError(f"no car {text}; known are {', '.join(car_names())}, or give a .yaml")
    with named(path, VehicleError, "car file"):
        content = read_text(path, LARGEST_BYTES)
    return parse_car(content, str(path))


def parse_car(content: str, place: str) -> Car:
    """A car from YAML text; `place` is what error messages call it.

    Raises:
        VehicleError: not YAML, an unknown or a missing key, or a value out of range.
    """
    with named(place, VehicleError, "car file"):
        tree = parse_yaml(content)
    if not isinstance(tree, dict):
        raise VehicleError(f"{place}: a car file holds `name: value` lines")
    known = {item.name for item in fields(Car)}
    if unknown := sorted(str(key) for key in tree if key not in known):
        raise VehicleError(
            f"{place}: unknown key {unknown[0][:60]}; known are {', '.join(sorted(known))}"
        )
    try:
        return Car(**tree)
    except TypeError as error:
        raise VehicleError(f"{place}: {str(error).partition(') ')[2] or error}") from error
    except VehicleError as error:
        raise VehicleError(f"{place}: {error}") from error


def dump_car(car: Car) -> str:
    """The YAML text that `parse_car` reads."""
    return yaml.safe_dump(asdict(car), sort_keys=False, allow_unicode=True, width=98)
