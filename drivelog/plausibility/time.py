"""Time: rates that no recorder has, clocks that have nothing in common, streams late or early."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.clocks import Lag, find_lag
from polemap.drivelog.plausibility.odometer import Odometer

Floats = NDArray[np.float64]

# a lag counts when it explains the motion better by this many nats over the stretch
_GAIN_MIN = 6.0
# clean drives: within 0.08 s of odometry against reference, 0.26 s against fixes
_LAG_DOUBT_S, _LAG_WRONG_S = 0.15, 0.6
_GNSS_LAG_DOUBT_S, _GNSS_LAG_WRONG_S = 0.6, 3.0
_STEP_MAX_S = 1.0
_PACE_MAX_MPS = 100.0
_GAP_S = 2.0
_SHARED_MIN = 0.3
_TICKS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}


def stamps_of(drive: Drive) -> dict[str, Floats]:
    """Stamps by the stream's name, of the streams that hold any."""
    streams = {
        drive.names.odometry: drive.odometry.stamp_s if drive.odometry is not None else np.empty(0),
        drive.names.gnss: drive.gnss.stamp_s if drive.gnss is not None else np.empty(0),
        drive.names.reference: drive.reference.stamp_s
        if drive.reference is not None
        else np.empty(0),
        drive.names.poles: np.array(
            [scan.stamp_s for scan in drive.scans if len(scan) or not _holds_lines(scan)]
        ),
        drive.names.lines: np.array([scan.stamp_s for scan in drive.scans if _holds_lines(scan)]),
        drive.names.frames: drive.frame_stamps_s,
    }
    return {name: stamps for name, stamps in streams.items() if len(stamps)}


def _holds_lines(scan: Detections) -> bool:
    return scan.lines is not None and len(scan.lines) > 0


def rate_findings(drive: Drive) -> list[Finding]:
    """Odometry too slow or too fast to be in seconds."""
    found = []
    for name, stamps in stamps_of(drive).items():
        if len(stamps) < 10:
            continue
        step = float(np.median(np.diff(stamps)))
        if name == drive.names.odometry and not 1e-4 <= step <= _STEP_MAX_S:
            found.append(
                Finding(
                    "stamp_unit", "error", name, f"a row every {step:.4g} s",
                    f"every 0.0001 to {_STEP_MAX_S:g} s", "write stamps in seconds",
                )
            )  # fmt: skip
    return found or _pace_findings(drive)


def _pace_findings(drive: Drive) -> list[Finding]:
    """Poses that go faster than cars do, by stamps of minutes or hours."""
    reference = drive.reference
    if reference is None or len(reference) < 10:
        return []
    steps = np.diff(reference.poses[:, :2], axis=0)
    moving = np.hypot(steps[:, 0], steps[:, 1]) > 0.0
    if moving.sum() < 10:
        return []
    pace = np.hypot(steps[:, 0], steps[:, 1]) / np.maximum(np.diff(reference.stamp_s), 1e-9)
    median = float(np.median(pace[moving]))
    if median < _PACE_MAX_MPS:
        return []
    return [
        Finding(
            "stamp_unit", "error", drive.names.reference,
            f"its positions go at {median:.0f} m/s in the median", f"below {_PACE_MAX_MPS:g} m/s",
            "write stamps in seconds (not minutes or hours) and positions in metres",
        )
    ]  # fmt: skip


def overlap_findings(drive: Drive) -> list[Finding]:
    """Streams that share little time with the others: another clock, epoch or unit."""
    stamps = {name: s for name, s in stamps_of(drive).items() if len(s) > 1}
    if len(stamps) < 2:
        return []
    shared = {(a, b): _share(stamps[a], stamps[b]) for a in stamps for b in stamps if a != b}
    # the clock that most streams are on is taken as the right one; the odometry decides a tie
    agree = {
        a: sum(min(shared[a, b], shared[b, a]) > _SHARED_MIN for b in stamps if b != a)
        for a in stamps
    }
    base = max(stamps, key=lambda name: (agree[name], name == drive.names.odometry))
    found = []
    for name, own in stamps.items():
        if name == base or shared[name, base] > _SHARED_MIN:
            continue
        ratio = (own[-1] - own[0]) / max(stamps[base][-1] - stamps[base][0], 1e-9)
        unit = next((u for k, u in _TICKS.items() if 0.8 < ratio / k < 1.25), None)
        found.append(
            Finding(
                "stamp_unit" if unit else "clock_apart", "error", name,
                f"its stamps {own[0]:.3f} to {own[-1]:.3f} share {100 * shared[name, base]:.0f} % "
                f"of their rows with {base}" + (f"; they are {unit}" if unit else ""),
                f"{stamps[base][0]:.3f} to {stamps[base][-1]:.3f} s",
                "write stamps in seconds" if unit else "write all streams by one clock, in "
                f"seconds (they start {own[0] - stamps[base][0]:.3f} s apart)",
            )
        )  # fmt: skip
    return found


def _share(own: Floats, other: Floats) -> float:
    """Share of the stamps that lie within the other's span, give or take a second."""
    return float(np.mean((own >= other[0] - 1.0) & (own <= other[-1] + 1.0)))


def gap_findings(drive: Drive) -> list[Finding]:
    """Holes in the odometry that dead reckoning cannot bridge."""
    odometry = drive.odometry
    if odometry is None or len(odometry) < 3:
        return []
    step = np.diff(odometry.stamp_s)
    gaps = np.flatnonzero(step > _GAP_S)
    if not len(gaps):
        return []
    largest = int(gaps[np.argmax(step[gaps])])
    return [
        Finding(
            "gap", "note", drive.names.odometry,
            f"{len(gaps)} gaps over {_GAP_S:.0f} s, the longest {step[largest]:.1f} s from "
            f"{odometry.stamp_s[largest]:.3f} s", "rows without gaps",
            "the pose is not trusted there; cut the recording into drives at long gaps",
        )
    ]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Offset:
    """`late` tells the motion `late_s` after `against` does."""

    late: Odometer
    against: Odometer
    late_s: float
    correlation: float
    wrong_s: float

    def finding(self) -> Finding:
        """As it is reported."""
        size, late = abs(self.late_s), self.late_s > 0.0
        return Finding(
            "clock_offset", "error" if size > self.wrong_s else "warning", self.late.name,
            f"it tells the same motion {size:.2f} s {'late' if late else 'early'} against "
            f"{self.against.name} (correlation {self.correlation:.2f})", "the same clock",
            f"{'subtract' if late else 'add'} {size:.2f} s {'from' if late else 'to'} its stamps",
        )  # fmt: skip


def find_offset(
    odometry: Odometer | None,
    reference: Odometer | None,
    gnss: Odometer | None,
    suspects: Callable[[Odometer, Odometer], Odometer],
) -> Offset | None:
    """The stream that is late or early, if one is; of three the one the others contradict.

    Args:
        suspects: which of odometry and reference is off, where the fixes cannot tell.
    """
    tracks = (odometry, reference, gnss)
    lags = {
        (i, k): (find_lag(a, b), gnss is a or gnss is b)
        for i, a in enumerate(tracks)
        for k, b in enumerate(tracks)
        if i < k and a is not None and b is not None
    }
    off = {pair: lag for pair, (lag, noisy) in lags.items() if lag and _clear(lag, noisy)}
    if not off:
        return None
    pair = (0, 1) if (0, 1) in off else max(off, key=lambda key: off[key].gain)
    first, second = tracks[pair[0]], tracks[pair[1]]
    if first is None or second is None:
        return None
    lag = off[pair]
    if pair == (0, 1):
        by_fixes = [k for k in (0, 1) if (k, 2) in off]
        blamed = tracks[by_fixes[0]] if len(by_fixes) == 1 else suspects(first, second)
    else:
        blamed = gnss
    late_s = lag.lag_s if blamed is second else -lag.lag_s
    noisy = 2 in pair
    return Offset(
        second if blamed is second else first,
        first if blamed is second else second,
        late_s,
        lag.correlation,
        _GNSS_LAG_WRONG_S if noisy else _LAG_WRONG_S,
    )


def shifted(track: Odometer | None, offset: Offset | None) -> Odometer | None:
    """The track with its offset taken away, if it is the one that is off."""
    if track is None or offset is None or offset.late is not track:
        return track
    return replace(track, stamp_s=track.stamp_s - offset.late_s)


def _clear(lag: Lag, noisy: bool) -> bool:
    doubt = _GNSS_LAG_DOUBT_S if noisy else _LAG_DOUBT_S
    return abs(lag.lag_s) > doubt and lag.gain > _GAIN_MIN
