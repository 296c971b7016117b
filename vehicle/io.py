"""Car files: `cars/*.yaml` of this package, or a file of the user's."""

from __future__ import annotations

from dataclasses import asdict, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

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
    try:
        content = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise VehicleError(f"{path}: cannot be read as a car file ({error})") from error
    return parse_car(content, str(path))


def parse_car(content: str, place: str) -> Car:
    """A car from YAML text; `place` is what error messages call it.

    Raises:
        VehicleError: not YAML, an unknown or a missing key, or a value out of range.
    """
    try:
        tree: Any = yaml.safe_load(content)
    except yaml.YAMLError as error:
        raise VehicleError(f"{place}: not a YAML file: {error}") from error
    if not isinstance(tree, dict):
        raise VehicleError(f"{place}: a car file holds `name: value` lines")
    known = {item.name for item in fields(Car)}
    if unknown := sorted(str(key) for key in tree if key not in known):
        raise VehicleError(
            f"{place}: unknown key {unknown[0]}; known are {', '.join(sorted(known))}"
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
