"""A pole map as named columns: the names that every format stores."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import POINT_KINDS, LandmarkKind
from polemap.map.pole_map import KIND_COLUMN, PoleMap

Floats = NDArray[np.float64]
Columns = dict[str, NDArray[Any]]

# what a pole without a stated accuracy is given, as a survey of street furniture would have it
DEFAULT_SD_M = 0.2
DEFAULT_EXISTENCE = 0.9

_WHOLE = ("id", "observations", "drives")
_WHOLE_MOST = 2**53  # the largest up to which every whole number is a float of its own
KNOWN = (
    "id", "width_m", "height_m", "var_east_m2", "var_north_m2", "cov_east_north_m2",
    "observations", "drives", "existence",
)  # fmt: skip


def to_columns(pole_map: PoleMap) -> Columns:
    """The columns of a map file (without the geometry), and the extra ones."""
    columns: Columns = {
        "id": pole_map.ids,
        "width_m": pole_map.width_m,
        "height_m": pole_map.height_m,
        "var_east_m2": pole_map.covariance_m2[:, 0, 0],
        "var_north_m2": pole_map.covariance_m2[:, 1, 1],
        "cov_east_north_m2": pole_map.covariance_m2[:, 0, 1],
        "observations": pole_map.observations,
        "drives": pole_map.drives,
        "existence": pole_map.existence,
    }
    return columns | dict(pole_map.extra)


def from_columns(
    frame: EarthFrame,
    points_m: Floats,
    columns: Mapping[str, NDArray[Any]],
    *,
    extra: Mapping[str, NDArray[Any]] | None = None,
    notes: tuple[str, ...] = (),
    next_id: int = 0,
) -> PoleMap:
    """A map from columns; those that are missing get stated defaults and a note.

    Args:
        next_id: the least id for poles that have none among others that have one.

    Raises:
        InputError: values that a map refuses, or a covariance that is not positive.
    """
    n = len(points_m)
    numbers = {name: _column(columns, name, n) for name in KNOWN}
    ids = numbers["id"]
    if ids is not None and ids.dtype.kind == "f":
        ids, new = _numbered(ids, next_id)
        span = f"{new[0]}" if len(new) == 1 else f"{new[0]} to {new[-1]}"
        notes = (*notes, f"{len(new)} poles had no id: they are given {span}")
    if ids is not None and not _all_different(ids):
        raise InputError("pole map: the ids are not unique")
    covariance, assumed = _covariance(numbers, n)
    if assumed and n:
        notes = (*notes, f"{assumed} poles have no covariance: {DEFAULT_SD_M} m an axis is assumed")
    extra = dict(extra or {})
    if KIND_COLUMN in extra:
        extra[KIND_COLUMN], of_kinds = kinds_of(extra[KIND_COLUMN])
        notes = (*notes, *of_kinds)
    unknown = np.full(n, np.nan)
    existence = _default(numbers["existence"], np.full(n, DEFAULT_EXISTENCE))
    return PoleMap(
        frame=frame,
        ids=np.arange(n, dtype=np.int64) if ids is None else ids,
        points_m=np.asarray(points_m, dtype=np.float64).reshape(-1, 2),
        covariance_m2=covariance,
        width_m=_default(numbers["width_m"], unknown),
        height_m=_default(numbers["height_m"], unknown.copy()),
        observations=_default(numbers["observations"], np.zeros(n, dtype=np.int64)),
        drives=_default(numbers["drives"], np.zeros(n, dtype=np.int64)),
        existence=_filled(existence, DEFAULT_EXISTENCE),
        extra=extra,
        notes=notes,
    )


def kinds_of(column: NDArray[Any]) -> tuple[NDArray[Any], list[str]]:
    """The column of kinds as numbers: names are read, what was added without one is a pole.

    Raises:
        InputError: a word that names no kind of points.
    """
    if column.dtype.kind in "iu":
        return column, []
    known = {kind.name.lower(): float(kind) for kind in sorted(POINT_KINDS)}
    numbers = np.zeros(len(column))
    for row, value in enumerate(column.tolist()):
        text = "" if value is None else str(value).strip().lower()
        number = known.get(text, _number(text))
        if number is None:
            raise InputError(
                f"pole map: {KIND_COLUMN} holds '{text[:40]}'; write one of {', '.join(known)}, "
                "or leave it empty for a pole"
            )
        numbers[row] = number
    lacking = np.isnan(numbers)
    numbers[lacking] = float(LandmarkKind.POLE)
    count = int(np.count_nonzero(lacking))
    said = [f"{count} landmarks have no {KIND_COLUMN}: they are taken for poles"] if count else []
    whole = bool((numbers == np.round(numbers)).all())
    return numbers.astype(np.int64) if whole and (np.abs(numbers) < 128).all() else numbers, said


def numbers_of(name: str, texts: NDArray[np.str_]) -> tuple[NDArray[Any], list[str]]:
    """A known column of texts as numbers, "" as NaN; ids that are none stay texts, with a note.

    Raises:
        InputError: a text that is no number in another column.
    """
    numbers = [_number(text) for text in texts]
    wrong = [text for text, value in zip(texts, numbers, strict=True) if value is None]
    if not wrong:
        return np.array(numbers, dtype=np.float64), []
    if name == "id":
        said = f"ids such as '{wrong[0][:20]}' are texts: kept as id_text, numbered anew"
        return texts, [said]
    raise InputError(f"column {name} holds '{wrong[0][:40]}', not a number")


def _number(text: str) -> float | None:
    if not text.strip():
        return math.nan
    try:
        return float(text)
    except ValueError:
        return None


def _numbered(ids: NDArray[Any], least: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Ids with numbers after the largest for those that are NaN, and these new ones."""
    known = np.isfinite(ids)
    first = max(int(ids[known].max()) + 1, least)
    new = np.arange(first, first + int(np.count_nonzero(~known)), dtype=np.int64)
    whole = np.zeros(len(ids), dtype=np.int64)
    whole[known] = ids[known].astype(np.int64)
    whole[~known] = new
    return whole, new


def _all_different(ids: NDArray[Any]) -> bool:
    """Whether no id stands twice; maps of ours are sorted by id, which needs no sorting."""
    step = np.diff(ids)
    if bool((step > 0).all()):
        return True
    return bool((np.diff(np.sort(ids)) > 0).all())


def _column(columns: Mapping[str, NDArray[Any]], name: str, n: int) -> NDArray[Any] | None:
    if name not in columns:
        return None
    raw = np.asarray(columns[name])
    unsigned = raw.dtype.kind == "u" and (not len(raw) or int(raw.max()) <= _WHOLE_MOST)
    if name in _WHOLE and (raw.dtype.kind == "i" or unsigned) and len(raw) == n:
        return raw if name != "id" else raw.astype(np.int64, copy=False)
    try:
        # a lean map of a whole city stays lean
        values = raw if raw.dtype == np.float32 else np.asarray(raw, dtype=np.float64)
        if name in _WHOLE:
            values = np.where(np.isfinite(values), values, 0.0 if name != "id" else np.nan)
            large = np.flatnonzero(np.abs(values) > _WHOLE_MOST)
            if len(large):
                raise InputError(
                    f"pole map: row {large[0] + 1}, {name}: {values[large[0]]:.4g} is beyond what "
                    f"a whole number holds ({_WHOLE_MOST:.0e}); number the poles anew"
                )
            if name == "id" and not np.isfinite(values).all():
                return values if np.isfinite(values).any() else None
            return values.astype(np.int64)
    except (TypeError, ValueError) as error:
        raise InputError(f"pole map: column {name} does not hold numbers ({error})") from error
    if len(values) != n:
        raise InputError(f"pole map: column {name} has {len(values)} rows, the points {n}")
    return values


def _filled(values: NDArray[Any], default: float) -> NDArray[Any]:
    unknown = np.isnan(values)
    return np.where(unknown, values.dtype.type(default), values) if unknown.any() else values


def _default(values: NDArray[Any] | None, default: NDArray[Any]) -> NDArray[Any]:
    return default if values is None else values


def _covariance(numbers: Mapping[str, NDArray[Any] | None], n: int) -> tuple[Floats, int]:
    """Covariances `(n, 2, 2)`, and how many of them had to be assumed."""
    east, north = numbers["var_east_m2"], numbers["var_north_m2"]
    if east is None or north is None:
        covariance = np.zeros((n, 2, 2))
        covariance[:, 0, 0] = covariance[:, 1, 1] = DEFAULT_SD_M**2
        return covariance, n
    cross = _default(numbers["cov_east_north_m2"], np.zeros(n))
    covariance = np.empty((n, 2, 2), dtype=np.result_type(east, north, cross))
    finite = all(bool(np.isfinite(values.sum())) for values in (east, north, cross))
    if finite and bool(((east > 0) & (north > 0) & (east * north > cross**2)).all()):
        covariance[:, 0, 0], covariance[:, 1, 1] = east, north
        covariance[:, 0, 1] = covariance[:, 1, 0] = cross
        return covariance, 0
    covariance[...] = DEFAULT_SD_M**2 * np.eye(2)
    given = np.isfinite(east) & np.isfinite(north) & np.isfinite(cross)
    bad = given & ~((east > 0) & (north > 0) & (east * north > cross**2))
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise InputError(
            f"pole map: row {row}: covariance {east[row]}, {north[row]}, {cross[row]} is not "
            "positive definite"
        )
    covariance[given, 0, 0], covariance[given, 1, 1] = east[given], north[given]
    covariance[given, 0, 1] = covariance[given, 1, 0] = cross[given]
    return covariance, int(n - np.count_nonzero(given))
