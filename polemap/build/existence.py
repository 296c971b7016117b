"""Does a pole stand there? What was seen, and what should have been seen and was not.

Each drive moves a pole's log-odds by how much better "it stands there" explains what was seen and
missed than "nothing does". How often a standing pole is seen at a range is measured on poles that
are beyond doubt. Scans that follow each other share what hides a pole, so they count as one scan
every `INDEPENDENT_SCAN_S`; and one drive can say only so much, because a parked van is as visible
as a pole for as long as it is parked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.constants import (
    DRIVE_LOG_ODDS_MAX,
    FALSE_ALARM_PROBABILITY,
    INDEPENDENT_SCAN_S,
    LOG_ODDS_MAX,
)
from polemap.build.georeference import MapDetections, ScanViews

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

RANGE_STEP_M = 5.0
RANGE_BINS = 16
_BATCH = 2000
_ESTABLISHED = 10  # detections in the drive from which a pole's presence is beyond doubt
_PRIOR_SEEN, _PRIOR_EXPECTED = 6.0, 10.0
_POLES_MIN = 30  # fewer do not tell how visible poles are
_MEMORY = 20.0  # scans that earlier drives count at most: visibility changes


@dataclass(frozen=True, slots=True)
class Visibility:
    """What one drive could say about poles; rows are poles.

    Attributes:
        detected: `(n, bins)` scans in which it was in view and detected, by range.
        expected: `(n, bins)` scans in which it was in view.
        weight: what a scan counts as an independent one.
    """

    detected: Whole
    expected: Whole
    weight: float


def sensing_range_m(views: ScanViews) -> float:
    """How far from the car a drive sees at most; zero if its detector does not say."""
    reach = float(views.free_range_m.max()) if views.free_range_m.size else 0.0
    return reach + float(np.hypot(*views.origin_vehicle_m.T).max()) if reach > 0.0 else 0.0


def count_scans(
    detections: MapDetections, owner: Whole, points_m: Floats, reach_m: float
) -> tuple[Whole, Whole]:
    """Count for every pole `(n, 2)` the scans of a drive that saw it, and that had it in view.

    Args:
        detections: of the drive, or of those of its scans that could have seen the poles.
        owner: `(len(detections),)` pole of each detection, -1 for none.
        points_m: poles `(n, 2)`.
        reach_m: `sensing_range_m` the whole drive.

    Returns:
        Two arrays `(n, RANGE_BINS)` by range.
    """
    n = len(points_m)
    seen = np.zeros((n, RANGE_BINS), dtype=np.int64)
    expected = np.zeros((n, RANGE_BINS), dtype=np.int64)
    views = detections.views
    if not n or reach_m <= 0.0:
        # the detector does not say where it looked: only detections count
        rows = owner[owner >= 0]
        np.add.at(seen, (rows, _bin(detections.range_m[owner >= 0])), 1)
        return seen, seen.copy()
    tree = scipy.spatial.KDTree(points_m)
    hits = np.unique(detections.scan[owner >= 0] * n + owner[owner >= 0])
    for start in range(0, len(views), _BATCH):
        batch = np.arange(start, min(start + _BATCH, len(views)))
        found: Any = tree.query_ball_point(views.poses[batch, :2], reach_m)
        scan = np.repeat(batch, [len(rows) for rows in found])
        pole = np.concatenate([np.asarray(rows, dtype=np.int64) for rows in found])
        in_view, distance, bearing = views.in_view_at(scan, points_m[pole])
        hit = np.isin(scan * n + pole, hits)
        usable = in_view | hit
        scan, pole, hit = scan[usable], pole[usable], hit[usable]
        distance, bearing = distance[usable], bearing[usable]
        free = hit | ~_hidden(detections, scan, distance, bearing)
        column = _bin(distance[free])
        np.add.at(expected, (pole[free], column), 1)
        np.add.at(seen, (pole[free & hit], _bin(distance[free & hit])), 1)
    return seen, expected


def _bin(distance_m: Floats) -> Whole:
    return np.clip((distance_m // RANGE_STEP_M).astype(np.int64), 0, RANGE_BINS - 1)


def scan_weight(stamps: Floats) -> float:
    """What one scan counts as an independent one."""
    if len(stamps) < 2:
        return 1.0
    return float(min(1.0, np.median(np.diff(stamps)) / INDEPENDENT_SCAN_S))


def _hidden(
    detections: MapDetections, scan: Whole, distance: Floats, bearing: Floats
) -> NDArray[np.bool_]:
    """Whether something that was seen in the same scan stands before the point."""
    starts = np.searchsorted(detections.scan, scan, side="left")
    ends = np.searchsorted(detections.scan, scan, side="right")
    hidden = np.zeros(len(scan), dtype=bool)
    views = detections.views
    for step in range(int((ends - starts).max(initial=0))):
        row = np.minimum(starts + step, len(detections) - 1)
        usable = starts + step < ends
        _, near, toward = views.in_view_at(scan, detections.points_m[row])
        width = np.where(np.isfinite(detections.width_m[row]), detections.width_m[row], 0.2)
        # its shadow, and a little for what neither of the two bearings tells exactly
        half = width / 2.0 / np.maximum(near, 0.5) + 0.01
        hidden |= usable & (near < distance - 1.0) & (np.abs(toward - bearing) < half)
    return hidden


def detection_probability(parts: list[Visibility]) -> Floats:
    """Probability by range `(bins,)` that a pole in view is seen, from poles beyond doubt."""
    seen, expected = np.zeros(RANGE_BINS), np.zeros(RANGE_BINS)
    for part in parts:
        sure = part.detected.sum(axis=1) >= _ESTABLISHED
        seen += part.detected[sure].sum(axis=0)
        expected += part.expected[sure].sum(axis=0)
    return (seen + _PRIOR_SEEN) / (expected + _PRIOR_EXPECTED)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Independent scans of one drive at each pole `(n,)`: how many, and how many saw it."""

    detected: Floats
    expected: Floats


def evidence(part: Visibility, detection: Floats) -> Evidence:
    """Count scans as independent ones, and far ones as little as they are worth."""
    worth = np.minimum(detection / detection.max(), 1.0)
    detected = part.detected.sum(axis=1) * part.weight
    expected = np.maximum(part.detected, part.expected * worth).sum(axis=1) * part.weight
    return Evidence(detected, np.maximum(expected, detected))


def visibility_prior(drives: list[Evidence]) -> tuple[float, float]:
    """Beta prior `(a, b)` of the share of scans that see a standing pole, from those that are seen.

    Moments over all drives; Jeffreys' prior where too few poles tell.
    """
    share = np.concatenate(
        [
            (d.detected / np.maximum(d.expected, 1e-9))[(d.expected >= 3.0) & (d.detected >= 1.5)]
            for d in drives
        ]
    )
    if len(share) < _POLES_MIN:
        return 0.5, 0.5
    mean, variance = float(share.mean()), max(float(share.var()), 1e-4)
    mean = min(max(mean, 0.05), 0.95)
    strength = min(max(mean * (1.0 - mean) / variance - 1.0, 0.8), 10.0)
    return mean * strength, (1.0 - mean) * strength


def drive_log_odds(
    drive: Evidence,
    before: Evidence | None,
    prior: tuple[float, float] = (0.5, 0.5),
) -> Floats:
    """What one drive says about each pole, `(n,)`, limited to `DRIVE_LOG_ODDS_MAX`.

    Poles differ in how visible they are (a bush before one, a hedge behind another), so that the
    share that is seen is not known but drawn from a Beta distribution: that of all poles, sharpened
    by what the drives before counted at this one, if they saw it at all. Its marginal likelihood
    stands against chance detections.
    """
    a, b = np.full(len(drive.detected), prior[0]), np.full(len(drive.detected), prior[1])
    if before is not None:
        # scans before it stood there say nothing about how visible it is
        share = np.minimum(1.0, _MEMORY / np.maximum(before.expected, 1e-9)) * (before.detected > 0)
        a, b = a + share * before.detected, b + share * (before.expected - before.detected)
    false, missed = FALSE_ALARM_PROBABILITY, drive.expected - drive.detected
    stands = scipy.special.betaln(a + drive.detected, b + missed) - scipy.special.betaln(a, b)
    nothing = drive.detected * np.log(false) + missed * np.log(1.0 - false)
    limit = DRIVE_LOG_ODDS_MAX
    return np.asarray(np.clip(stands - nothing, -limit, limit))


def existence(drives: list[Evidence], prior_log_odds: Floats) -> Floats:
    """Existence `(n,)` after drives in the order of time, each limited, the sum limited too."""
    total = np.array(prior_log_odds, dtype=np.float64)
    prior = visibility_prior(drives)
    before: Evidence | None = None
    for drive in drives:
        odds = drive_log_odds(drive, before, prior)
        total = np.clip(total + odds, -LOG_ODDS_MAX, LOG_ODDS_MAX)
        before = (
            drive
            if before is None
            else Evidence(before.detected + drive.detected, before.expected + drive.expected)
        )
    return np.asarray(1.0 / (1.0 + np.exp(-total)))
