"""Errors of estimates against the reference of their log."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.estimators.base import GPS
from polemap.electric.estimators.registry import known_estimators
from polemap.electric.gaps import find_gaps, settled
from polemap.electric.signals import Played, SignalLog
from polemap.vehicle.motion import sideslip_at
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import KINEMATIC_SPEED_MPS

Floats = NDArray[np.float64]
SETTLED_S = 2.0
"""Scoring starts this long after the first row and after a gap: no filter knows its start."""


def at_reference(name: str, played: Played, signals: SignalLog, car: Car) -> Floats:
    """Side-slip `(n,)` where the reference measures it.

    A model's side-slip is that of the centre of gravity; one that hears GPS is the antenna's.
    """
    slip = played.column("sideslip_rad")
    if GPS in known_estimators()[name].late or "yaw_rate_radps" not in played.fields:
        return slip
    speed = np.maximum(signals.held("vx_mps"), 1.0)
    return np.asarray(
        sideslip_at(slip, played.column("yaw_rate_radps"), speed, car.sideslip_point_m)
    )


def score(
    name: str, played: Played, signals: SignalLog, car: Car, from_s: float = float("-inf")
) -> dict[str, object]:
    """Errors against the reference of the log from `from_s` on; empty without one.

    A car that stands has no side-slip: rows below `KINEMATIC_SPEED_MPS` are counted, not scored.
    """
    result: dict[str, object] = {}
    late = settled(played.stamp_s, find_gaps(signals), SETTLED_S) & (played.stamp_s >= from_s)
    if signals.has("sideslip_rad"):
        truth = signals.columns["sideslip_rad"]
        slip = at_reference(name, played, signals, car)
        scored = late & np.isfinite(truth)
        slow = scored & (np.abs(signals.held(_speed_name(signals))) < KINEMATIC_SPEED_MPS)
        scored &= ~slow
        # a side-slip beyond a right angle is no estimate, and none may be left out of a figure
        failed = scored & ~(np.abs(slip) < np.pi / 2.0)
        error = np.degrees((slip - truth)[scored & ~failed])
        if scored.any():
            result = {"estimator": name, "sideslip_rmse_deg": None, "sideslip_p95_deg": None}
            if slow.any():
                result["rows_standing"] = int(slow.sum())
            if failed.any():
                result["rows_not_estimated"] = int(failed.sum())
            else:
                result["sideslip_rmse_deg"] = round(float(np.sqrt(np.mean(error**2))), 5)
                result["sideslip_p95_deg"] = round(float(np.percentile(np.abs(error), 95)), 5)
                stated = np.degrees(played.sd_of("sideslip_rad")[scored])
                if (stated > 0.0).all():
                    result["sideslip_nees"] = round(float(np.mean((error / stated) ** 2)), 4)
    for field, reference in (("vx_mps", "vx_reference_mps"), ("vy_mps", "vy_mps")):
        if not signals.has(reference) or field not in played.fields:
            continue
        truth = signals.columns[reference]
        scored = late & np.isfinite(truth)
        error = (played.column(field) - truth)[scored]
        if len(error):
            result.setdefault("estimator", name)
            if not np.isfinite(error).all():
                result["rows_not_estimated"] = int(np.count_nonzero(~np.isfinite(error)))
                continue
            stem = field.removesuffix("_mps")
            result[f"{stem}_rmse_mps"] = round(float(np.sqrt(np.mean(error**2))), 5)
            result[f"{stem}_p95_mps"] = round(float(np.percentile(np.abs(error), 95)), 5)
    return result


def _speed_name(signals: SignalLog) -> str:
    return "vx_mps" if signals.has("vx_mps") else "speed_mps"
