"""The option `--set key=value`: parsed, and put into a tree of settings."""

from __future__ import annotations

from typing import Any

from polemap.drivelog.errors import ConfigError
from polemap.parsing.errors import ParsingError
from polemap.parsing.yaml_text import parse_yaml


def apply_set_option(tree: dict[str, Any], item: str) -> None:
    """Put the value of a `--set room.section.key=value` into a tree of settings.

    Raises:
        ConfigError: not `key=value`, the value is not YAML, or the key leads through a value.
    """
    key, value = parse_set_option(item, "localize.particles=500")
    *sections, leaf = key.split(".")
    for section in sections:
        tree = tree.setdefault(section, {})
        if not isinstance(tree, dict):
            raise ConfigError(f"--set {key}: '{section}' is a value, not a section")
    tree[leaf] = value


def parse_set_option(item: str, example: str) -> tuple[str, Any]:
    """Key and value of a `--set key=value`; `example` is what a mistake is answered with.

    Raises:
        ConfigError: not `key=value`, or the value is not YAML.
    """
    key, equals, value = item.partition("=")
    if not equals:
        raise ConfigError(f"--set {item}: expected key=value, such as {example}")
    try:
        return key.strip(), parse_yaml(value)
    except ParsingError as error:
        raise ConfigError(f"--set {item[:100]}: the value is {error}") from error
