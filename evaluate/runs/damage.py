"""What a run folder may hold: figures that are numbers, tables that are as long as their poses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError

Floats = NDArray[np.float64]
Table = Mapping[str, Floats | list[str]]

# columns of health.csv and output.csv that hold words; numbers stand in all others
WORDS = frozenset({"gate", "event", "flag", "distrust", "lines_suspended"})
COUNTS = ("reinitializations", "exploration_events", "gate_rejections", "late_dropped")
_NUMBERS = (*COUNTS, "real_time_factor", "on_poles_from_s")
_OF_ERRORS = ("lateral_rmse_m", "longitudinal_rmse_m", "yaw_rmse_rad", "nees_mean")
_OF_VERDICT = ("healthy_share", "position_sd_m")
# the squares of what lies beyond overflow
_LARGEST = 1e150
_SAME_STAMP_S = 1e-3


def check_metrics(path: Path, metrics: Mapping[str, Any]) -> None:
    """Refuse figures that are read later and are no numbers; null is a figure that is not known.

    Raises:
        InputError: naming the figure and what stands there.
    """
    _check_numbers(path, "", metrics, _NUMBERS)
    if any((metrics.get(name) or 0) < 0 for name in COUNTS):
        raise InputError(f"{path}: a count below zero; run 'polemap localize' again")
    for name, keys in (("pf", _OF_ERRORS), ("kf", _OF_ERRORS), ("verdict", _OF_VERDICT)):
        _check_numbers(path, f"{name}.", _object(path, name, metrics), keys)
    causes = _object(path, "reinitializations_by_cause", metrics)
    _check_numbers(path, "reinitializations_by_cause.", causes, causes)
    for kind, figures in _object(path, "landmarks_by_kind", metrics).items():
        if not isinstance(figures, Mapping):
            raise InputError(f"{path}: landmarks_by_kind.{kind} holds no figures")
        _check_numbers(path, f"landmarks_by_kind.{kind}.", figures, figures)
    for stage, figures in _object(path, "timing_ms", metrics).items():
        if isinstance(figures, Mapping):
            _check_numbers(path, f"timing_ms.{stage}.", figures, figures)


def check_table(path: Path, table: Table, stamp_s: Floats, poses: str) -> None:
    """Refuse a table that does not go with its poses: another length, other stamps, no numbers.

    Args:
        stamp_s: `(n,)` of the poses.
        poses: name of their file.

    Raises:
        InputError: naming the column.
    """
    for name, column in table.items():
        if name in WORDS:
            continue
        if not isinstance(column, np.ndarray):
            raise InputError(f"{path}: column {name}: {_first_word(column)} is no number")
        with np.errstate(invalid="ignore"):
            # infinite is, say, the age of a pose on poles where there was none
            wild = np.flatnonzero((np.abs(column) > _LARGEST) & ~np.isinf(column))
        if len(wild):
            raise InputError(
                f"{path}:{wild[0] + 2}: {name} is {column[wild[0]]:g}; the file is damaged"
            )
    stamps = table.get("stamp_s")
    if not isinstance(stamps, np.ndarray):
        return  # of an earlier version: nothing can be set beside its poses
    if len(stamps) != len(stamp_s):
        raise InputError(
            f"{path}: has {len(stamps)} rows, and {poses} beside it {len(stamp_s)} poses; "
            "one of them is cut off or of another run"
        )
    apart = np.flatnonzero(~(np.abs(stamps - stamp_s) <= _SAME_STAMP_S))
    if len(apart):
        raise InputError(
            f"{path}:{apart[0] + 2}: stamp_s is {stamps[apart[0]]:.3f}, that of the pose in "
            f"{poses} {stamp_s[apart[0]]:.3f}; they are of different runs"
        )


def _object(path: Path, name: str, metrics: Mapping[str, Any]) -> Mapping[str, Any]:
    found = metrics.get(name)
    if found is not None and not isinstance(found, Mapping):
        raise InputError(f"{path}: {name}: expected an object, found {type(found).__name__}")
    return found or {}


def _check_numbers(path: Path, at: str, found: Mapping[str, Any], names: Iterable[str]) -> None:
    for name in names:
        value = found.get(name)
        if value is None:
            continue
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not isfinite(value) or abs(value) > _LARGEST:
            raise InputError(f"{path}: {at}{name} is {str(value)[:60]!r}, no number that a run has")


def _first_word(cells: Iterable[str]) -> str:
    for cell in cells:
        try:
            float(cell or "nan")
        except ValueError:
            return repr(cell[:60])
    return "a cell"
