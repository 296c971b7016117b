"""The repeatability of a trajectory over several passes: how well it lies where it lay before.

Definition (docs/repeatability.md): at the stations k of the mean path, pass l has the lateral
deviation d_lk; with L_k passes at station k,

    s^2 = sum_k sum_l (d_lk - mean_l d_lk)^2 / sum_k (L_k - 1).

Source: S16 section V.B uses the standard deviation over laps without stating its estimator; the
division by L_k - 1, the interval and the small-sample factor are this project's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, lgamma, sqrt

import numpy as np
from numpy.typing import NDArray

from polemap.evaluation.laps import Stretch
from polemap.evaluation.meanpath import MeanPath
from polemap.vehicle.kalman import chi_square_quantile
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

MAX_CARRY_M = 2.0
MARGIN_S = 2.0
LEVEL = 0.95
_PLAUSIBLE_TURN_RAD = np.radians(45.0)
_USUAL_TURN_RAD = np.radians(10.0)


@dataclass(frozen=True, slots=True)
class Deviations:
    """Lateral deviations `(passes, stations)` in metres of one system on one stretch.

    NaN where a pass was not there, was further than the reach of the path, or is excluded.
    """

    stretch: Stretch
    lateral_m: Floats

    @property
    def counted(self) -> NDArray[np.int64]:
        """Passes at every station."""
        return np.asarray(np.isfinite(self.lateral_m).sum(axis=0))

    def centred(self) -> Floats:
        """Deviations from the mean over the passes of the same station; NaN with fewer than two."""
        known = np.isfinite(self.lateral_m)
        count = known.sum(axis=0)
        total = np.where(known, self.lateral_m, 0.0).sum(axis=0)
        mean = np.divide(total, count, out=np.full(len(count), np.nan), where=count >= 2)
        return np.asarray(self.lateral_m - mean)

    def masked(self, excluded: NDArray[np.bool_]) -> Deviations:
        """The same with the entries of `excluded` `(passes, stations)` left out."""
        return Deviations(self.stretch, np.where(excluded, np.nan, self.lateral_m))


@dataclass(frozen=True, slots=True)
class Repeatability:
    """A repeatability with what is needed to judge it.

    Attributes:
        sd_m: the figure; NaN without a station with two passes.
        low_m, high_m: 95 % confidence interval of the standard deviation behind it.
        unbiased_m: the figure divided by c4(freedom), free of the bias of a root of few values.
        population_m: the same sum divided by the passes instead of passes - 1, for comparison
            with work that divides so.
        freedom: effective degrees of freedom.
        stations: stations with at least two passes.
        share: of the stations of the route.
    """

    sd_m: float
    low_m: float
    high_m: float
    unbiased_m: float
    population_m: float
    freedom: float
    stations: int
    share: float


@dataclass(frozen=True, slots=True)
class Guide:
    """Roughly where on the path one pass was at which time: `(m,)` each."""

    stamp_s: Floats
    station_m: Floats


def guides_of(stretch: Stretch, tracks: Sequence[Trajectory]) -> list[Guide]:
    """A guide for every pass, from the trajectories `(one a recording)` that found the passes."""
    return [
        Guide(*stretch.path.track(tracks[s.source].between(s.start_s, s.end_s), float(start_m)))
        for s, start_m in zip(stretch.passes, stretch.starts_m, strict=True)
    ]


def deviations(
    stretch: Stretch, tracks: Sequence[Trajectory], guides: Sequence[Guide]
) -> Deviations:
    """Lateral deviations of every pass at every station of the mean path.

    Args:
        tracks: the system's trajectory, one a recording, on the clocks of the guides.
        guides: of `guides_of`; only the fine search remains to be done.
    """
    rows = np.full((len(stretch.passes), len(stretch.path.station_m)), np.nan)
    for row, crossing in enumerate(crossings(stretch, tracks, guides)):
        rows[row, crossing.stations] = crossing.lateral_m
    return Deviations(stretch, rows)


@dataclass(frozen=True, slots=True)
class Crossing:
    """Where one pass crosses the stations: `(m,)` each, for the stations that it reaches."""

    stations: NDArray[np.int64]
    lateral_m: Floats
    turn_rad: Floats
    stamp_s: Floats


def crossings(
    stretch: Stretch, tracks: Sequence[Trajectory], guides: Sequence[Guide]
) -> list[Crossing]:
    """Every pass of `stretch` at the stations of its path; see `deviations`."""
    found = []
    for span, guide in zip(stretch.passes, guides, strict=True):
        part = tracks[span.source].between(span.start_s - MARGIN_S, span.end_s + MARGIN_S)
        if len(guide.stamp_s) < 2 or len(part) == 0:
            nothing = np.empty(0)
            found.append(Crossing(np.empty(0, dtype=np.int64), nothing, nothing, nothing))
            continue
        rough = np.interp(part.stamp_s, guide.stamp_s, guide.station_m)
        found.append(cross(stretch.path, part, rough))
    return found


def cross(path: MeanPath, part: Trajectory, guess_m: Floats) -> Crossing:
    """One pass at the stations: the nearest pose, carried along its own heading.

    Interpolating between poses would average their noise and flatter a jittering system; the
    nearest pose keeps it, and its heading takes it the last half step to the station.
    """
    station, deviation = path.project(part.poses[:, :2], guess_m)
    turn = wrap_angle(part.poses[:, 2] - path.heading_rad(np.nan_to_num(station)))
    good = np.flatnonzero(np.isfinite(station))
    order = good[np.argsort(station[good], kind="stable")]
    station, deviation, turn = station[order], deviation[order], turn[order]
    if len(station) == 0:
        return Crossing(np.empty(0, dtype=np.int64), station, station, station)
    right = np.clip(np.searchsorted(station, path.station_m), 0, len(station) - 1)
    left = np.maximum(right - 1, 0)
    take_left = np.abs(path.station_m - station[left]) <= np.abs(station[right] - path.station_m)
    nearest = np.where(take_left, left, right)
    carry = path.station_m - station[nearest]
    spacing = float(np.median(np.diff(station))) if len(station) > 1 else 0.0
    reached = np.flatnonzero(np.abs(carry) <= max(MAX_CARRY_M, 0.75 * spacing))
    nearest, carry = nearest[reached], carry[reached]
    return Crossing(
        reached,
        deviation[nearest] + _slopes(turn)[nearest] * carry,
        turn[nearest],
        part.stamp_s[order][nearest],
    )


def _slopes(turn_rad: Floats) -> Floats:
    """Change of the deviation per metre of station, from the headings relative to the path.

    Zero where the poses carry no usable heading (some systems publish the identity).
    """
    plausible = np.abs(turn_rad) < _PLAUSIBLE_TURN_RAD
    if plausible.mean() < 0.9 or np.median(np.abs(turn_rad)) > _USUAL_TURN_RAD:
        return np.zeros(len(turn_rad))
    return np.where(plausible, np.tan(np.where(plausible, turn_rad, 0.0)), 0.0)


def repeatability(parts: Sequence[Deviations]) -> Repeatability:
    """The repeatability over all stretches of a route.

    The interval is that of a chi-square variable with the effective degrees of freedom of
    `effective_freedom`, which takes the correlation along the road into account.
    """
    centred = [part.centred() for part in parts]
    total = sum(float(np.nansum(one**2)) for one in centred)
    count = [np.isfinite(one).sum(axis=0) for one in centred]
    freedom_sum = sum(int(np.maximum(c - 1, 0).sum()) for c in count)
    stations = sum(int((c >= 2).sum()) for c in count)
    everything = sum(part.lateral_m.shape[1] for part in parts)
    if freedom_sum == 0:
        nan = float("nan")
        return Repeatability(nan, nan, nan, nan, nan, 0.0, 0, 0.0)
    values = sum(int(c[c >= 2].sum()) for c in count)
    sd = sqrt(total / freedom_sum)
    freedom = effective_freedom(centred)
    return Repeatability(
        sd_m=sd,
        low_m=sd * sqrt(freedom / chi_square_quantile(0.5 + LEVEL / 2, freedom)),
        high_m=sd * sqrt(freedom / chi_square_quantile(0.5 - LEVEL / 2, freedom)),
        unbiased_m=sd / small_sample_factor(freedom),
        population_m=sqrt(total / values),
        freedom=freedom,
        stations=stations,
        share=stations / everything,
    )


def effective_freedom(centred: Sequence[Floats]) -> float:
    """Degrees of freedom of the pooled variance of correlated deviations.

    For Gaussian passes, independent of one another, with covariance C between stations, the
    pooled variance has the variance 2 tr(C^2) / (n K^2), n = L - 1 (Satterthwaite). tr(C^2) and
    (tr C)^2 are estimated without bias from the Gram matrix of the passes. No correlation length
    has to be chosen: passes shifted as a whole give n, white noise gives n K. Stretches count as
    independent of one another.

    Args:
        centred: `(passes, stations)` a stretch, NaN where a pass does not count.
    """
    mean, variance = 0.0, 0.0
    for one in centred:
        known = np.isfinite(one)
        stations = int((known.sum(axis=0) >= 2).sum())
        if stations == 0:
            continue
        values = np.where(known, one, 0.0)
        count = known.sum(axis=0)
        n = float((count[count >= 2] - 1).mean())
        gram = values @ values.T
        trace = float(np.trace(gram)) / n
        mean += n * trace
        variance += n * n * _variance_of_trace(gram, trace, n, values)
    if variance <= 0.0 or mean <= 0.0:
        return float(max((c.shape[0] - 1 for c in centred), default=1))
    # mean^2 exceeds the square of the expected value by just that variance.
    return max(2.0 * mean * mean / variance - 2.0, 1.0)


def _variance_of_trace(gram: Floats, trace: float, n: float, values: Floats) -> float:
    """Variance of the trace of the sample covariance with `n` degrees of freedom: 2 tr(C^2) / n.

    Source of the unbiased tr(C^2): M. S. Srivastava, "Some tests concerning the covariance matrix
    in high dimensional data", J. Japan Statist. Soc. 35 (2005).
    """
    white = trace * trace / values.shape[1]
    if n < 1.5:
        correlated = _squared_correlation(values)
        return float(2.0 * correlated * trace * trace / (1.0 + 2.0 * correlated))
    squared = float(np.sum(gram * gram)) / (n * n)
    trace_of_square = n * n / ((n - 1.0) * (n + 2.0)) * (squared - trace * trace / n)
    return float(2.0 * max(trace_of_square, white) / n)


def _squared_correlation(values: Floats) -> float:
    """tr(C^2) / (tr C)^2 from the autocorrelation along the road: all that two passes give."""
    stations = values.shape[1]
    size = 2 * stations
    spectrum = np.abs(np.fft.rfft(values, size, axis=1)) ** 2
    covariance = np.fft.irfft(spectrum.sum(axis=0), size)[:stations]
    correlation = covariance / covariance[0] * stations / (stations - np.arange(stations))
    below = np.flatnonzero(correlation <= 0.0)
    end = int(below[0]) if len(below) else stations
    lag = np.arange(1, end)
    pairs = stations + 2.0 * float(
        np.sum((stations - lag) * np.clip(correlation[1:end], -1, 1) ** 2)
    )
    return float(pairs / stations**2)


def small_sample_factor(freedom: float) -> float:
    """c4: the mean of a sample standard deviation over the true one; 0.798 for one degree."""
    half = freedom / 2.0
    if half > 1e6:
        return 1.0
    return sqrt(2.0 / freedom) * exp(lgamma(half + 0.5) - lgamma(half))
