"""Rectification: whether matched features of a pair stand in the same row, and what they lack.

A small rotation of the right camera moves its rows by f (wx (1 + y²) - wz x - wy x y) with x and y
the image place in units of the focal length, a focal length of its own by f s y, and a right
camera that stands lower by -(t/b) times the disparity. Six numbers explain all that a stiff pair
can have; what is left is matching noise and lens distortion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.calibration.estimate import Fit, fit, spread
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.plausibility.features import PairMatch, match_pair
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]

GRID = (4, 6)  # rows and columns of the picture's parts
_FEATURES = 600
_LEAST = 100
_ROWS_MAX_PX = 12.0


@dataclass(frozen=True, slots=True)
class RowAgreement:
    """How far the rows of a rectified pair are apart: right minus left, over all frames.

    Attributes:
        frames, matches: how many were looked at.
        median_px, spread_px, p95_px: of the vertical disparity; the last of its size.
        grid_px: medians `(rows, columns)` over the parts of the picture, NaN without matches.
        pitch_rad, roll_rad, yaw_rad: of the right camera against the left one (ISO 8855: pitch nose
            down, yaw to the left), with `_sd`.
        yaw_px: what that yaw does to the disparities in the middle, if no principal point hides it.
        focal_ratio: of the right to the left focal length, minus one.
        lower_m: by how much the right camera stands lower.
        rest_px: spread of what these leave.
    """

    frames: int
    matches: int
    median_px: float
    spread_px: float
    p95_px: float
    grid_px: Floats
    pitch_rad: float
    pitch_sd_rad: float
    roll_rad: float
    roll_sd_rad: float
    yaw_rad: float
    yaw_sd_rad: float
    yaw_px: float
    focal_ratio: float
    focal_ratio_sd: float
    lower_m: float
    lower_sd_m: float
    rest_px: float

    @property
    def across_px(self) -> float:
        """Largest difference between parts of the picture."""
        known = self.grid_px[np.isfinite(self.grid_px)]
        return float(np.ptp(known)) if len(known) else float("nan")


def check_rows(drive: Drive, rows: Sequence[int]) -> RowAgreement:
    """Matches features of the pairs of these rows.

    Raises:
        InputError: no camera, or too few features that match.
    """
    if drive.rig is None:
        raise InputError(f"drive {drive.name}: it has no camera to check")
    matches = []
    for row in rows:
        frame = drive.read_frame(row)
        matches.append(match_pair(frame.left, frame.right, _FEATURES))
    return agreement(matches, drive.rig, drive.name)


def agreement(matches: Sequence[PairMatch], rig: StereoRig, name: str) -> RowAgreement:
    """The same from matches; `name` of the drive for messages.

    Raises:
        InputError: fewer than a hundred matches.
    """
    places = np.concatenate([match.places_px for match in matches])
    steps = np.concatenate([match.steps_px for match in matches])
    block = np.repeat(np.arange(len(matches)), [len(match.places_px) for match in matches])
    kept = (np.abs(steps[:, 1]) < _ROWS_MAX_PX) & (steps[:, 0] < 2.0)
    if kept.sum() < _LEAST:
        raise InputError(
            f"drive {name}: {int(kept.sum())} features match in {len(matches)} pairs, {_LEAST} are "
            "needed to check the rectification: choose frames with more to see"
        )
    places, steps, block = places[kept], steps[kept], block[kept]
    found = _explained(places, steps, block, rig)
    offset = steps[:, 1]
    values, sd = found.values, found.sd
    return RowAgreement(
        frames=len(matches),
        matches=len(offset),
        median_px=float(np.median(offset)),
        spread_px=spread(offset),
        p95_px=float(np.percentile(np.abs(offset), 95)),
        grid_px=_grid(places, offset, rig),
        pitch_rad=-float(values[0]),
        pitch_sd_rad=float(sd[0]),
        roll_rad=float(values[1]),
        roll_sd_rad=float(sd[1]),
        yaw_rad=-float(values[2]),
        yaw_sd_rad=float(sd[2]),
        yaw_px=-rig.focal_px * float(values[2]),
        focal_ratio=float(values[3]),
        focal_ratio_sd=float(sd[3]),
        lower_m=float(values[4]) * rig.baseline_m,
        lower_sd_m=float(sd[4]) * rig.baseline_m,
        rest_px=spread(found.residuals),
    )


def _explained(places: Floats, steps: Floats, block: NDArray[np.int64], rig: StereoRig) -> Fit:
    """Rotation about x, z and y (camera axes), focal ratio and drop over baseline."""
    f = rig.focal_px
    x = (places[:, 0] + steps[:, 0] - rig.cx_px) / f
    y = (places[:, 1] - rig.cy_px) / f
    design = np.column_stack([f * (1.0 + y * y), -f * x, -f * x * y, f * y, steps[:, 0]])
    return fit(design, steps[:, 1], block)


def _grid(places: Floats, offset: Floats, rig: StereoRig) -> Floats:
    tall, wide = GRID
    row = np.clip((places[:, 1] * tall / rig.height_px).astype(int), 0, tall - 1)
    column = np.clip((places[:, 0] * wide / rig.width_px).astype(int), 0, wide - 1)
    out = np.full(GRID, np.nan)
    for i in range(tall):
        for j in range(wide):
            here = offset[(row == i) & (column == j)]
            if len(here) >= 20:
                out[i, j] = np.median(here)
    return out
