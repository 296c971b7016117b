"""What a map says about its poles beside their place, and what its building tells the user."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from polemap.build.drift import Drift
from polemap.build.drive_observations import DriveObservations
from polemap.build.existence import Evidence
from polemap.build.merge import Merged
from polemap.build.registration import Shift
from polemap.build.traversals import TraversalLandmarks
from polemap.map.pole_map import FACING_COLUMN, KIND_COLUMN

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

PARTS_COLUMN = "parts"  # stakes round one sapling that a row stands for


def weighted(values: Floats, observations: Whole, owner: Whole, n: int) -> Floats:
    """Mean of the finite values of each pole, weighted by observations; NaN without any."""
    finite = np.isfinite(values)
    weight = np.bincount(owner[finite], observations[finite], n)
    total = np.bincount(owner[finite], (values * observations)[finite], n)
    return np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), np.nan)


def distinct(names: NDArray[np.str_], owner: Whole, n: int) -> Whole:
    """How many different names each pole has, `(n,)`."""
    _, code = np.unique(names, return_inverse=True)
    pairs = np.unique(np.stack([owner, code], axis=1), axis=0)
    return np.bincount(pairs[:, 0], minlength=n).astype(np.int64)


def kind_column(
    landmarks: TraversalLandmarks, owner: Whole, n: int
) -> dict[str, NDArray[np.generic]]:
    """The column of kinds `(n,)`, where not all are poles."""
    if not landmarks.kind.any():
        return {}
    kind = np.zeros(n, dtype=np.int8)
    kind[owner] = landmarks.kind
    return {KIND_COLUMN: kind}


def parts_column(
    ordered: Sequence[DriveObservations], owner: Whole, known: Mapping[int, int], n: int
) -> dict[str, NDArray[np.generic]]:
    """The column `parts` `(n,)` where some pole stands for several stakes.

    Args:
        owner: landmark of the map of every traversal landmark, drive after drive.
        known: of an old map, by row.
    """
    parts, first = np.ones(n, dtype=np.int64), 0
    for row, count in known.items():
        parts[row] = count
    for part in ordered:
        mine = owner[first : first + len(part.landmarks)]
        told = part.rows >= 0
        np.maximum.at(parts, mine[part.rows[told]], part.detections.parts[told])
        first += len(part.landmarks)
    return {PARTS_COLUMN: parts} if (parts > 1).any() else {}


def facing_column(
    ordered: Sequence[DriveObservations], owner: Whole, known: Mapping[int, float], n: int
) -> dict[str, NDArray[np.generic]]:
    """The free side `(n,)` of every corner, from grid east; NaN of what has none.

    Args:
        owner: landmark of the map of every traversal landmark, drive after drive.
        known: what an earlier map knew, by landmark; it counts as one look.
    """
    total, start = np.zeros(n, dtype=np.complex128), 0
    for part in ordered:
        mine = owner[start : start + len(part.landmarks)]
        start += len(part.landmarks)
        facing = part.detections.facing_rad
        told = np.isfinite(facing) & (part.rows >= 0)
        np.add.at(total, mine[part.rows[told]], np.exp(1j * facing[told]))
    for row, facing_rad in known.items():
        total[row] += np.exp(1j * facing_rad)
    if not total.any():
        return {}
    return {FACING_COLUMN: np.where(np.abs(total) > 0.0, np.angle(total), np.nan)}


def evidence_columns(
    landmarks: TraversalLandmarks, owner: Whole, drives: list[tuple[str, float, Evidence]], n: int
) -> dict[str, NDArray[np.generic]]:
    """The columns of evidence `(n,)`: traversals, directions, ranges, scatter, share of scans."""
    directions = np.zeros(n, dtype=np.int64)
    np.bitwise_or.at(directions, owner, landmarks.directions)
    nearest, farthest = np.full(n, np.inf), np.full(n, -np.inf)
    np.fmin.at(nearest, owner, landmarks.range_min_m)
    np.fmax.at(farthest, owner, landmarks.range_max_m)
    seen = np.sum([counts.detected for _, _, counts in drives], axis=0)
    views = np.sum([counts.expected for _, _, counts in drives], axis=0)
    return {
        "passes": np.bincount(owner, minlength=n).astype(np.int64),
        "directions": np.bitwise_count(directions).astype(np.int64),
        "range_min_m": np.where(np.isfinite(nearest), nearest, np.nan),
        "range_max_m": np.where(np.isfinite(farthest), farthest, np.nan),
        "width_sd_m": weighted(landmarks.width_sd_m, landmarks.observations, owner, n),
        "height_sd_m": weighted(landmarks.height_sd_m, landmarks.observations, owner, n),
        "seen_share": np.where(views > 0, seen / np.where(views > 0, views, 1.0), np.nan),
    }


def building_reports(
    ordered: Sequence[DriveObservations],
    shifts: dict[str, Shift],
    align: bool,
    merged: Merged,
    drifts: Sequence[Drift] | None,
) -> tuple[str, ...]:
    """Sentences for whoever builds a map: shifts, drift, scans without a pose, disagreement."""
    reports = []
    for name, shift in shifts.items():
        if shift.significant:
            what = "was aligned by" if align else "disagrees with the drives before it by"
            hint = "" if align else "; --align would remove it"
            reports.append(
                f"drive {name} {what} {shift.move_m[0]:+.2f} m east, {shift.move_m[1]:+.2f} m "
                f"north ({shift.matches} poles){hint}"
            )
    for part, drift in zip(ordered, drifts or (), strict=False):
        if drift.size_m > 0.1:
            reports.append(
                f"drive {part.detections.drive}: its reference drifts; its passes were levelled by "
                f"{drift.size_m:.2f} m (rms), which leaves {np.median(drift.sd_m):.2f} m an axis"
            )
    lost = sum(part.detections.without_pose for part in ordered)
    if lost:
        reports.append(f"{lost} scans have no reference pose and were left out")
    error = merged.reference_error
    if error.traversal_sd_m is not None:
        reports.append(
            "beyond the detector's own error, poles differ by "
            f"{error.traversal_sd_m:.3f} m between passes of a drive "
            f"({error.traversal_pairs} meetings) "
            f"and by {error.drive_sd_m:.3f} m between drives ({error.drive_pairs})"
            + ("; --align would level them" if error.drive_sd_m > 0.2 and not align else "")
        )
    return tuple(reports)
