"""What a sweep varies: the frame rate, the number of particles, or any setting by its name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from polemap.drivelog.errors import ConfigError
from polemap.parsing.yaml_text import parse_yaml
from polemap.settings import Settings, load_settings

RATES = {"full": 1, "half": 2, "third": 3, "quarter": 4, "fifth": 5}


@dataclass(frozen=True, slots=True)
class SweepValue:
    """One value of a sweep: every `every`-th frame, with `settings` set."""

    label: str
    number: float | None
    every: int = 1
    settings: tuple[tuple[str, Any], ...] = ()


@dataclass(frozen=True, slots=True)
class Sweep:
    """One swept quantity and its values, in the order given."""

    name: str
    values: tuple[SweepValue, ...]


def parse_sweep(text: str) -> Sweep:
    """`frame_rate=full,half,third`, `particles=50,1000` or `localize.p_detection=0.5,0.7`.

    A frame rate is a word, a share such as 1/4, or both mixed. The name `particles` is short for
    `localize.particles`.

    Raises:
        ConfigError: not of that form, a value given twice, or a setting that does not exist.
    """
    name, equals, rest = text.partition("=")
    name = name.strip()
    items = [item.strip() for item in rest.split(",") if item.strip()]
    if not (name and equals and items):
        raise ConfigError(
            f"--sweep {text}: expected NAME=VALUE,VALUE such as particles=100,1000 or "
            "frame_rate=full,half"
        )
    if len(set(items)) != len(items):
        raise ConfigError(f"--sweep {text}: a value is given twice")
    if name == "frame_rate":
        return Sweep(name, tuple(_rate(text, item) for item in items))
    key = "localize.particles" if name == "particles" else name
    values = []
    for item in items:
        load_settings(None, [f"{key}={item}"])
        value = parse_yaml(item)
        number = float(value) if isinstance(value, int | float) else None
        values.append(SweepValue(item, number, 1, ((key, value),)))
    return Sweep(name, tuple(values))


def parse_sweeps(texts: Sequence[str]) -> list[Sweep]:
    """Every `--sweep` of a command, see `parse_sweep`.

    Raises:
        ConfigError: one cannot be read, or two vary the same quantity.
    """
    sweeps = [parse_sweep(text) for text in texts]
    for number, sweep in enumerate(sweeps):
        if sweep.name in {earlier.name for earlier in sweeps[:number]}:
            raise ConfigError(f"--sweep {sweep.name} is given twice; name all its values in one")
    return sweeps


def settings_of(config: Mapping[str, Any], changes: tuple[tuple[str, Any], ...]) -> Settings:
    """The settings of a run folder with some of them changed.

    Raises:
        ConfigError: the run was made with settings that this version does not know.
    """
    kept = config.get("settings")
    flat = [f"{key}={yaml.safe_dump(value, default_flow_style=True)}" for key, value in _flat(kept)]
    flat += [f"{key}={yaml.safe_dump(value, default_flow_style=True)}" for key, value in changes]
    return load_settings(None, flat)


def _flat(tree: Any, prefix: str = "") -> list[tuple[str, Any]]:
    if not isinstance(tree, Mapping):
        return [(prefix, tree)] if prefix else []
    found = []
    for key, value in tree.items():
        name = f"{prefix}.{key}" if prefix else str(key)
        # A run depends on nothing of the simulator.
        if name != "simulate":
            found += _flat(value, name)
    return found


def _rate(text: str, item: str) -> SweepValue:
    every = RATES.get(item)
    if every is None and item.startswith("1/") and item[2:].isdigit():
        every = int(item[2:])
    if not every:
        words = ", ".join(RATES)
        raise ConfigError(f"--sweep {text}: frame rate '{item}' is none of {words} or 1/N")
    return SweepValue(item, 1.0 / every, every)
