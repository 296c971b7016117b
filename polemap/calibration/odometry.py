"""Scale and delay of the wheel odometry against another witness of the same motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.calibration.estimate import Fit, blocks_of, fit, spread
from polemap.calibration.motion import CameraSteps
from polemap.drivelog.drive import Drive
from polemap.drivelog.plausibility.odometer import Odometer, of_odometry, of_reference
from polemap.stereo.rig import Mounting

Floats = NDArray[np.float64]

_SPAN_S, _EVERY_S = 0.5, 0.25
_SPANS_MIN, _SPANS_MAX = 60, 4000
_LAG_MAX_S, _LAG_STEP_S = 1.0, 0.02
_BLOCK_S = 5.0
_LEAST = 20
_DIFFERENCE_S = 0.02
_EXPLAINED_MIN = 0.6
_REFERENCE_FLOOR, _CAMERA_FLOOR = 0.0005, 0.003
# by ways and by turns: wheels slip with the acceleration, which looks like 10 to 20 ms
_DELAY_FLOORS_S = (0.02, 0.003)


@dataclass(frozen=True, slots=True)
class Witness:
    """Ways and turns `(n,)` of the rear axle over spans of time, from one source.

    `scale_floor` is the standard deviation of its own scale, however long it lasts.
    """

    name: str
    from_s: Floats
    to_s: Floats
    way_m: Floats
    turn_rad: Floats
    scale_floor: float


@dataclass(frozen=True, slots=True)
class OdometryErrors:
    """What the odometry says against a witness, with standard deviations.

    Attributes:
        against: name of the witness.
        speed_scale: what it says for one true metre.
        delay_s: how much later its stamps are than what they are of; NaN where neither speed nor
            turn rate change enough to tell.
        spans: how many were compared.
    """

    against: str
    speed_scale: float
    speed_scale_sd: float
    delay_s: float
    delay_sd_s: float
    spans: int


def of_reference_poses(drive: Drive) -> Witness | None:
    """The reference of a drive as a witness, over spans of half a second."""
    if drive.reference is None or len(drive.reference) < _LEAST:
        return None
    odometer = of_reference(drive.reference)
    first, last = odometer.stamp_s[0], odometer.stamp_s[-1] - _SPAN_S
    if not last > first:
        return None
    # of a long drive spans from everywhere, of a short one spans that overlap more
    count = int(np.clip((last - first) / _EVERY_S, _SPANS_MIN, _SPANS_MAX))
    from_s = np.linspace(first, last, count)
    # the reference is linear between its poses: spans begin at one
    from_s = np.unique(odometer.stamp_s[np.searchsorted(odometer.stamp_s, from_s)])
    nearest = np.searchsorted(odometer.stamp_s, from_s + _SPAN_S)
    to_s = odometer.stamp_s[np.minimum(nearest, len(odometer) - 1)]
    way, turn, known = odometer.spans(from_s, to_s)
    known &= to_s > from_s
    return Witness(
        drive.names.reference, from_s[known], to_s[known], way[known], turn[known], _REFERENCE_FLOOR
    )


def of_camera(steps: CameraSteps, mount: Mounting) -> Witness | None:
    """The camera's own motion as a witness: the way of the rear axle behind it."""
    if len(steps) < _LEAST:
        return None
    moved, turn = steps.in_vehicle(mount)
    # the camera of a turning car moves by the turn about the axle, too
    way = moved[:, 0] + mount.y_m * np.sin(turn) + mount.x_m * (1.0 - np.cos(turn))
    return Witness("the camera", steps.from_s, steps.to_s, way, turn, _CAMERA_FLOOR)


def odometry_errors(drive: Drive, witness: Witness) -> OdometryErrors | None:
    """Scale and delay of a drive's odometry; None where they share too little of the time."""
    if drive.odometry is None or len(drive.odometry) < _LEAST:
        return None
    odometer = of_odometry(drive.odometry)
    best = _coarse_delay(odometer, witness)
    if best is None:
        return None
    delay, delay_sd = best, float("inf")
    way_fit = turn_fit = None
    for _ in range(6):
        way_fit, turn_fit = _linearised(odometer, witness, delay)
        if way_fit is None or turn_fit is None:
            return None
        steps = np.array([-way_fit.values[1], -turn_fit.values[2]])
        sds = np.hypot([way_fit.sd[1], turn_fit.sd[2]], _DELAY_FLOORS_S)
        usable = np.isfinite(sds) & (sds > 0.0)
        usable &= [
            _explained(f, t) > _EXPLAINED_MIN
            for f, t in ((way_fit, witness.way_m), (turn_fit, witness.turn_rad))
        ]
        weight = np.where(usable, 1.0 / np.maximum(sds, 1e-6) ** 2, 0.0)
        if not weight.sum() > 0.0:
            delay_sd = float("inf")
            break
        step = float(steps @ weight / weight.sum())
        delay_sd = float(1.0 / np.sqrt(weight.sum()))
        delay = float(np.clip(delay + np.clip(step, -0.1, 0.1), -_LAG_MAX_S, _LAG_MAX_S))
        if abs(step) < 1e-4:
            break
    if way_fit is None or turn_fit is None:
        return None
    told = delay_sd < 0.1
    return OdometryErrors(
        against=witness.name,
        speed_scale=float(way_fit.values[0]),
        speed_scale_sd=float(np.hypot(way_fit.sd[0], witness.scale_floor)),
        delay_s=delay if told else float("nan"),
        delay_sd_s=delay_sd if told else float("nan"),
        spans=len(way_fit.residuals),
    )


def _explained(found: Fit, witnessed: Floats) -> float:
    """Share of the variation of a witness that the odometry follows."""
    whole = spread(witnessed)
    return 1.0 - (spread(found.residuals) / whole) ** 2 if whole > 0.0 else 0.0


def _linearised(
    odometer: Odometer, witness: Witness, delay_s: float
) -> tuple[Fit | None, Fit | None]:
    """Fits of way and turn: scale [, bias], and by how much the delay is too large."""
    from_s, to_s = witness.from_s + delay_s, witness.to_s + delay_s
    way, turn, known = odometer.spans(from_s, to_s)
    later = odometer.spans(from_s + _DIFFERENCE_S, to_s + _DIFFERENCE_S)
    sooner = odometer.spans(from_s - _DIFFERENCE_S, to_s - _DIFFERENCE_S)
    known = known & later[2] & sooner[2]
    if known.sum() < _LEAST:
        return None, None
    block = blocks_of(witness.from_s[known], _BLOCK_S)
    by_delay = (np.subtract(later[:2], sooner[:2]) / (2.0 * _DIFFERENCE_S))[:, known]
    span = (to_s - from_s)[known]
    way_design = np.column_stack([witness.way_m[known], by_delay[0]])
    turn_design = np.column_stack([witness.turn_rad[known], span, by_delay[1]])
    # at delay + d the odometer shows what the witness has: way(delay) = scale * truth - way' d
    return fit(way_design, way[known], block), fit(turn_design, turn[known], block)


def _coarse_delay(odometer: Odometer, witness: Witness) -> float | None:
    """Where on a grid ways and turns fit best."""
    lags = np.arange(-_LAG_MAX_S, _LAG_MAX_S + 1e-9, _LAG_STEP_S)
    cost = np.full(len(lags), np.inf)
    block = np.zeros(len(witness.from_s), dtype=np.int64)
    for k, lag in enumerate(lags):
        way, turn, known = odometer.spans(witness.from_s + lag, witness.to_s + lag)
        if known.sum() < max(_LEAST, 0.5 * len(known)):
            continue
        total = 0.0
        span = np.ones(len(way))
        for told, true in ((way, witness.way_m), (turn, witness.turn_rad)):
            design = np.column_stack([true, span])[known]
            rest = fit(design, told[known], block[known]).residuals
            total += float(np.log(np.mean(np.minimum(np.abs(rest), 3 * np.median(np.abs(rest)))**2)
                                  + 1e-12))  # fmt: skip
        cost[k] = total
    return float(lags[np.argmin(cost)]) if np.isfinite(cost).any() else None
