"""Poles stand still: how they move from scan to scan must be the motion that another stream tells.

A pair of scans a second apart is moved onto each other by the motion in between, as it is told and
as it would be with a mistake (a sign, a unit, a clock that is off). The mistake that brings the
poles together where the motion as told does not, is the finding.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.odometer import Odometer
from polemap.drivelog.plausibility.pole_mistakes import (
    AS_TOLD,
    LOOSELY,
    MISTAKES,
    Mistake,
    mistaken,
)
from polemap.drivelog.plausibility.scan_pairs import (
    FEW,
    ScanPairs,
    advantage,
    agreement,
    find_pairs,
)

Floats = NDArray[np.float64]

# how much better than the motion as told a mistake must agree: standard deviations, and ratio
_BETTER_SDS, _BETTER_RATIO = 5.0, 1.25
_LAG_SDS, _LAG_RATIO = 5.0, 1.08
# finely where delays of a sensor lie, then to beyond the 18 leap seconds
_SIZES_S = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5, *map(float, range(2, 21)))
_LAGS_S = (*(-size for size in _SIZES_S), *_SIZES_S)
_LAG_DOUBT_S, _LAG_WRONG_S = 0.15, 0.6
_OFFSET_STEP_RADPS, _OFFSET_MAX_RADPS, _OFFSET_DOUBT_RADPS = 0.005, 0.25, 0.02
# scans that repeat the one before to the last digit while the car moves
_REPEATED, _REPEATED_SHARE = 10, 0.5


def motion_findings(drive: Drive, motion: Odometer, *, confirmed: bool) -> list[Finding]:
    """Signs, units and clock of the poles against a motion.

    Args:
        confirmed: another stream agrees with the motion, so that the poles are at fault.
    """
    pairs = find_pairs(drive, motion)
    if len(pairs) < FEW:
        return []
    told = agreement(pairs, motion, AS_TOLD)
    loosely = agreement(pairs, motion, LOOSELY)
    ranked = [
        advantage(agreement(pairs, motion, mistake), loosely if mistake.loose else told)
        for mistake in MISTAKES
    ]
    best = int(np.argmax([sds for sds, _ in ranked]))
    if np.abs(pairs.first.points_m[..., 1]).max() <= np.pi:
        # so narrow a view fits a car that does not turn as well as bearings
        polar = next(row for row, mistake in enumerate(MISTAKES) if mistake.polar == 1.0)
        best = polar if _better(*ranked[polar]) else best
    if _better(*ranked[best]):
        mistake, ratio = MISTAKES[best], ranked[best][1]
        if mistake.kind == "pole_turn_offset":
            return _offset_finding(drive, pairs, motion, told)
        return [mistaken(mistake, drive.names.poles, motion.name, ratio, len(pairs), confirmed)]
    lags = [advantage(agreement(pairs, motion, AS_TOLD, lag), told) for lag in _LAGS_S]
    best = int(np.argmax([sds for sds, _ in lags]))
    lag, (sds, ratio) = _LAGS_S[best], lags[best]
    if sds < _LAG_SDS or ratio < _LAG_RATIO or abs(lag) < _LAG_DOUBT_S:
        return []
    late = lag < 0.0
    return [
        Finding(
            "clock_offset", "error" if abs(lag) > _LAG_WRONG_S else "warning", drive.names.poles,
            f"it tells the motion of {motion.name} about {abs(lag):.1f} s "
            f"{'late' if late else 'early'} ({ratio:.2f} times as many poles meet)",
            "the same clock",
            f"{'subtract' if late else 'add'} {abs(lag):.1f} s {'from' if late else 'to'} its "
            "stamps"
            + ("" if confirmed else f", or the other way round with those of {motion.name}"),
        )
    ]  # fmt: skip


def _better(sds: float, ratio: float) -> bool:
    return sds > _BETTER_SDS and ratio > _BETTER_RATIO


def _offset_finding(
    drive: Drive, pairs: ScanPairs, motion: Odometer, told: Floats
) -> list[Finding]:
    """A constant in the yaw rate, by the value that fits best; a gyro's common one is none."""
    rates = np.arange(-_OFFSET_MAX_RADPS, _OFFSET_MAX_RADPS + 1e-9, _OFFSET_STEP_RADPS)
    sums = [
        float(np.nansum(agreement(pairs, motion, Mistake("", "", offset_radps=float(rate)))))
        for rate in rates
    ]
    best = int(np.argmax(sums))
    if abs(rates[best]) < _OFFSET_DOUBT_RADPS:
        return []
    ratio = sums[best] / max(float(np.nansum(told)), 1e-9)
    return [
        Finding(
            "yaw_rate_offset", "warning", motion.name,
            f"it turns by {-rates[best]:.3f} rad/s more than {drive.names.poles} "
            f"({ratio:.2g} times as many meet in {len(pairs)} pairs of scans)",
            f"within {_OFFSET_DOUBT_RADPS:g} rad/s",
            "subtract what the sensor shows standing still, or check x and y of the poles",
        )
    ]  # fmt: skip


def repeated_findings(drive: Drive, motion: Odometer) -> list[Finding]:
    """Scans that are the one before once more while the car goes on."""
    scans = [scan for scan in drive.scans if len(scan)]
    if len(scans) <= _REPEATED:
        return []
    stamps = np.array([scan.stamp_s for scan in scans])
    way, _, known = motion.spans(stamps[:-1], stamps[1:])
    moved = known & (np.abs(way) > 0.01)
    same = np.array(
        [np.array_equal(a.points_vehicle_m, b.points_vehicle_m) for a, b in pairwise(scans)]
    )
    count, total = int((same & moved).sum()), int(moved.sum())
    if count < max(_REPEATED, _REPEATED_SHARE * total):
        return []
    return [
        Finding(
            "pole_repeated", "error", drive.names.poles,
            f"{count} of {total} scans repeat the poles of the scan before while {motion.name} "
            "goes on", "poles that were measured anew",
            "write the poles of each scan, by what the detector saw then",
        )
    ]  # fmt: skip


def contradicted(drive: Drive, first: Odometer, second: Odometer) -> Odometer:
    """Which of two motions the poles contradict; the second where they do not tell."""
    pairs = find_pairs(drive, first)
    sds, _ = advantage(agreement(pairs, second, AS_TOLD), agreement(pairs, first, AS_TOLD))
    return first if sds > 2.0 else second
