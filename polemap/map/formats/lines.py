"""Lines of a map as features: what every format that has lines writes of each, and reads again."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LINE_KINDS, LandmarkKind, LineStyle
from polemap.map.line_map import LineMap
from polemap.parsing.errors import ParsingError
from polemap.parsing.json_text import parse_json

Floats = NDArray[np.float64]

LINES = "lines"
_MARKS, _DEVIATIONS = frozenset({"kind", "style"}), frozenset({"vertex_sd_m", "sd_m"})
_KINDS = {kind.name.lower(): kind for kind in LINE_KINDS}
_STYLES = {style.name.lower(): style for style in LineStyle}


def are_ours(names: Collection[str]) -> bool:
    """Whether columns or properties are those of a map's lines; streets of a GIS have others."""
    return set(names) >= _MARKS and not _DEVIATIONS.isdisjoint(names)


def properties_of(lines: LineMap) -> list[dict[str, Any]]:
    """Properties of every line; `vertex_sd_m` is the list of its vertices' deviations."""
    ends = np.cumsum(lines.count)
    return [
        {
            "id": int(lines.ids[row]),
            "kind": LandmarkKind(lines.kind[row]).name.lower(),
            "style": LineStyle(lines.style[row]).name.lower(),
            "observations": int(lines.observations[row]),
            "drives": int(lines.drives[row]),
            "existence": float(lines.existence[row]),
            "sd_m": float(np.median(lines.vertex_sd_m[ends[row] - lines.count[row] : ends[row]])),
            "vertex_sd_m": lines.vertex_sd_m[ends[row] - lines.count[row] : ends[row]].tolist(),
        }
        for row in range(len(lines))
    ]


def from_features(
    frame: EarthFrame, vertices_m: Sequence[Floats], properties: Sequence[Mapping[str, Any]]
) -> LineMap:
    """Lines from their vertices `(k, 2)` in `frame` and their properties.

    A line whose vertices were changed by hand takes the one deviation `sd_m` for all of them.

    Raises:
        InputError: a line with a kind or a style that is none, or with values that are no numbers.
    """
    rows = [_row(*one) for one in zip(vertices_m, properties, strict=True)]
    if not rows:
        return LineMap.empty(frame)
    columns: list[Any] = list(zip(*rows, strict=True))
    whole, small = np.int64, np.int8
    return LineMap(
        frame=frame,
        vertices_m=np.concatenate(list(vertices_m)),
        vertex_sd_m=np.concatenate(columns[6]),
        ids=np.array(columns[0], dtype=whole),
        kind=np.array(columns[1], dtype=small),
        style=np.array(columns[2], dtype=small),
        count=np.array([len(points) for points in vertices_m], dtype=whole),
        observations=np.array(columns[3], dtype=whole),
        drives=np.array(columns[4], dtype=whole),
        existence=np.array(columns[5], dtype=np.float64),
    )


def _row(points: Floats, told: Mapping[str, Any]) -> tuple[Any, ...]:
    name = f"line {str(told.get('id'))[:20]}"
    kind, style = told.get("kind"), told.get("style") or "unknown"
    # names, not values: a list of a damaged GeoJSON cannot be looked up
    if str(kind) not in _KINDS or str(style) not in _STYLES:
        wrong, known = ("kind", _KINDS) if str(kind) not in _KINDS else ("style", _STYLES)
        raise InputError(
            f"{name}: its {wrong} is '{str(told.get(wrong))[:40]}'; write one of {', '.join(known)}"
        )
    try:
        given = told.get("vertex_sd_m")
        deviations = np.array(parse_json(given) if isinstance(given, str) else given, np.float64)
        if deviations.shape != (len(points),):
            deviations = np.full(len(points), float(told["sd_m"]))
        numbers = [int(told[key]) for key in ("id", "observations", "drives")]
        existence = float(told["existence"])
    except (ParsingError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise InputError(
            f"{name}: id, observations, drives, existence and sd_m must be numbers, vertex_sd_m a "
            f"list of them ({error})"
        ) from error
    if not all(0 <= number < 2**63 for number in numbers):
        raise InputError(
            f"{name}: id, observations and drives are {numbers}; write whole numbers of at least 0"
        )
    bad = deviations[~(np.isfinite(deviations) & (deviations > 0.0))]
    if len(bad):
        raise InputError(f"{name}: a deviation of vertex_sd_m is {bad[0]:g}; write metres above 0")
    if not 0.0 <= existence <= 1.0:
        raise InputError(f"{name}: its existence is {existence:g}, not 0 to 1")
    return numbers[0], _KINDS[str(kind)], _STYLES[str(style)], *numbers[1:], existence, deviations


def as_text(properties: Mapping[str, Any]) -> dict[str, Any]:
    """The properties for a table, which has no lists."""
    return {**properties, "vertex_sd_m": json.dumps(properties["vertex_sd_m"])}
