"""Stated accuracies against the scatter that is seen: a deviation that is too small is believed.

A scatter is what is left of positions, over some seconds, when the way that another stream tells
is laid through them (its place, heading, scale and drift free). Errors that last longer do not
show in it, so that it is a lower bound; against a reference the whole error of the fixes shows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.fix_delay import find_way, way_unknowns
from polemap.drivelog.plausibility.odometer import Odometer
from polemap.drivelog.plausibility.scan_pairs import find_pairs, meetings
from polemap.drivelog.streams import SD_AT_DILUTION_ONE_M
from polemap.vehicle.pose import rotate

Floats = NDArray[np.float64]

_POINTS_MIN, _POINTS_MAX, _WINDOWS_MAX = 8, 60, 200
_FIXES_S, _POSES_S = 12.0, 2.0
_MOVES_M = 5.0
# the median size of an error in the plane, in standard deviations an axis
_MEDIAN_OF_SD = 1.1774
# clean drives: errors of fixes to 1.8 times what is stated, scatter 0.5 times; poses 0.2 times
_TIMES = 3.0
_FIXES_LEAST_M, _FIXES_MOST_M, _POSES_LEAST_M = 0.3, 50.0, 0.1
# squares of distances of poles met again, over what their variances say: 0.2 to 6.8 on clean drives
_POLES_MIN = 40
_POLES_SMALL, _POLES_LARGE = 16.0, 0.02


def fix_findings(drive: Drive, motion: Odometer, *, is_reference: bool) -> list[Finding]:
    """Fixes that scatter more than they state.

    Args:
        is_reference: the motion is that of the drive's reference.
    """
    gnss = drive.gnss
    if gnss is None or len(gnss) < _POINTS_MIN:
        return []
    stated = SD_AT_DILUTION_ONE_M * float(np.median(gnss.hdop))
    points = np.stack([gnss.east_m, gnss.north_m], axis=1)
    seen = scatter_m(gnss.stamp_s, points, motion, _FIXES_S)
    what = "scatter by"
    if is_reference and drive.reference is not None:
        poses = drive.reference.at(gnss.stamp_s, max_gap_s=1.0)
        off = points - poses[:, :2] - rotate(drive.gnss_antenna_m, poses[:, 2])
        size = np.hypot(*off[np.isfinite(off).all(axis=1)].T)
        whole = float(np.median(size)) / _MEDIAN_OF_SD if len(size) >= _POINTS_MIN else 0.0
        if not seen >= whole:
            seen, what = whole, "are off by"
    # farther off they are in another place, which `places` names
    if not max(_TIMES * stated, _FIXES_LEAST_M) < seen < _FIXES_MOST_M:
        return []
    return [
        Finding(
            "gnss_accuracy", "warning", drive.names.gnss,
            f"the fixes {what} {seen:.2g} m an axis round the way of {motion.name}",
            f"{stated:.2g} m, which they state (hdop {np.median(gnss.hdop):.2g} times "
            f"{SD_AT_DILUTION_ONE_M:g} m)",
            f"state a deviation that holds: hdop {seen / SD_AT_DILUTION_ONE_M:.2g}, or a variance "
            f"of {seen**2:.2g} m2",
        )
    ]  # fmt: skip


def pose_findings(drive: Drive, odometry: Odometer) -> list[Finding]:
    """A reference that scatters more than it states."""
    reference = drive.reference
    if reference is None or len(reference) < _POINTS_MIN:
        return []
    known = reference.sd_m[np.isfinite(reference.sd_m)]
    if not len(known):
        return []
    stated = float(np.median(known))
    step = float(np.median(np.diff(reference.stamp_s)))
    span = min(max(_POSES_S, 1.5 * _POINTS_MIN * step), _FIXES_S)
    seen = scatter_m(reference.stamp_s, reference.poses[:, :2], odometry, span)
    if not seen > max(_TIMES * stated, _POSES_LEAST_M):
        return []
    return [
        Finding(
            "reference_accuracy", "warning", drive.names.reference,
            f"its positions scatter by {seen:.2g} m an axis round the way of {odometry.name}",
            f"{stated:.2g} m, which sd_m states", f"write an sd_m that holds, {seen:.2g} m",
        )
    ]  # fmt: skip


def scatter_m(stamps_s: Floats, points_m: Floats, motion: Odometer, span_s: float) -> float:
    """Standard deviation an axis of points `(n, 2)` round a way, over spans; NaN if too few."""
    places, _, _, known = find_way(motion, stamps_s)
    known &= np.isfinite(points_m).all(axis=1)
    number = np.floor((stamps_s - stamps_s[0]) / span_s)
    spans = np.unique(number[known])
    if len(spans) > _WINDOWS_MAX:
        spans = spans[np.linspace(0, len(spans) - 1, _WINDOWS_MAX).astype(np.int64)]
    spreads = []
    for span in spans:
        rows = np.flatnonzero(known & (number == span))
        if len(rows) < _POINTS_MIN or np.ptp(places[rows], axis=0).max() < _MOVES_M:
            continue
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, _POINTS_MAX).astype(np.int64))]
        spreads.append(_spread(stamps_s[rows], points_m[rows], places[rows]))
    return float(np.median(spreads)) if spreads else float("nan")


def _spread(stamps: Floats, points: Floats, places: Floats) -> float:
    a, b = places - places.mean(axis=0), points - points.mean(axis=0)
    turn = float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
    a = rotate(a, turn)
    shift = [np.tile(axis, (len(a), 1)) for axis in ([1.0, 0.0], [0.0, 1.0])]
    columns = [column.ravel() for column in shift + way_unknowns(a, stamps)]
    design, off = np.stack(columns, axis=1), (b - a).ravel()
    rest, weight = off, np.ones(len(off))
    for _ in range(8):
        # outliers are no scatter
        root = np.sqrt(weight)
        fit = np.linalg.lstsq(design * root[:, None], off * root, rcond=None)[0]
        rest = off - design @ fit
        scale = 1.4826 * float(np.median(np.abs(rest))) + 1e-6
        weight = 1.0 / (1.0 + (rest / (2.0 * scale)) ** 2) ** 2
    freedom = len(rest) / (len(rest) - design.shape[1])
    return 1.4826 * float(np.median(np.abs(rest))) * float(np.sqrt(freedom))


def variance_findings(drive: Drive, motion: Odometer) -> list[Finding]:
    """Variances of poles that a scan a second later sees again: too small or too large."""
    pairs = find_pairs(drive, motion)
    if not len(pairs):
        return []
    offset, covariance = meetings(pairs, motion)
    if len(offset) < _POLES_MIN:
        return []
    rest = np.linalg.solve(covariance, offset[..., None])[..., 0]
    # 2 ln 2 is the median of such a square if the variances hold
    ratio = float(np.median((offset * rest).sum(axis=1))) / (2.0 * np.log(2.0))
    if _POLES_LARGE < ratio < _POLES_SMALL:
        return []
    size = float(np.median(np.hypot(*offset.T))) / _MEDIAN_OF_SD
    stated = float(np.sqrt(np.median(np.trace(covariance, axis1=1, axis2=2)) / 2.0))
    kind = "smaller" if ratio > 1.0 else "larger"
    return [
        Finding(
            "pole_variance", "warning", drive.names.poles,
            f"poles met a second later lie {size:.2g} m off an axis ({len(offset)} met): their "
            f"variances are {max(ratio, 1.0 / max(ratio, 1e-12)):.2g} times {kind} than that",
            f"{stated:.2g} m, which the variances of both say",
            "write variances in square metres (a standard deviation squared)",
        )
    ]  # fmt: skip
