"""Positions coarser than they look: written with few decimals, or held from row to row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import geographic_from_grid

Floats = NDArray[np.float64]

DEGREE_M = 111_320.0
_FIXES_MIN, _GRID_DOUBT_M, _ON_GRID = 20, 1.0, 0.98
_ROWS_MIN, _HELD_SHARE, _HELD_STEP_M = 20, 0.3, 0.25


def resolution_findings(drive: Drive) -> list[Finding]:
    """Both."""
    return [*_fix_grid(drive), *_held_reference(drive)]


def _fix_grid(drive: Drive) -> list[Finding]:
    """Fixes on a grid of degrees with steps of a metre or more: four decimals are 11 m of north."""
    gnss = drive.gnss
    if gnss is None or len(gnss) < _FIXES_MIN or not drive.frame.is_utm:
        return []
    points = np.stack([gnss.east_m, gnss.north_m], axis=1)
    changes = np.diff(geographic_from_grid(drive.frame, points), axis=0) * DEGREE_M
    changes[:, 1] *= np.cos(np.radians(geographic_from_grid(drive.frame, points[:1])[0, 0]))
    step = max(_step(changes[:, 0]), _step(changes[:, 1]))
    if not step >= _GRID_DOUBT_M:
        return []
    return [
        Finding(
            "gnss_rounded", "warning", drive.names.gnss,
            f"fixes lie on a grid of {step:.3g} m, latitudes and longitudes with too few decimals",
            f"steps below {_GRID_DOUBT_M:g} m", "write degrees with seven decimals",
        )
    ]  # fmt: skip


def _step(changes_m: Floats) -> float:
    """The step of which nearly all changes are multiples; 0 where there is none, or no change."""
    moved = np.abs(changes_m[np.abs(changes_m) > 1e-4])
    if len(moved) < 5:
        return 0.0
    step = float(np.percentile(moved, 2))
    part = moved / step
    off = np.abs(part - np.round(part)) * step
    return step if np.mean(off < 0.05 * step) >= _ON_GRID else 0.0


def _held_reference(drive: Drive) -> list[Finding]:
    """A reference that was measured more seldom than its rows say, each pose held until the next.

    Between two measurements such a row is behind by up to the way in between.
    """
    reference = drive.reference
    if reference is None or len(reference) < _ROWS_MIN:
        return []
    moves = np.hypot(*np.diff(reference.poses[:, :2], axis=0).T)
    # a hold is followed by a jump; a car that stands is not
    jump_m = float(np.percentile(moves[moves > 0.0], 50)) if (moves > 0.0).any() else 0.0
    if jump_m < _HELD_STEP_M:
        return []
    held = moves == 0.0
    ends = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(int)))
    runs = [(a, b) for a, b in zip(ends[::2], ends[1::2], strict=True) if b < len(moves)]
    jumps = [(a, b) for a, b in runs if moves[b] >= _HELD_STEP_M]
    rows = sum(b - a for a, b in jumps)
    if rows < _HELD_SHARE * len(moves) or len(jumps) < 5:
        return []
    return [
        Finding(
            "reference_held", "warning", drive.names.reference,
            f"{rows} of {len(reference)} rows repeat the pose before, then it jumps by "
            f"{jump_m:.2g} m in the median", "a pose measured at each stamp",
            "write only the rows in which the reference measured",
        )
    ]  # fmt: skip
