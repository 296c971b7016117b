"""Units and signs: scale of speed and yaw rate of one stream against another."""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.odometer import Odometer, common_spans
from polemap.drivelog.plausibility.units import ANGLE_UNITS, SPEED_UNITS, named_unit

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Scales:
    """`first` over `second`: ratio of ways and of turns, NaN where the drive does not show it."""

    speed: float
    turn: float
    speed_spans: int
    turn_spans: int


# Clean drives of every kind: odometry over reference 0.995 to 1.015 (ways) and 0.96 to 1.05
# (turns); over GNSS 0.94 to 1.06 and, as chords of noisy fixes turn too, 0.33 to 1.65.
_SPEED_DOUBT, _SPEED_WRONG = 1.10, 1.25
_TURN_DOUBT, _TURN_WRONG = 1.20, 1.50
_GNSS_SPEED_DOUBT, _GNSS_SPEED_WRONG = 1.30, 1.60
_GNSS_TURN_WRONG = 5.0


def find_scales(first: Odometer, second: Odometer) -> Scales:
    """Ratios over spans in which the car moves (3 m) and turns (0.08 rad).

    The spans are chosen by the second stream alone: chosen by both, noise would bias the ratio.
    """
    span_s = max(2.0, 2.0 * max(first.smooth_s, second.smooth_s))
    way_a, turn_a, way_b, turn_b = common_spans(first, second, span_s)
    noisy = max(first.smooth_s, second.smooth_s) > 1.0
    # chords of fixes must be long against their noise before their directions count
    chord_m = 15.0 if noisy else 0.5
    way_a_m = np.maximum(np.abs(way_a), np.abs(way_b)) if noisy else np.abs(way_b)
    moves = np.abs(way_b) > (8.0 if noisy else 1.0)
    turns = (np.abs(turn_b) > 0.08) & (way_a_m > chord_m)
    speed = float(np.median(way_a[moves] / way_b[moves])) if moves.sum() >= 2 else float("nan")
    turn = float("nan")
    if np.abs(turn_b[turns]).sum() > 0.3:
        turn = _weighted_median(turn_a[turns] / turn_b[turns], np.abs(turn_b[turns]))
    return Scales(speed, turn, int(moves.sum()), int(turns.sum()))


def speed_findings(
    stream: str, scales: Scales, against: str, *, noisy: bool, turn_alike: bool = False
) -> list[Finding]:
    """What the ratio of the speed of `stream` to that of `against` says."""
    ratio = scales.speed
    doubt, wrong = (_GNSS_SPEED_DOUBT, _GNSS_SPEED_WRONG) if noisy else (_SPEED_DOUBT, _SPEED_WRONG)
    if not np.isfinite(ratio) or (ratio > 0.0 and abs(log(ratio)) < log(doubt)):
        return []
    value = f"its speed is {ratio:.4g} times that of {against} (median of {scales.speed_spans})"
    if ratio <= 0.0:
        sign = "backward" if ratio < 0.0 else "no"
        remedy = "change the sign of the speed"
        return [
            Finding(
                "speed_sign", "error", stream, f"it tells {sign} motion where {against} moves "
                f"forward (ratio {ratio:.3g})", "forward positive, ratio 1",
                remedy if ratio < 0.0 else "check that the speed is recorded",
            )
        ]  # fmt: skip
    if turn_alike:
        return [
            Finding(
                "stamp_unit", "error", stream, f"{value}, and its turns are off by as much",
                "ratio 1", "write the stamps in seconds",
            )
        ]  # fmt: skip
    unit = named_unit(ratio, SPEED_UNITS)
    severe = abs(log(ratio)) > log(wrong)
    return [
        Finding(
            "speed_unit" if unit else "speed_scale",
            "error" if severe else "warning",
            stream,
            value + (f", the factor of {unit}" if unit else ""),
            f"1 within {100 * (doubt - 1):.0f} %",
            "write the speed in m/s" if unit else "calibrate the wheel radius, or check the unit",
        )
    ]


def turn_findings(stream: str, scales: Scales, against: str, *, noisy: bool) -> list[Finding]:
    """What the ratio of the yaw rate of `stream` to that of `against` says."""
    ratio = scales.turn
    if not np.isfinite(ratio):
        return []
    wrong = _GNSS_TURN_WRONG if noisy else _TURN_WRONG
    doubt = _GNSS_TURN_WRONG if noisy else _TURN_DOUBT
    size = abs(ratio)
    value = f"it turns {ratio:.3g} times as fast as {against} ({scales.turn_spans} bends)"
    found = []
    if ratio < 0.0 and size > (0.15 if noisy else 0.05):
        found.append(
            Finding(
                "yaw_rate_sign", "error", stream,
                f"it turns against {against} (ratio {ratio:.3g} in {scales.turn_spans} bends)",
                "the same sense, counter-clockwise positive", "change the sign of the yaw rate",
            )
        )  # fmt: skip
    if size < 1e-3 or abs(log(size)) > log(doubt):
        unit = named_unit(size, ANGLE_UNITS, 0.25 if noisy else 0.08)
        severe = size < 1e-3 or abs(log(size)) > log(wrong)
        if noisy and size < 1.0 and not unit:
            # the noise of the fixes turns too; only a turn rate too large is certain
            return found
        found.append(
            Finding(
                "yaw_rate_unit" if unit else "yaw_rate_scale",
                "error" if severe else "warning",
                stream,
                value + (f", the factor of {unit}" if unit else ""),
                f"1 within {100 * (doubt - 1):.0f} %",
                "write the yaw rate in rad/s" if unit else "check the yaw rate's unit and scale",
            )
        )
    return found


def _weighted_median(values: Floats, weights: Floats) -> float:
    order = np.argsort(values)
    share = np.cumsum(weights[order]) / weights.sum()
    return float(values[order][np.searchsorted(share, 0.5)])
