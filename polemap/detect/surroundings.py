"""What stands at, beside and above every hypothesis: disparities on a grid of metres.

The grid has heights above the local ground, and offsets inside and beside the candidate. Every
sample says whether the candidate's own surface, something nearer, something farther or nothing was
measured there. Left of the candidate the right map is asked, right of it the left map: each sees
past its own flank (see `stereo.depth_edges`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.detect.flanks import INSIDE
from polemap.detect.hypotheses import Hypotheses
from polemap.stereo.depth_edges import UprightMaps
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

HEIGHTS_M = np.arange(0.2, 3.3, 0.15)
BESIDE_M = np.array([0.12, 0.25, 0.45, 0.75])  # beyond the flank
ABOVE_M = np.array([0.15, 0.3, 0.45, 0.6])  # beyond the top
CLEAR_PX = 2.5  # matchers blur a flank by about so much
_NEAR = 3  # so many of the offsets beside are near ones
_PARTS = (len(INSIDE), len(INSIDE) + len(BESIDE_M))  # columns inside, right, left
_ON_CENTRE = 1  # the one of `INSIDE` on the centre line
_FAR_M = 0.5  # depth difference that counts as free


@dataclass(frozen=True, slots=True)
class Place:
    """Where the hypotheses stand in the image, and which depths are told apart; `(n,)` each.

    Attributes:
        axis_px: column midway between the sharpened flanks, at the candidate's `row_px`.
        width_px: between the flanks.
        ground_row_px: of the ground at the candidate.
        per_m: pixels a metre at the candidate.
        tolerance_px: disparities that differ by no more are of one depth.
        free_px: what lies farther by so much leaves the candidate free.
    """

    axis_px: Floats
    width_px: Floats
    ground_row_px: Floats
    per_m: Floats
    tolerance_px: Floats
    free_px: Floats

    @classmethod
    def of(
        cls,
        hypotheses: Hypotheses,
        left_px: Floats,
        right_px: Floats,
        ground_row_px: Floats,
        rig: StereoRig,
    ) -> Place:
        """From the sharpened flanks."""
        focal_baseline = rig.focal_px * rig.baseline_m
        return cls(
            hypotheses.column_px + (0.5 * (left_px + right_px) - hypotheses.column_px),
            np.maximum(right_px - left_px, 0.5),
            ground_row_px,
            hypotheses.disparity_px / rig.baseline_m,
            0.8 + 0.3 * hypotheses.disparity_px**2 / focal_baseline,
            np.maximum(_FAR_M * hypotheses.disparity_px**2 / focal_baseline, 0.8),
        )


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What was measured at each of the `h` heights of every hypothesis.

    Attributes:
        visible: `(n, h)` in the image.
        on: `(n, h)` shows the candidate's own surface.
        hidden: `(n, h)` by something nearer.
        free_left, free_right: `(n, h, len(BESIDE_M))` something farther there.
        near_beside: `(n, h)` something nearer on a side.
        same_beside: `(n, h)` the candidate's own depth near it on a side.
        blank_beside: `(n, h)` nothing measured near it on a side.
        own_px: `(n, h * len(INSIDE))` disparities of the candidate's surface, NaN elsewhere.
        above_free, above_same: `(n,)` share of the heights right above the top that show something
            farther, and the candidate's own depth.
    """

    visible: Flags
    on: Flags
    hidden: Flags
    free_left: Flags
    free_right: Flags
    near_beside: Flags
    same_beside: Flags
    blank_beside: Flags
    own_px: Floats
    above_free: Floats
    above_same: Floats

    @property
    def free_both(self) -> Flags:
        """Heights `(n, h)` that show the candidate with free space near it on both sides."""
        left, right = self.free_left[..., :_NEAR], self.free_right[..., :_NEAR]
        return np.asarray(self.on & left.any(axis=2) & right.any(axis=2))


def sample_surroundings(hypotheses: Hypotheses, place: Place, maps: UprightMaps) -> Surroundings:
    """Sample the maps at and around every hypothesis, and tell what each sample shows."""
    rows, disparity = _sampled(hypotheses, place, maps)
    above = disparity[:, len(HEIGHTS_M) :, _ON_CENTRE]
    seen_above = np.maximum((rows[:, len(HEIGHTS_M) :] >= 0).sum(axis=1), 1)
    rows, disparity = rows[:, : len(HEIGHTS_M)], disparity[:, : len(HEIGHTS_M)]
    inside, right, left = np.split(disparity, _PARTS, axis=2)
    near_left, near_right = left[..., :_NEAR], right[..., :_NEAR]
    visible = (rows >= 0) & (rows <= maps.height_px - 1)
    d = hypotheses.disparity_px[:, None, None]
    tolerance, free = place.tolerance_px[:, None, None], place.free_px[:, None, None]
    blank_left, blank_right = (np.isnan(side).all(axis=2) for side in (near_left, near_right))
    with np.errstate(invalid="ignore"):
        match = np.abs(inside - d) <= tolerance
        on = (match.sum(axis=2) >= 2) & visible
        same_left = np.abs(near_left - d) <= tolerance
        same_right = np.abs(near_right - d) <= tolerance
        own = np.where(match & on[..., None], inside, np.nan)
        return Surroundings(
            visible=visible,
            on=on,
            hidden=((inside > d + tolerance).sum(axis=2) >= 2) & visible,
            free_left=left < d - free,
            free_right=right < d - free,
            near_beside=np.any((left > d + tolerance) | (right > d + tolerance), axis=2),
            same_beside=np.any(same_left | same_right, axis=2),
            blank_beside=np.asarray(blank_left | blank_right),
            own_px=own.reshape(len(hypotheses), len(HEIGHTS_M) * len(INSIDE)),
            above_free=(above < (d - free)[..., 0]).sum(axis=1) / seen_above,
            above_same=(np.abs(above - d[..., 0]) <= tolerance[..., 0]).sum(axis=1) / seen_above,
        )


def _sampled(hypotheses: Hypotheses, place: Place, maps: UprightMaps) -> tuple[Floats, Floats]:
    """Image rows `(n, h + a)`, and the disparities `(n, h + a, k)` in them.

    The rows are those of the heights of the candidate, then some right above its top.
    """
    per_m = place.per_m[:, None]
    rows = np.concatenate(
        [
            place.ground_row_px[:, None] - HEIGHTS_M * per_m,
            hypotheses.top_px[:, None] - ABOVE_M * per_m,
        ],
        axis=1,
    )
    centre = place.axis_px[:, None] + hypotheses.slope[:, None] * (
        rows - hypotheses.row_px[:, None]
    )
    middle = centre[:, :, None]
    out = (place.width_px[:, None] / 2 + CLEAR_PX + BESIDE_M * per_m)[:, None, :]
    inside = middle + INSIDE * place.width_px[:, None, None]
    beyond = middle - hypotheses.disparity_px[:, None, None] - out  # columns of the right image
    columns = np.concatenate([inside, middle + out, beyond], axis=2)
    return rows, _nearest(maps, rows / maps.row_step_px, columns)


def _nearest(maps: UprightMaps, rows: Floats, columns: Floats) -> Floats:
    """Nearest disparity at `rows` `(n, h)` and `columns` `(n, h, k)`; NaN where there is none.

    The columns left of the candidate are those of the right map, the others of the left one.
    """
    height, width = maps.left.shape
    v = np.rint(rows).astype(np.int64)[:, :, None]
    u = np.rint(columns).astype(np.int64)
    within = (v >= 0) & (v < height) & (u >= 0) & (u < width)
    at = np.where(within, v * width + u, 0)
    left = maps.left.ravel().take(at[:, :, : _PARTS[1]])
    right = maps.right.ravel().take(at[:, :, _PARTS[1] :])
    value = np.concatenate([left, right], axis=2)
    return np.where(within & (value > 0), value, np.nan).astype(np.float64)
