"""How well the eye sees: detections and tracks against a known map of poles.

Two counts are kept apart. *Per frame*: of the mapped poles that the disparity shows in this frame,
how many were detected; of the detections, how many stand at a mapped pole. *Per pole*: of the
mapped poles that were shown in several frames, how many became a track; of the tracks, how many
stand at a mapped pole. Maps lack poles: places of true poles that the map lacks can be given, and
then precision is counted with and without them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.detect.config import DetectionConfig
from polemap.detect.ground import Ground
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.map.pole_map import PoleMap
from polemap.perception import PerceivedFrame
from polemap.stereo.matching import DisparityPair
from polemap.stereo.rig import StereoRig
from polemap.vehicle.pose import inverse_transform_points, transform_points

Floats = NDArray[np.float64]

MATCH_M = 1.0  # as published LiDAR pole extractors are scored
_EVIDENCE_HEIGHTS_M = np.arange(0.3, 2.31, 0.1)
_EVIDENCE_ASIDE_M = 0.35  # maps of single poles scatter by 0.15 to 0.2 m
_EVIDENCE_SHARE = 0.5
_POLE_FRAMES = 3  # a pole, or a track, with fewer frames is not counted


@dataclass(frozen=True, slots=True)
class Score:
    """Counts and errors within one band of range.

    Attributes:
        shown: mapped poles that the disparity showed (per frame), or that it showed in at least
            three frames (per pole).
        found: of these, detected or tracked.
        claims: detections, or tracks.
        right: of these, at a mapped pole.
        unmapped: of the others, at a true pole that the map lacks.
        across_m, along_m: errors across and along the line of sight of what was found, detected
            minus mapped.
    """

    range_min_m: float
    range_max_m: float
    shown: int
    found: int
    claims: int
    right: int
    unmapped: int
    across_m: Floats
    along_m: Floats

    def figures(self) -> dict[str, float]:
        """What is printed: shares, medians and counts."""
        empty = float("nan")
        return {
            "range_min_m": self.range_min_m,
            "range_max_m": self.range_max_m,
            "shown": self.shown,
            "recall": self.found / self.shown if self.shown else empty,
            "claims": self.claims,
            "precision": self.right / self.claims if self.claims else empty,
            "precision_with_unmapped": (
                (self.right + self.unmapped) / self.claims if self.claims else empty
            ),
            "across_median_m": _median(np.abs(self.across_m)),
            "across_bias_m": _median(self.across_m),
            "along_median_m": _median(np.abs(self.along_m)),
            "along_bias_m": _median(self.along_m),
        }


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """What is kept of a frame for scoring, all in the vehicle frame.

    Attributes:
        pose: `(3,)` rear axle in the map.
        shown: `(p,)` rows of the map that the disparity shows.
        points_vehicle_m: `(n, 2)` detections.
        ids: `(m,)` ids of the tracks in the scan, with `tracked_vehicle_m` `(m, 2)`.
    """

    pose: Floats
    shown: NDArray[np.int64]
    points_vehicle_m: Floats
    ids: NDArray[np.int64]
    tracked_vehicle_m: Floats
    origin_vehicle_m: Floats


def record(
    perceived: PerceivedFrame,
    pose: Floats,
    pole_map: PoleMap,
    rig: StereoRig,
    config: DetectionConfig,
) -> FrameRecord:
    """Reduce a frame to what scoring needs; `pose` is `(3,)` of the rear axle in the map."""
    near = pole_map.within(np.asarray(pose[:2], dtype=np.float64), config.range_max_m + 5.0)
    points = inverse_transform_points(pose, pole_map.points_m[near])
    share = evidence(points, perceived.disparity, perceived.view.ground, rig)
    found = perceived.view.detections
    sure = found.probability >= config.probability_min
    scan = perceived.scan.of_kinds(LandmarkKind.POLE)
    return FrameRecord(
        np.asarray(pose, dtype=np.float64),
        near[share >= _EVIDENCE_SHARE],
        found.points_vehicle_m[sure],
        scan.track_id,
        scan.points_vehicle_m,
        perceived.view.region.origin_vehicle_m,
    )


def evidence(
    points_vehicle_m: Floats, disparity: DisparityPair, ground: Ground, rig: StereoRig
) -> Floats:
    """Share of the heights from 0.3 to 2.3 m at which something stands where the pole should.

    0 for poles outside of the image. The map's error is allowed for: 0.35 m aside and 7 % of the
    disparity.
    """
    height, width = disparity.left.shape
    on_ground = np.column_stack([points_vehicle_m, np.zeros(len(points_vehicle_m))])
    u, _, d = rig.project(on_ground).T
    share = np.zeros(len(points_vehicle_m))
    for pole in np.flatnonzero((u >= 0) & (u < width) & (d > 0)):
        foot = float(ground.row_px(u[pole], d[pole]))
        rows = np.rint(foot - _EVIDENCE_HEIGHTS_M * d[pole] / rig.baseline_m).astype(np.int64)
        rows = rows[(rows >= 0) & (rows < height)]
        aside = _EVIDENCE_ASIDE_M * d[pole] / rig.baseline_m
        first, last = int(max(0.0, u[pole] - aside)), int(min(width, u[pole] + aside + 1.0))
        if len(rows) < 3 or last <= first:
            continue
        with np.errstate(invalid="ignore"):
            there = np.abs(disparity.left[rows, first:last] - d[pole]) <= max(1.0, 0.07 * d[pole])
        share[pole] = there.any(axis=1).mean()
    return share


def score_frames(
    records: Iterable[FrameRecord],
    pole_map: PoleMap,
    bands_m: Sequence[tuple[float, float]],
    unmapped_m: Floats | None = None,
) -> list[Score]:
    """Detections of single frames against the map, by band of range from the camera."""
    rows: list[list[tuple[float, ...]]] = [[] for _ in bands_m]  # shown found claims right unmapped
    across: list[list[float]] = [[] for _ in bands_m]
    along: list[list[float]] = [[] for _ in bands_m]
    for item in records:
        near = pole_map.within(item.pose[:2], 80.0)
        mapped = (
            inverse_transform_points(item.pose, pole_map.points_m[near]) - item.origin_vehicle_m
        )
        seen = item.points_vehicle_m - item.origin_vehicle_m
        one, two = match(mapped, seen, MATCH_M)
        lacking = np.empty((0, 2))
        if unmapped_m is not None and len(unmapped_m):
            lacking = inverse_transform_points(item.pose, unmapped_m) - item.origin_vehicle_m
        free = np.setdiff1d(np.arange(len(seen)), two)
        excused = free[match(lacking, seen[free], MATCH_M)[1]]
        shown = np.isin(near, item.shown)
        mapped_range, seen_range = np.hypot(*mapped.T), np.hypot(*seen.T)
        for band, (low, high) in enumerate(bands_m):
            asked = shown & (mapped_range >= low) & (mapped_range < high)
            said = (seen_range >= low) & (seen_range < high)
            hit = asked[one]
            rows[band].append(
                (asked.sum(), hit.sum(), said.sum(), said[two].sum(), said[excused].sum())
            )
            error, ray = seen[two[hit]] - mapped[one[hit]], mapped[one[hit]]
            ray = ray / np.hypot(ray[:, 0], ray[:, 1])[:, None]
            along[band] += (error * ray).sum(axis=1).tolist()
            across[band] += (error[:, 1] * ray[:, 0] - error[:, 0] * ray[:, 1]).tolist()
    scores = []
    for band, (low, high) in enumerate(bands_m):
        totals = [int(sum(column)) for column in zip(*rows[band], strict=True)] or [0] * 5
        shown_n, found_n, claims, right, excused_n = totals
        errors = np.array(across[band]), np.array(along[band])
        scores.append(Score(low, high, shown_n, found_n, claims, right, excused_n, *errors))
    return scores


def score_tracks(
    records: Iterable[FrameRecord],
    pole_map: PoleMap,
    band_m: tuple[float, float],
    unmapped_m: Floats | None = None,
) -> Score:
    """Tracks over the whole drive against the map, counting only what was within the band.

    A track stands at the median of its positions in the map. A pole that was lost and found again
    has two tracks; both are right.
    """
    times_shown: dict[int, int] = defaultdict(int)
    places: dict[int, list[Floats]] = defaultdict(list)
    rays: dict[int, list[Floats]] = defaultdict(list)
    for item in records:
        mapped = inverse_transform_points(item.pose, pole_map.points_m[item.shown])
        for pole, away in zip(item.shown, _range(mapped, item), strict=True):
            times_shown[int(pole)] += bool(band_m[0] <= away < band_m[1])
        points = transform_points(item.pose, item.tracked_vehicle_m)
        reach = _range(item.tracked_vehicle_m, item)
        camera = transform_points(item.pose, item.origin_vehicle_m)
        for track, point, away in zip(item.ids, points, reach, strict=True):
            if band_m[0] <= away < band_m[1]:
                places[int(track)].append(point)
                rays[int(track)].append((point - camera) / away)
    poles = np.array([p for p, n in times_shown.items() if n >= _POLE_FRAMES], dtype=np.int64)
    tracks = [t for t, seen in places.items() if len(seen) >= _POLE_FRAMES]
    points = np.array([np.median(places[t], axis=0) for t in tracks]).reshape(-1, 2)
    ray = np.array([np.mean(rays[t], axis=0) for t in tracks]).reshape(-1, 2)
    ray = ray / np.maximum(np.hypot(ray[:, 0], ray[:, 1]), 1e-9)[:, None]
    found = _gaps(pole_map.points_m[poles], points) <= MATCH_M
    right = _gaps(points, pole_map.points_m) <= MATCH_M
    excused = ~right
    if unmapped_m is not None:
        excused &= _gaps(points, unmapped_m) <= MATCH_M
    else:
        excused &= False
    one, two = match(pole_map.points_m[poles], points, MATCH_M)
    error = points[two] - pole_map.points_m[poles[one]]
    return Score(
        *band_m,
        len(poles),
        int(found.sum()),
        len(tracks),
        int(right.sum()),
        int(excused.sum()),
        error[:, 1] * ray[two, 0] - error[:, 0] * ray[two, 1],
        (error * ray[two]).sum(axis=1),
    )


def match(
    one_m: Floats, two_m: Floats, radius_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Optimal one-to-one pairs of points no farther apart than the radius."""
    if not len(one_m) or not len(two_m):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    gap = np.hypot(*np.moveaxis(one_m[:, None] - two_m, 2, 0))
    rows, columns = scipy.optimize.linear_sum_assignment(
        np.where(gap <= radius_m, gap, 100.0 * radius_m)
    )
    good = gap[rows, columns] <= radius_m
    return rows[good].astype(np.int64), columns[good].astype(np.int64)


def _range(points_vehicle_m: Floats, item: FrameRecord) -> Floats:
    return np.asarray(np.hypot(*(points_vehicle_m - item.origin_vehicle_m).T))


def _gaps(points_m: Floats, others_m: Floats) -> Floats:
    """Distance of every point to the nearest of the others."""
    if not len(points_m) or not len(others_m):
        return np.full(len(points_m), np.inf)
    return np.asarray(np.hypot(*np.moveaxis(points_m[:, None] - others_m, 2, 0)).min(axis=1))


def _median(values: Floats) -> float:
    return float(np.median(values)) if len(values) else float("nan")
