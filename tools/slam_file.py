"""What building a map without a reference found out, kept beside the map: `MAP.slam.json`."""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from polemap.build.slam.report import SlamSummary
from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.errors import InputError
from polemap.parsing.errors import named
from polemap.parsing.json_text import parse_json

_VERSION = 1
_CHUNK = 1 << 20


@dataclass(frozen=True, slots=True)
class SlamFigures:
    """The figures of a map, and whether the map is still the one that they were found with."""

    summary: SlamSummary
    is_of_this_map: bool


def figures_path(map_path: Path) -> Path:
    """Where the figures of a map are: `campus.gpkg` has them in `campus.slam.json`."""
    return map_path.with_name(f"{map_path.stem}.slam.json")


def write_figures(map_path: Path, summary: SlamSummary) -> None:
    """Keep the figures beside a map that has been written."""
    content = {
        "format_version": _VERSION,
        "map": map_path.name,
        "map_sha256": _digest(map_path),
        **summary.as_dict(),
    }
    with atomic_file(figures_path(map_path)) as target:
        text = json.dumps(content, indent=1, allow_nan=False) + "\n"
        target.write_text(text, encoding="utf-8")


def remove_figures(map_path: Path) -> None:
    """Take away figures of an earlier map of that name; another's file of that name stays."""
    path = figures_path(map_path)
    with suppress(InputError, OSError):
        if path.is_file() and "map_sha256" in _content(path):
            path.unlink()


def read_figures(map_path: Path) -> SlamFigures | None:
    """The figures of a map; None where there are none.

    Raises:
        InputError: the file beside the map is damaged or of another version.
    """
    path = figures_path(map_path)
    if not path.is_file():
        return None
    content = _content(path)
    if content.get("format_version") != _VERSION:
        raise InputError(
            f"{path}: format_version {content.get('format_version')!r:.40} is not {_VERSION}; "
            "build the map again"
        )
    fields = {key: content.get(key) for key in SlamSummary.__dataclass_fields__}
    try:
        summary = TypeAdapter(SlamSummary).validate_python(_with_nan(fields))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(
            f"{path}: {place}: {first['msg']}; build the map again, or take the file away"
        ) from None
    same = map_path.exists() and content.get("map_sha256") == _digest(map_path)
    return SlamFigures(summary, same)


def _content(path: Path) -> dict[str, Any]:
    with named(path, InputError, "figures of a map"):
        content = parse_json(path.read_text(encoding="utf-8"))
    if not isinstance(content, dict):
        raise InputError(f"{path}: no figures of a map; build the map again, or take it away")
    return content


def _with_nan(value: Any) -> Any:
    """What was not known is null in the file."""
    if isinstance(value, dict):
        return {key: _with_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_nan(item) for item in value]
    return float("nan") if value is None else value


def _digest(map_path: Path) -> str:
    """Of a map's file, or of all files of a map that is a folder."""
    found = hashlib.sha256()
    files = sorted(map_path.rglob("*")) if map_path.is_dir() else [map_path]
    for file in files:
        if file.is_file():
            with file.open("rb") as stream:
                while part := stream.read(_CHUNK):
                    found.update(part)
    return found.hexdigest()
