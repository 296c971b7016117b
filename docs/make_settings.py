"""Writes docs/settings.md, the reference page of all settings: `python -m docs.make_settings`."""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from polemap.electric.config import EstimatorConfig
from polemap.settings import Settings

PAGE = Path(__file__).parent / "settings.md"
HEAD = """# Settings

Made from the code by `make docs`; a test compares. Any default is overridden by `--config
FILE.yaml` or `--set key=value`, in a program by `polemap.Settings`; unknown keys and values out of
range are errors. A quantity's unit ends its name. What no user should turn is a named constant with
its source in the code.

```yaml
localize:          # as FILE.yaml; on the command line --set localize.particles=500
  particles: 500
```
"""
ESTIMATORS = """`polemap estimate` has settings of its own, whose keys stand without `electric.`
there: `--set gyro_sd_radps=0.002`."""


def page() -> str:
    """The text of the page."""
    settings = Settings()
    rooms: dict[str, BaseModel] = {name: getattr(settings, name) for name in Settings.model_fields}
    rooms["electric"] = EstimatorConfig()
    counts = {name: sum(1 for _ in leaves(room)) for name, room in rooms.items()}
    lines = [HEAD, "| room | settings |", "|---|---|"]
    lines += [f"| [{name}](#{name}) | {count} |" for name, count in counts.items()]
    lines += [f"| all | {sum(counts.values())} |", ""]
    for name, room in rooms.items():
        lines += [f"## {name}", ""]
        if name == "electric":
            lines += [ESTIMATORS, ""]
        lines += section(name, room)
    return "\n".join(lines).rstrip() + "\n"


def section(prefix: str, group: BaseModel) -> list[str]:
    """The table of one group, and then those of its groups."""
    own, inner = parts(group)
    lines: list[str] = []
    if own:
        lines += [f"`{prefix}`: {summary(group)}", ""]
        lines += ["| key | default | range | meaning |", "|---|---|---|---|"]
        lines += [row(name, value, group) for name, value in own.items()] + [""]
    for name, value in inner.items():
        lines += section(f"{prefix}.{name}", value)
    return lines


def row(name: str, value: Any, group: BaseModel) -> str:
    """One setting as a line of a table."""
    meaning = meaning_of(name, group)
    cells = [f"`{name}`", f"`{plain(value)}`", limits(type(group).model_fields[name])]
    cells.append(meaning[:1].upper() + meaning[1:])
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def meaning_of(name: str, group: BaseModel) -> str:
    """A setting's description, or what its group's docstring says of it."""
    text = type(group).model_fields[name].description
    return " ".join((text or attributes(type(group)).get(name, "")).split())


def attributes(model: type[BaseModel]) -> dict[str, str]:
    """The section `Attributes` of a docstring, by name."""
    _, _, text = inspect.cleandoc(model.__doc__ or "").partition("Attributes:\n")
    block = text.partition("\n\n")[0]
    found: dict[str, str] = {}
    for names, meaning in re.findall(r"^    (\w[\w, ]*): (.*(?:\n     .*)*)", block, re.MULTILINE):
        found |= dict.fromkeys(names.split(", "), meaning)
    return found


def parts(group: BaseModel) -> tuple[dict[str, Any], dict[str, BaseModel]]:
    """Single settings and groups of settings, by name."""
    values = {name: getattr(group, name) for name in type(group).model_fields}
    inner = {name: value for name, value in values.items() if isinstance(value, BaseModel)}
    return {name: value for name, value in values.items() if name not in inner}, inner


def leaves(group: BaseModel, prefix: str = "") -> Iterator[tuple[str, BaseModel, str]]:
    """Every setting below a group: its dotted key, its own group and its name there."""
    own, inner = parts(group)
    yield from ((prefix + name, group, name) for name in own)
    for name, value in inner.items():
        yield from leaves(value, f"{prefix}{name}.")


def alternatives(annotation: Any) -> list[Any]:
    """The types of a union, or the one type."""
    if get_origin(annotation) is Annotated:
        return alternatives(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return [one for each in get_args(annotation) for one in alternatives(each)]
    return [annotation]


def summary(group: BaseModel) -> str:
    """First sentence of a group's docstring."""
    text = " ".join((group.__doc__ or "").split())
    first, stop, _ = text.partition(". ")
    return first + ("." if stop else "")


def limits(field: FieldInfo) -> str:
    """What a setting may be."""
    choices = [one for kind in alternatives(field.annotation) for one in choices_of(kind)]
    if choices:
        return ", ".join(f"`{one}`" for one in choices)
    low = high = ""
    for limit in field.metadata:
        if isinstance(limit, Gt | Ge):
            low = f"above {limit.gt:g}" if isinstance(limit, Gt) else f"from {limit.ge:g}"
        elif isinstance(limit, Lt | Le):
            high = f"below {limit.lt:g}" if isinstance(limit, Lt) else f"up to {limit.le:g}"
    return " ".join(part for part in (low, high) if part)


def choices_of(kind: Any) -> list[str]:
    """The values of a Literal, an enumeration or a bool."""
    if get_origin(kind) is Literal:
        return [plain(value) for value in get_args(kind)]
    if isinstance(kind, type) and issubclass(kind, Enum):
        return [plain(member.value) for member in kind]
    return ["true", "false"] if kind is bool else []


def plain(value: Any) -> str:
    """A value as YAML has it."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, tuple | list):
        return "[" + ", ".join(plain(one) for one in value) + "]"
    return str(value)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
