"""All settings in one tree: defaults, then a YAML file, then `key=value` overrides."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from polemap.config import PolemapConfig
from polemap.drivelog.errors import ConfigError
from polemap.localize.config import LocalizeConfig
from polemap.parsing.errors import named
from polemap.parsing.text import packaged_files
from polemap.parsing.yaml_text import read_yaml
from polemap.set_option import apply_set_option
from polemap.simulate.config import SimulateConfig
from polemap.stereo.config import StereoConfig


class Settings(BaseModel):
    """Every setting of every room; unknown keys are an error on each level."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    stereo: StereoConfig = StereoConfig()
    polemap: PolemapConfig = PolemapConfig()
    localize: LocalizeConfig = LocalizeConfig()
    simulate: SimulateConfig = SimulateConfig()


def load_settings(config_file: Path | None = None, set_values: list[str] | None = None) -> Settings:
    """Settings from an optional YAML file and `key=value` overrides (dots lead into sections).

    Raises:
        ConfigError: the file cannot be read, a key is unknown or a value out of its range.
    """
    tree = read_tree(config_file) if config_file is not None else {}
    for item in set_values or []:
        apply_set_option(tree, item)
    place = f"settings ({config_file})" if config_file else "settings"
    try:
        return Settings.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{place}: {first_problem(error, Settings)}") from error


def shipped_settings() -> list[str]:
    """Settings files that come with the package, as `--config` takes them."""
    return [f"papers/{name}" for name in packaged_files("polemap", "papers")]


def _located(path: Path) -> Path:
    """The path as it stands, or of the package where no file is there but the package has one."""
    if path.exists() or path.as_posix() not in shipped_settings():
        return path
    return Path(str(files("polemap").joinpath("papers", path.name)))


def read_tree(path: Path) -> dict[str, Any]:
    """The keys of a `--config` file, of the user's or of `shipped_settings`; none if it is empty.

    Raises:
        ConfigError: it cannot be read or holds no keys.
    """
    with named(path, ConfigError, "settings file"):
        found = _located(path)
        if not found.exists():
            raise ConfigError(
                f"{path}: cannot be read (no such file; with the package come "
                f"{', '.join(shipped_settings())})"
            )
        tree = read_yaml(found)
    if tree is None:
        return {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: expected lines `key: value`, found a {type(tree).__name__}")
    return tree


def first_problem(error: ValidationError, settings: type[BaseModel]) -> str:
    """One line for the first of the problems, with the known keys where one is unknown."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        model: Any = settings
        for part in first["loc"][:-1]:
            model = model.model_fields[str(part)].annotation
        text = f"unknown key '{key}'; known here: {', '.join(model.model_fields)}"
        near = get_close_matches(key, _keys(settings), n=1)
        return f"{text}; did you mean '{near[0]}'?" if near else text
    text = f"{key} = {repr(first.get('input'))[:60]}: {first['msg'].lower()}"
    if first["type"] == "tuple_type" and isinstance(first.get("input"), str):
        text += f"; a list stands in brackets, as in [{first['input'][:60]}]"
    return text


def _keys(model: type[BaseModel], section: str = "") -> Iterator[str]:
    """Every key of the settings, with the sections that lead to it."""
    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from _keys(kind, f"{section}{name}.")
        else:
            yield section + name
