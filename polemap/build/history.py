"""Which drive said what about a pole: kept in the map, so that the next drive can be merged.

A pole's history is a JSON list in the column `history`, an entry a drive in the order of time:
`{"drive", "start_s", "seen", "looks", "passes"}`: in how many independent scans (`existence`) the
drive detected it (seen) and should have (looks), and the rows of `traversals.TraversalLandmarks`
that it contributed (passes). Merging the traversals of a map with
those of new drives is the same as building the map from all drives at once.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.build.existence import Evidence
from polemap.build.traversals import TraversalLandmarks
from polemap.drivelog.errors import InputError
from polemap.map.pole_map import PoleMap
from polemap.parsing.errors import ParsingError, short
from polemap.parsing.json_text import parse_json

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

COLUMN = "history"
_TRAVERSAL = (
    "east_m", "north_m", "var_east_m2", "var_north_m2", "cov_east_north_m2", "reference_sd_m",
    "lever_m", "direction_rad", "width_m", "width_sd_m", "height_m", "observations", "first_s",
    "last_s", "directions", "range_min_m", "gain_east_m_per_px", "gain_north_m_per_px",
    "aligned_sd_m", "height_sd_m", "range_max_m",
)  # fmt: skip
# values of a traversal in maps of before, and what stands for those that they lack
_TRAVERSAL_BEFORE = 16
# a pole farther than this from all that saw it, beyond its own deviations, was moved by hand
_MOVED_M, _MOVED_SDS = 0.5, 6.0
_LACKING = (0.0, 0.0, 0.0, None, None)


@dataclass(frozen=True, slots=True)
class OldMap:
    """A map taken apart again for an update.

    Attributes:
        landmarks: all traversals in its history.
        pole: `(len(landmarks),)` row of the map that each belongs to.
        evidence: what each drive counted at each row of the map, in the order of time.
        prior_log_odds: `(n,)` for poles that have no history (a CSV, a public inventory).
        moved: ids of poles that stand where no drive saw them: they were moved by hand, and count
            as poles without a history.
    """

    landmarks: TraversalLandmarks
    pole: Whole
    evidence: tuple[tuple[str, float, Evidence], ...]
    prior_log_odds: Floats
    moved: tuple[int, ...] = ()


def write_history(
    landmarks: TraversalLandmarks,
    owner: Whole,
    drives: Sequence[tuple[str, float, Evidence]],
    wanted: NDArray[np.bool_],
) -> NDArray[np.str_]:
    """The column `history` `(n,)` for poles that own the landmarks; empty where not `wanted`."""
    texts: list[str] = []
    count = len(wanted)
    order = np.argsort(owner, kind="stable")
    bounds = np.searchsorted(owner[order], np.arange(count + 1))
    values = _traversal_values(landmarks)
    for pole in range(count):
        if not wanted[pole]:
            texts.append("")
            continue
        rows = order[bounds[pole] : bounds[pole + 1]]
        entries = []
        for name, start, counts in drives:
            of_drive = rows[landmarks.drive[rows] == name]
            if not len(of_drive) and counts.expected[pole] <= 0.0:
                continue
            traversals = sorted(_rounded(values[row]) for row in of_drive)
            entries.append(
                {
                    "drive": name,
                    "start_s": round(start, 3),
                    "seen": round(float(counts.detected[pole]), 3),
                    "looks": round(float(counts.expected[pole]), 3),
                    "passes": traversals,
                }
            )
        texts.append(json.dumps(entries, separators=(",", ":")).replace("NaN", "null"))
    return np.array(texts, dtype=np.str_)


def _rounded(row: Floats) -> list[float]:
    # enough digits that an update gives what a build from all drives gives, to the micrometre
    return [round(float(value), 9) for value in row]


def _traversal_values(landmarks: TraversalLandmarks) -> Floats:
    covariance = landmarks.covariance_m2
    columns = {
        "east_m": landmarks.points_m[:, 0],
        "north_m": landmarks.points_m[:, 1],
        "var_east_m2": covariance[:, 0, 0],
        "var_north_m2": covariance[:, 1, 1],
        "cov_east_north_m2": covariance[:, 0, 1],
        "gain_east_m_per_px": landmarks.gain_m_per_px[:, 0],
        "gain_north_m_per_px": landmarks.gain_m_per_px[:, 1],
    }
    return np.column_stack(
        [columns[n] if n in columns else getattr(landmarks, n).astype(float) for n in _TRAVERSAL]
    )


def open_history(pole_map: PoleMap) -> OldMap:
    """Take a map apart; poles without a history become one traversal of a drive called `map`.

    Raises:
        InputError: a history that cannot be read.
    """
    n = len(pole_map)
    texts = pole_map.extra.get(COLUMN, np.full(n, "", dtype=np.str_))
    rows: list[list[Any]] = []
    poles: list[int] = []
    names: list[str] = []
    starts: list[float] = []
    drives: dict[tuple[float, str], Evidence] = {}
    prior = np.zeros(n)
    moved: list[int] = []
    for pole, text in enumerate(texts):
        entries = _entries(str(text), int(pole_map.ids[pole]))
        if entries and _moved(pole_map, pole, entries):
            # edited in a GIS: the place on the map counts, not the one that was once seen
            moved.append(int(pole_map.ids[pole]))
            entries = []
        if not entries:
            prior[pole] = _log_odds(float(pole_map.existence[pole]))
            rows.append(_as_traversal(pole_map, pole))
            poles.append(pole)
            names.append("map")
            starts.append(-np.inf)
        for entry in entries:
            key = (float(entry["start_s"]), str(entry["drive"]))
            counts = drives.setdefault(key, Evidence(np.zeros(n), np.zeros(n)))
            counts.detected[pole], counts.expected[pole] = entry["seen"], entry["looks"]
            for values in entry["passes"]:
                rows.append([*values, *(_LACKING if len(values) == _TRAVERSAL_BEFORE else ())])
                poles.append(pole)
                names.append(key[1])
                starts.append(key[0])
    table = np.array(rows, dtype=np.float64).reshape(-1, len(_TRAVERSAL))
    evidence = tuple((name, start, drives[start, name]) for start, name in sorted(drives))
    return OldMap(
        _landmarks(
            table,
            np.array(names, dtype=np.str_),
            np.array(starts, dtype=np.float64),
            pole_map.kind[np.array(poles, dtype=np.int64)],
        ),
        np.array(poles, dtype=np.int64),
        evidence,
        prior,
        tuple(moved),
    )


def _moved(pole_map: PoleMap, pole: int, entries: list[Mapping[str, Any]]) -> bool:
    """Whether the pole stands where none of its traversals saw it."""
    seen = np.array([values[:2] for entry in entries for values in entry["passes"]], dtype=float)
    if not len(seen):
        return False
    distance = np.hypot(*(seen.reshape(-1, 2) - pole_map.points_m[pole]).T)
    sd = float(np.sqrt(np.trace(pole_map.covariance_m2[pole]) / 2.0))
    return bool(distance.min() > _MOVED_M + _MOVED_SDS * sd)


def _entries(text: str, pole: int) -> list[Mapping[str, Any]]:
    if not text.strip():
        return []
    try:
        entries = parse_json(text)
        for entry in entries:
            float(entry["start_s"]), str(entry["drive"]), float(entry["seen"])
            float(entry["looks"])
            if any(len(v) not in (_TRAVERSAL_BEFORE, len(_TRAVERSAL)) for v in entry["passes"]):
                raise ValueError("a pass has another number of values")
    except (ParsingError, ValueError, TypeError, KeyError, OverflowError) as error:
        raise InputError(
            f"pole map: the history of pole {pole} cannot be read ({short(error)})"
        ) from error
    return list(entries)


def _log_odds(probability: float) -> float:
    p = min(max(probability, 0.02), 0.98)
    return float(np.log(p / (1.0 - p)))


def _as_traversal(pole_map: PoleMap, row: int) -> list[float]:
    covariance = pole_map.covariance_m2[row]
    return [
        float(pole_map.points_m[row, 0]), float(pole_map.points_m[row, 1]),
        float(covariance[0, 0]), float(covariance[1, 1]), float(covariance[0, 1]),
        0.0, 0.0, 0.0, float(pole_map.width_m[row]), np.nan, float(pole_map.height_m[row]),
        float(max(pole_map.observations[row], 1)), 0.0, 0.0, 0.0, np.nan, 0.0, 0.0, 0.0, np.nan,
        np.nan,
    ]  # fmt: skip


def _landmarks(
    table: Floats, names: NDArray[np.str_], starts: Floats, kind: NDArray[np.int8]
) -> TraversalLandmarks:
    column = {name: table[:, i] for i, name in enumerate(_TRAVERSAL)}
    covariance = np.empty((len(table), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = column["var_east_m2"], column["var_north_m2"]
    covariance[:, 0, 1] = covariance[:, 1, 0] = column["cov_east_north_m2"]
    plain = (
        "reference_sd_m", "lever_m", "direction_rad", "width_m", "width_sd_m", "height_m",
        "first_s", "last_s", "range_min_m", "aligned_sd_m",
        "height_sd_m", "range_max_m",
    )  # fmt: skip
    return TraversalLandmarks(
        drive=names,
        start_s=starts,
        kind=kind,
        points_m=table[:, :2].copy(),
        covariance_m2=covariance,
        gain_m_per_px=np.column_stack(
            [column["gain_east_m_per_px"], column["gain_north_m_per_px"]]
        ),
        observations=column["observations"].astype(np.int64),
        directions=column["directions"].astype(np.int64),
        **{name: column[name] for name in plain},
    )
