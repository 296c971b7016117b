"""How much later one stream tells the same motion than another.

Speeds and turn rates of both are laid on one grid over their common stretch and correlated over
all lags. The sign and the scale of neither matter (they are held against each other elsewhere), so
that a mistake in them does not hide one in time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.plausibility.odometer import Odometer

Floats = NDArray[np.float64]

LAG_MAX_S = 60.0
# a lag that leaves less in common than this is not looked at
OVERLAP_MIN_S = 8.0
_STRETCH_MAX_S = 900.0
# motion whose standard deviation is below these is noise
_SPEED_SD_MPS, _TURN_SD_RADPS = 0.4, 0.02
_CORRELATION_MIN = 0.85
# a peak with this share of the highest score explains the motion as well
_AS_GOOD = 0.8
# stretches that tell the same motion with no lag at all; beyond the lag that they still allow,
# a part of the drive that is damaged makes another round fit better
_WINDOW_S, _WINDOWS_MIN, _ALIKE_SHARE, _ALIKE_LAG_S = 10.0, 3, 0.5, 5.0


@dataclass(frozen=True, slots=True)
class Lag:
    """`lag_s` by which the second stream tells the same motion later than the first.

    `correlation` is the largest of speed and turn rate at that lag; `gain` is by how much
    the lag explains the motion better than no lag, in nats over the whole stretch.
    """

    lag_s: float
    correlation: float
    gain: float


def find_lag(
    first: Odometer,
    second: Odometer,
    lag_max_s: float = LAG_MAX_S,
    overlap_min_s: float = OVERLAP_MIN_S,
) -> Lag | None:
    """The lag of the second stream behind the first; None where the motion does not show it."""
    width = max(first.smooth_s, second.smooth_s, 0.5)
    # a grid no finer than the coarser stream: between its samples nothing is known
    step = max(0.1, width / 5.0)
    a, b = _series(first, step, width), _series(second, step, width)
    if a is None or b is None:
        return None
    (start_a, values_a), (start_b, values_b) = a, b
    shift = round((start_b - start_a) / step)
    rest = (start_b - start_a) - shift * step
    lags = np.arange(-round(lag_max_s / step), round(lag_max_s / step) + 1)
    least = max(overlap_min_s, 0.3 * min(len(values_a), len(values_b)) * step) / step
    scores = np.full(len(lags), -np.inf)
    best = np.zeros(len(lags))
    samples = np.zeros(len(lags))
    for row in range(len(lags)):
        # the second stream's sample k tells of the first's sample k + shift - lag
        move = shift - int(lags[row])
        low, high = max(0, move), min(len(values_a), len(values_b) + move)
        if high - low < least:
            continue
        found = _explained(values_a[low:high], values_b[low - move : high - move])
        if found is not None:
            scores[row], best[row] = found
            samples[row] = (high - low) * step / width
    if _mostly_alike(values_a, values_b, shift, round(_WINDOW_S / step)):
        scores[np.abs(lags * step + rest) > _ALIKE_LAG_S] = -np.inf
    if not np.isfinite(scores).any():
        return None
    top = _nearest_peak(scores, lags, samples)
    if best[top] < _CORRELATION_MIN:
        return None
    fine = _peak(scores, top)
    lag_s = float((lags[top] + fine) * step + rest)
    here = scores[np.abs(lags * step + rest) <= step]
    now = float(here.max()) if len(here) and np.isfinite(here).any() else 0.0
    return Lag(lag_s, float(best[top]), float((scores[top] - now) * samples[top]))


def _series(track: Odometer, step: float, width: float) -> tuple[float, Floats] | None:
    """Start and `(n, 2)` speed and turn rate on a grid, of the longest stretch without a gap."""
    gaps = np.flatnonzero(np.diff(track.stamp_s) > track.gap_s)
    firsts = np.concatenate([[0], gaps + 1])
    lasts = np.concatenate([gaps, [len(track) - 1]])
    lengths = track.stamp_s[lasts] - track.stamp_s[firsts]
    longest = int(np.argmax(lengths))
    start, end = track.stamp_s[firsts[longest]], track.stamp_s[lasts[longest]]
    end = min(end, start + _STRETCH_MAX_S)
    count = int((end - start - width) / step)
    if count < 2:
        return None
    middle = start + width / 2.0 + step * np.arange(count)
    way, turn, _ = track.spans(middle - width / 2.0, middle + width / 2.0)
    return float(middle[0]), np.stack([way, turn], axis=1) / width


def _explained(a: Floats, b: Floats, *, every: bool = False) -> tuple[float, float] | None:
    """Nats a sample that the one series tells about the other, and the larger correlation.

    Args:
        every: the smaller correlation instead: speed and turn rate must both agree.
    """
    total, correlations = 0.0, []
    for column, sd in enumerate((_SPEED_SD_MPS, _TURN_SD_RADPS)):
        x, y = a[:, column], b[:, column]
        sx, sy = float(x.std()), float(y.std())
        # the scale of either may be wrong: the motion must show in relation to its own mean too
        if min(sx, sy) <= 0.0 or max(sx, sy) < sd:
            continue
        rho = float(np.mean((x - x.mean()) * (y - y.mean())) / (sx * sy))
        total -= 0.5 * np.log(max(1.0 - rho * rho, 1e-4))
        correlations.append(abs(rho))
    if not correlations:
        return None
    return total, min(correlations) if every else max(correlations)


def _mostly_alike(a: Floats, b: Floats, shift: int, window: int) -> bool:
    """Whether most stretches of a moving car agree with no lag: then no lag of seconds is true."""
    low, high = max(0, shift), min(len(a), len(b) + shift)
    told = alike = 0
    for start in range(low, high - window + 1, window):
        found = _explained(
            a[start : start + window], b[start - shift : start - shift + window], every=True
        )
        if found is not None:
            told += 1
            alike += found[1] > _CORRELATION_MIN
    return told >= _WINDOWS_MIN and alike >= _ALIKE_SHARE * told


def _nearest_peak(scores: Floats, lags: NDArray[np.int64], samples: Floats) -> int:
    """The peak nearest to no lag among those as good as the best: laps repeat after a round."""
    top = int(np.argmax(scores))
    low = np.concatenate([[-np.inf], scores[:-1]])
    high = np.concatenate([scores[1:], [-np.inf]])
    good = (scores >= low) & (scores >= high) & (scores > _AS_GOOD * scores[top])
    rows = np.flatnonzero(good)
    return int(rows[np.argmin(np.abs(lags[rows]))]) if len(rows) else top


def _peak(scores: Floats, top: int) -> float:
    """Place of the summit between the samples, in steps, of a parabola through three of them."""
    if not 0 < top < len(scores) - 1:
        return 0.0
    left, middle, right = scores[top - 1 : top + 2]
    bend = left - 2.0 * middle + right
    if not np.isfinite(bend) or bend >= 0.0:
        return 0.0
    return float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5))
