"""Facades of one frame: walls of houses as straight pieces in plan, from the disparities.

A column of the image that shows a wall has one disparity from the height of a fence to above a
man's. Over the columns an upright plane is straight, d = a + k u, so the columns' disparities are
cut into straight runs (Ramer, Douglas and Peucker's recursive splitting), and runs that one plane
explains are joined over what stands before it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.detect.ground import Ground
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.drivelog.line_detections import LineDetections
from polemap.stereo.depth_edges import UprightMaps
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Whole = NDArray[np.int64]

STEP_PX = 4  # between the columns that are looked at
HEIGHTS_M = (0.8, 3.6)  # rows that are looked at
TOP_M = 2.2  # what does not reach so high is a car, a hedge or a fence
ROWS_MIN = 8
SHARE_MIN = 0.7  # of a column's rows that have its disparity
DISPARITY_MIN_PX = 2.0
COLUMNS_MIN = 12  # of a piece
LENGTH_MIN_M, RANGE_MAX_M = 3.0, 30.0
SPLIT_PX, RMS_MAX_PX = 0.6, 0.4
GAP_PX = 40.0  # what stands before a wall may hide so many columns
SHARED_SD_PX = 0.25  # the whole of a piece errs by it
OWN_SD_PX, ALIKE_COLUMNS = 0.1, 6.0  # neighbouring columns err alike
OFFSET_SD_M, DIRECTION_SD_RAD = 0.04, 0.01  # plaster, plinths and reveals


@dataclass(frozen=True, slots=True)
class FacadePiece:
    """A piece in the vehicle frame; its deviations across and of its direction."""

    start_m: Floats
    end_m: Floats
    offset_sd_m: float
    direction_sd_rad: float
    probability: float


def facade_lines(maps: UprightMaps, ground: Ground, rig: StereoRig) -> LineDetections:
    """The facades of one frame as a table."""
    pieces = facade_pieces(maps, ground, rig)
    if not pieces:
        return LineDetections.none()
    return LineDetections(
        kind=np.full(len(pieces), LandmarkKind.FACADE, dtype=np.int8),
        style=np.full(len(pieces), LineStyle.UNKNOWN, dtype=np.int8),
        start_vehicle_m=np.array([piece.start_m for piece in pieces]),
        end_vehicle_m=np.array([piece.end_m for piece in pieces]),
        offset_sd_m=np.array([piece.offset_sd_m for piece in pieces]),
        direction_sd_rad=np.array([piece.direction_sd_rad for piece in pieces]),
        probability=np.array([piece.probability for piece in pieces]),
    )


def facade_pieces(maps: UprightMaps, ground: Ground, rig: StereoRig) -> list[FacadePiece]:
    """The pieces of one frame, from left to right in the image."""
    column, disparity = wall_columns(maps, ground, rig)
    pieces = []
    for run in _joined(column, disparity, _straight_runs(column, disparity)):
        piece = _piece(column[run], disparity[run], rig)
        if piece is not None:
            pieces.append(piece)
    return pieces


def wall_columns(maps: UprightMaps, ground: Ground, rig: StereoRig) -> tuple[Floats, Floats]:
    """Columns `(n,)` that show something upright and high, and its mean disparity."""
    column = np.arange(STEP_PX // 2, maps.left.shape[1], STEP_PX)
    seen = np.ascontiguousarray(maps.left[:, column])
    row = (np.arange(len(seen)) * float(maps.row_step_px))[:, None]
    known = np.maximum(seen, DISPARITY_MIN_PX)
    height = (ground.row_px(column[None, :].astype(np.float64), known) - row) * rig.baseline_m
    height /= known
    inside = (seen > DISPARITY_MIN_PX) & (height > HEIGHTS_M[0]) & (height < HEIGHTS_M[1])
    count = inside.sum(axis=0)
    ordered = np.sort(np.where(inside, seen, np.float32(np.inf)), axis=0)
    middle = ordered[np.maximum(count - 1, 0) // 2, np.arange(len(column))]
    middle = np.where(count >= ROWS_MIN, middle, 0.0)
    near = inside & (np.abs(seen - middle) <= 0.5 + 0.02 * middle)
    enough = np.maximum(near.sum(axis=0), 1)
    top = np.where(near, height, 0.0).max(axis=0, initial=0.0)
    good = (count >= ROWS_MIN) & (enough >= SHARE_MIN * count) & (top > TOP_M)
    mean = np.where(near, seen, 0.0).sum(axis=0) / enough
    return column[good].astype(np.float64), mean[good]


def _straight_runs(column: Floats, disparity: Floats) -> list[Whole]:
    """Rows of the runs that a straight line explains, from left to right."""
    if not len(column):
        return []
    cuts = np.flatnonzero(np.diff(column) > GAP_PX) + 1
    waiting = list(np.split(np.arange(len(column)), cuts))[::-1]
    runs = []
    while waiting:
        run = waiting.pop()
        if len(run) < 3:
            continue
        u, d = column[run], disparity[run]
        chord = d[0] + (d[-1] - d[0]) * (u - u[0]) / (u[-1] - u[0])
        off = np.abs(d - chord)
        at = int(off.argmax())
        if off[at] <= SPLIT_PX:
            runs.append(run)
        else:
            waiting += [run[at:], run[:at]] if 0 < at < len(run) - 1 else [run[1:-1]]
    return runs


def _joined(column: Floats, disparity: Floats, runs: list[Whole]) -> list[Whole]:
    """The runs, those of one plane as one: neighbours, or with one thing between them."""
    left = list(runs)
    done = []
    while left:
        run = left.pop(0)
        while True:
            for other in left[:3]:
                both = np.concatenate([run, other])
                if column[other[0]] - column[run[-1]] <= GAP_PX and (
                    _fit(column[both], disparity[both])[2] <= 0.75 * RMS_MAX_PX
                ):
                    run = both
                    left = [one for one in left if one is not other]
                    break
            else:
                break
        done.append(run)
    return done


def _fit(u: Floats, d: Floats) -> tuple[float, float, float]:
    """Mean disparity, slope over the columns, and scatter."""
    off = u - u.mean()
    slope = float(off @ d / max(float(off @ off), 1e-9))
    return float(d.mean()), slope, float(np.std(d - slope * off))


def _piece(u: Floats, d: Floats, rig: StereoRig) -> FacadePiece | None:
    mean, slope, rms = _fit(u, d)
    if len(u) < COLUMNS_MIN or rms > RMS_MAX_PX:
        return None
    ends_u = np.array([u[0], u[-1]])
    ends_d = mean + slope * (ends_u - u.mean())
    if ends_d.min() < DISPARITY_MIN_PX:
        return None
    camera = rig.camera_points(ends_u, np.full(2, rig.cy_px), ends_d)
    start, end = rig.vehicle_points(camera)[:, :2]
    length = float(np.hypot(*(end - start)))
    foot = np.array([rig.vehicle_from_camera.x_m, rig.vehicle_from_camera.y_m])
    middle = 0.5 * (start + end)
    if length < LENGTH_MIN_M or np.hypot(*(middle - foot)) > RANGE_MAX_M:
        return None
    along = (end - start) / length
    normal = np.array([-along[1], along[0]])

    def across(point: Floats) -> float:
        """How far a pixel of disparity moves the piece across itself there."""
        ray = point - foot
        return float(normal @ ray * np.hypot(*ray) / (rig.focal_px * rig.baseline_m))

    own_px = max(rms, OWN_SD_PX) / np.sqrt(max(len(u) / ALIKE_COLUMNS, 1.0))
    at_start, at_end = across(start), across(end)
    offset = np.hypot(OFFSET_SD_M, across(middle) * np.hypot(SHARED_SD_PX, own_px))
    # ends of a fitted line err by up to twice what its middle does
    turned = np.hypot(SHARED_SD_PX * (at_end - at_start), 2.0 * own_px * np.hypot(at_start, at_end))
    direction = np.hypot(DIRECTION_SD_RAD, turned / length)
    likely = 1.0 / (1.0 + np.exp(-(1.0 + 0.4 * (length - 4.0) - 8.0 * (rms - 0.2))))
    return FacadePiece(start, end, float(offset), float(direction), float(likely))
