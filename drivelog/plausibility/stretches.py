"""What is wrong for a part of a drive only: values that stand still, stretches that disagree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import log

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.odometer import Odometer, common_spans, span_starts
from polemap.drivelog.streams import GnssStream

Floats = NDArray[np.float64]

_SPAN_S = 10.0
# clean drives: ways over ten seconds within 5 %, of fixes within 25 % but for their jumps
_WAY_MIN_M, _RATIO, _STRETCHES, _SHARE = 15.0, 1.25, 2, 0.05
_NOISY_WAY_MIN_M, _NOISY_RATIO, _NOISY_STRETCHES, _NOISY_SHARE = 40.0, 1.6, 3, 0.2
# clean drives: turns over ten seconds within 12 degrees
_TURN_WAY_MIN_M, _TURN_RAD, _TURN_SHARE, _TURN_TOTAL = 5.0, np.radians(30.0), 0.25, 4
# a yaw rate from steering is off by 0.005 rad/s, a gyro by less
_OFFSET_RADPS, _OFFSET_SPANS = 0.02, 3
_SAME_ROWS, _VARIES = 50, 1.3
_FROZEN_WAY_M = 30.0
# a road that is straight to the last digit is none; a car that stands turns by its gyro's offset
_FROZEN_RATE_WAY_M, _TURNS_RADPS = 200.0, 0.08


def frozen_speed(drive: Drive, judge: Odometer | None) -> list[Finding]:
    """A speed, or a yaw rate, that is the same in every row while another stream's varies."""
    odometry = drive.odometry
    if odometry is None or len(odometry) < _SAME_ROWS:
        return []
    speed, rate = odometry.speed_mps, odometry.yaw_rate_radps
    stream, rows = drive.names.odometry, len(odometry)
    if np.ptp(rate) == 0.0 and np.ptp(speed) > 0.0:
        way_m = float(np.abs(speed).mean() * np.ptp(odometry.stamp_s))
        noisy = judge is None or judge.smooth_s > 1.0
        if noisy and way_m > _FROZEN_RATE_WAY_M:
            return [
                Finding(
                    "yaw_rate_frozen", "warning", stream,
                    f"yaw_rate_radps is {rate[0]:g} in all {rows} rows, over {way_m:.0f} m of way",
                    "a measured yaw rate", "write the yaw rate as it was measured, not a default",
                )
            ]  # fmt: skip
    if np.ptp(speed) > 0.0:
        return []
    if judge is None:
        # a car that turns goes; one that keeps its speed is believed
        fastest = float(np.percentile(np.abs(rate), 95))
        if fastest < _TURNS_RADPS or speed[0] != 0.0:
            return []
        value = f"{stream} turns at {fastest:.2f} rad/s"
    else:
        starts = span_starts(judge, _SPAN_S / 2.0)
        way, _, known = judge.spans(starts, starts + _SPAN_S / 2.0)
        speeds = np.abs(way[known]) / (_SPAN_S / 2.0)
        if len(speeds) < 3 or speed[0] == 0.0:
            return []
        low, high = np.percentile(speeds, [10, 90])
        if high < _VARIES * low or high < 1.0:
            return []
        value = f"{judge.name} goes at {low:.1f} to {high:.1f} m/s"
    return [
        Finding(
            "speed_frozen", "error" if judge is not None else "warning", stream,
            f"speed_mps is {speed[0]:g} in all {rows} rows, {value}", "a measured speed",
            "write the speed as it was measured, not a default",
        )
    ]  # fmt: skip


def frozen_fixes(drive: Drive, motion: Odometer | None) -> tuple[list[Finding], GnssStream | None]:
    """The same fix again and again while the car goes on, and the fixes without these."""
    gnss = drive.gnss
    if gnss is None or motion is None or len(gnss) < 3:
        return [], gnss
    same = (np.diff(gnss.east_m) == 0.0) & (np.diff(gnss.north_m) == 0.0)
    run = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    firsts, lasts = run[::2], run[1::2]
    if not len(firsts):
        return [], gnss
    way, _, known = motion.spans(gnss.stamp_s[firsts], gnss.stamp_s[lasts])
    stuck = known & (np.abs(way) > _FROZEN_WAY_M)
    if not stuck.any():
        return [], gnss
    longest = int(np.argmax(np.where(stuck, np.abs(way), 0.0)))
    moving = np.concatenate([[True], ~same])
    return [
        Finding(
            "gnss_frozen", "warning", drive.names.gnss,
            f"the fix of {gnss.stamp_s[firsts[longest]]:.3f} s stands in "
            f"{lasts[longest] - firsts[longest] + 1} rows, over {abs(way[longest]):.0f} m of way",
            "fixes that move with the car", "leave rows out that repeat an old fix",
        )
    ], gnss.take(np.flatnonzero(moving))  # fmt: skip


def disagreeing_stretches(
    odometry: Odometer, judge: Odometer, third: Odometer | None
) -> list[Finding]:
    """Ways over ten seconds that differ in some stretches while the most agree.

    Args:
        third: fixes, which tell which of the two is at fault.
    """
    noisy = judge.smooth_s > 1.0
    least_m = _NOISY_WAY_MIN_M if noisy else _WAY_MIN_M
    ratio = _NOISY_RATIO if noisy else _RATIO
    starts, (way_a, way_b) = _ways(odometry, judge)
    long = np.maximum(np.abs(way_a), np.abs(way_b)) > least_m
    starts, way_a, way_b = starts[long], np.abs(way_a[long]), np.abs(way_b[long])
    off = np.abs(np.log(np.maximum(way_a, 0.1) / np.maximum(way_b, 0.1))) > log(ratio)
    count, total = int(off.sum()), len(off)
    least, share = (_NOISY_STRETCHES, _NOISY_SHARE) if noisy else (_STRETCHES, _SHARE)
    if count < least or count < share * total or count > 0.8 * total:
        return []
    stream, other = odometry, judge
    if third is not None and not noisy:
        at = starts[off]
        way_c, _, known_c = third.spans(at, at + _SPAN_S)
        if known_c.sum() >= 1:
            misses = [np.abs(w[off] - way_c)[known_c].mean() for w in (way_a, way_b)]
            stream, other = (judge, odometry) if misses[1] > misses[0] else (odometry, judge)
    first = int(np.flatnonzero(off)[0])
    mine, theirs = (way_a, way_b) if stream is odometry else (way_b, way_a)
    return [
        Finding(
            "speed_stretch", "warning", stream.name,
            f"in {count} of {total} stretches of {_SPAN_S:.0f} s its way is not that of "
            f"{other.name}; from {starts[first]:.3f} s {mine[first]:.0f} m instead of "
            f"{theirs[first]:.0f} m", f"within {100 * (ratio - 1):.0f} %",
            "cut the recording there, or mend the sensor that stuck",
        )
    ]  # fmt: skip


def disagreeing_turns(
    odometry: Odometer, judge: Odometer, suspect: Callable[[Odometer, Odometer], Odometer]
) -> list[Finding]:
    """Turns over ten seconds that differ in some stretches while the most agree.

    Args:
        judge: poses, not fixes: these turn by their noise.
        suspect: which of the two is at fault.
    """
    starts = span_starts(judge, _SPAN_S)
    way, turn_a, known_a = odometry.spans(starts, starts + _SPAN_S)
    _, turn_b, known_b = judge.spans(starts, starts + _SPAN_S)
    moving = known_a & known_b & (np.abs(way) > _TURN_WAY_MIN_M)
    starts, turn_a, turn_b = starts[moving], turn_a[moving], turn_b[moving]
    off = np.abs(turn_a - turn_b) > np.maximum(
        _TURN_RAD, _TURN_SHARE * np.maximum(np.abs(turn_a), np.abs(turn_b))
    )
    count, total = int(off.sum()), len(off)
    if not count or total < _TURN_TOTAL or count > 0.5 * total:
        return []
    first = int(np.flatnonzero(off)[0])
    stream, other = odometry, judge
    if suspect(odometry, judge) is judge:
        stream, other, turn_a, turn_b = judge, odometry, turn_b, turn_a
    mine, theirs = np.degrees(turn_a[first]), np.degrees(turn_b[first])
    return [
        Finding(
            "turn_stretch", "warning", stream.name,
            f"in {count} of {total} stretches of {_SPAN_S:.0f} s its turn is not that of "
            f"{other.name}; from {starts[first]:.3f} s {mine:.0f} degrees instead of {theirs:.0f}",
            f"within {np.degrees(_TURN_RAD):.0f} degrees",
            "cut the recording there, or mend the sensor that stuck",
        )
    ]  # fmt: skip


def _ways(first: Odometer, second: Odometer) -> tuple[Floats, tuple[Floats, Floats]]:
    starts = span_starts(first if len(first) <= len(second) else second, _SPAN_S)
    way_a, _, known_a = first.spans(starts, starts + _SPAN_S)
    way_b, _, known_b = second.spans(starts, starts + _SPAN_S)
    both = known_a & known_b
    return starts[both], (way_a[both], way_b[both])


def yaw_rate_offset(odometry: Odometer, reference: Odometer) -> tuple[Odometer, list[Finding]]:
    """A yaw rate that says a turn while the reference goes straight on.

    Returns:
        The odometry without the offset, and the finding.
    """
    _, turn_a, _, turn_b = common_spans(odometry, reference, _SPAN_S)
    if len(turn_a) < _OFFSET_SPANS:
        return odometry, []
    offset = float(np.median(turn_a - turn_b)) / _SPAN_S
    spread = float(np.median(np.abs(turn_a - turn_b - offset * _SPAN_S))) / _SPAN_S
    if abs(offset) < max(_OFFSET_RADPS, spread):
        return odometry, []
    heading = odometry.heading_rad - offset * (odometry.stamp_s - odometry.stamp_s[0])
    finding = Finding(
        "yaw_rate_offset", "warning", odometry.name,
        f"it turns by {offset:.3f} rad/s more than {reference.name} in the median",
        f"within {_OFFSET_RADPS:g} rad/s", "subtract what the sensor shows standing still",
    )  # fmt: skip
    return replace(odometry, heading_rad=heading), [finding]
