"""Prediction errors of a car on rows of logs, and what each of them is worth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from polemap.electric.identification.parameters import Sensors
from polemap.electric.identification.prediction import Predicted, Rows, predict_rows
from polemap.electric.identification.unmodelled import unmodelled_sds
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]

SIDESLIP, YAW_RATE, LATERAL = "sideslip_rad", "yaw_rate_radps", "ay_mps2"
CHANNELS = (SIDESLIP, YAW_RATE, LATERAL)
SPEED_MPS = 3.0
"""Slower rows are not compared: their side-slip is one of rolling."""
# noise of sensors in a residual, and the least share of what tyres do beyond a model that is
# believed of one
_SENSOR_SDS = {SIDESLIP: 0.001, YAW_RATE: 0.002, LATERAL: 0.05}
_LEAST_SHARE = 0.2
# residuals are means over this time: what is faster is noise and vibration
_BLOCK_S = 0.1


def residuals(
    point: tuple[Car, Sensors], stretches: Sequence[Rows], *, hear_reference: bool = True
) -> dict[str, Floats]:
    """Seen minus predicted by channel, means over 0.1 s at speed, all stretches in a row.

    Args:
        point: a car and its sensors.
        stretches: rows without gaps.
        hear_reference: whether predictions follow the side-slip reference.
    """
    found: dict[str, list[Floats]] = {}
    for rows in stretches:
        told = predict_rows(*point, rows, hear_reference=hear_reference)
        for channel, off, keep in _errors(rows, told):
            found.setdefault(channel, []).append(off[keep])
    return {channel: np.concatenate(parts) for channel, parts in found.items()}


def residual_sds(
    point: tuple[Car, Sensors], stretches: Sequence[Rows], *, fitted: bool = True
) -> dict[str, Floats]:
    """What one residual is worth, by channel: its spread, grown by how alike neighbours are.

    The spread goes with what tyres do beyond their model (`unmodelled_sds`), in a proportion that
    the residuals tell. Errors of a model last for a bend: with autocorrelation r_k only one in
    1 + 2 sum r_k residuals is news.

    Args:
        point, stretches: as in `residuals`.
        fitted: whether the residuals are those of a fit and tell anything of it; those of a start
            that is far off would say that nothing can be told.
    """
    found: dict[str, list[Floats]] = {}
    shapes: dict[str, list[Floats]] = {}
    for rows in stretches:
        told = predict_rows(*point, rows)
        heard = rows.sideslip_rad is not None
        beyond = unmodelled_sds(point[0], rows, told, reference_heard=heard)
        for channel, off, keep in _errors(rows, told):
            found.setdefault(channel, []).append(off[keep])
            sd = np.hypot(_means(rows, beyond[channel]), _SENSOR_SDS[channel])
            shapes.setdefault(channel, []).append(sd[keep])
    sds = {}
    for channel, parts in found.items():
        shape = np.concatenate(shapes[channel])
        values = np.concatenate(parts) / shape
        sds[channel] = shape
        if fitted and len(values):
            share = max(1.4826 * float(np.median(np.abs(values))), _LEAST_SHARE)
            sds[channel] = share * np.sqrt(_alike(values / share)) * shape
    return sds


def _errors(rows: Rows, told: Predicted) -> Iterator[tuple[str, Floats, NDArray[np.bool_]]]:
    """Channel, seen minus predicted in blocks, and which blocks are compared."""
    every = _every(rows)
    count = len(rows.stamp_s) // every
    speeds = rows.speed_mps[: count * every].reshape(count, every)
    fast = speeds.min(axis=1) > SPEED_MPS
    for channel in CHANNELS:
        seen = getattr(rows, channel)
        if seen is not None:
            off = _means(rows, seen - getattr(told, channel))
            yield channel, off, fast & np.isfinite(off)


def _every(rows: Rows) -> int:
    return max(1, round(_BLOCK_S / float(np.median(np.diff(rows.stamp_s)))))


def _means(rows: Rows, values: Floats) -> Floats:
    every = _every(rows)
    count = len(values) // every
    return np.asarray(values[: count * every].reshape(count, every).mean(axis=1))


def _alike(values: Floats) -> float:
    """How many residuals make one that is news."""
    clipped = np.clip(values, -3.0, 3.0)
    power = float(np.mean(clipped**2))
    alike, lag = 1.0, 1
    while power > 0.0 and lag < min(100, len(clipped) // 4):
        r = float(np.mean(clipped[lag:] * clipped[:-lag])) / power
        if r < 0.05:
            break
        alike += 2.0 * r
        lag += 1
    return alike
