"""What single columns say: how late rows arrive, stated accuracies, files of a row or two, laps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive, Lap
from polemap.drivelog.findings import Finding

Floats = NDArray[np.float64]

# the output filter takes in what comes a second late; more than ten is no delay of a sensor
_LATE_DOUBT_S, _LATE_WRONG_S = 1.0, 10.0
_BEFORE_SHARE = 0.05
_SD_DOUBT_M, _SD_SHARE = 5.0, 0.05
_FEW_ROWS, _FEW_WITHIN_S = 2, 10.0
_LAP_INSIDE, _LAP_MARGIN_S = 0.5, 5.0
_TICKS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}


def row_findings(drive: Drive) -> list[Finding]:
    """All of them."""
    return [*_arrivals(drive), *_accuracy(drive), *_no_fixes(drive), *_few(drive), *_laps(drive)]


def _streams(drive: Drive) -> dict[str, tuple[Floats, Floats]]:
    """Stamps and arrivals by the stream's role, of those that hold any."""
    poles = [scan for scan in drive.scans if len(scan)]
    streams = {
        "poles": (
            np.array([scan.stamp_s for scan in poles]),
            np.array([scan.arrival_s for scan in poles]),
        ),
        "frames": (drive.frame_stamps_s, drive.frame_arrivals_s),
    }
    measured = {"odometry": drive.odometry, "gnss": drive.gnss}
    told = {role: (s.stamp_s, s.arrival_s) for role, s in measured.items() if s is not None}
    return {role: pair for role, pair in (told | streams).items() if len(pair[0])}


def _arrivals(drive: Drive) -> list[Finding]:
    found = []
    for role, (stamps, arrivals) in _streams(drive).items():
        name = getattr(drive.names, role)
        late = float(np.median(arrivals - stamps))
        if late >= _LATE_DOUBT_S:
            found.append(
                Finding(
                    "arrival", "error" if late >= _LATE_WRONG_S else "warning", name,
                    f"rows arrive {late:.4g} s after their stamp in the median",
                    f"within {_LATE_DOUBT_S:g} s", "write arrivals by the clock of the stamps, "
                    "or leave them out",
                )
            )  # fmt: skip
        before = drive.problems.get(f"{role}_arrival_before_stamp", 0)
        if before > _BEFORE_SHARE * len(stamps):
            found.append(
                Finding(
                    "arrival", "warning", name,
                    f"{before} of {len(stamps)} rows arrive before their stamp",
                    "an arrival after it",
                    "taken as arriving at once; write arrivals by the clock of the stamps",
                )
            )  # fmt: skip
    return found


def _accuracy(drive: Drive) -> list[Finding]:
    """Standard deviations of the reference."""
    reference = drive.reference
    if reference is None or not len(reference):
        return []
    wrong = drive.problems.get("reference_sd_not_positive", 0)
    if wrong > _SD_SHARE * len(reference):
        return [
            Finding(
                "reference_sd", "warning", drive.names.reference,
                f"sd_m is not above 0 in {wrong} of {len(reference)} rows", "metres above 0",
                "taken as not stated; leave the cells empty where the accuracy is not known",
            )
        ]  # fmt: skip
    known = reference.sd_m[np.isfinite(reference.sd_m)]
    if len(known) and float(np.median(known)) > _SD_DOUBT_M:
        return [
            Finding(
                "reference_sd", "warning", drive.names.reference,
                f"sd_m is {np.median(known):.4g} in the median", f"below {_SD_DOUBT_M:g} m",
                "write a standard deviation in metres, or do not map with this reference",
            )
        ]  # fmt: skip
    return []


def _no_fixes(drive: Drive) -> list[Finding]:
    names = drive.names
    told = {
        "gnss_no_fix": (drive.problems.get("gnss_at_zero", 0), names.gnss),
        "reference_no_pose": (drive.problems.get("reference_at_zero", 0), names.reference),
    }
    found = [
        Finding(
            kind, "warning", name, f"{count} rows at 0, 0, far from the others (left out)",
            "rows with a fix alone", "leave the rows out in which the receiver had no fix",
        )
        for kind, (count, name) in told.items()
        if count
    ]  # fmt: skip
    repeated = drive.problems.get("gnss_old_fix_repeated", 0)
    if repeated:
        found.append(
            Finding(
                "gnss_repeated", "warning", names.gnss,
                f"{repeated} rows repeat an old fix between others far from it (left out)",
                "fixes that move with the car", "leave rows out that repeat an old fix",
            )
        )  # fmt: skip
    return found


def _few(drive: Drive) -> list[Finding]:
    """Streams that hardly hold a row while the drive goes on."""
    streams = {role: stamps for role, (stamps, _) in _streams(drive).items()}
    if drive.reference is not None:
        streams["reference"] = drive.reference.stamp_s
    longest = max((s[-1] - s[0] for s in streams.values() if len(s)), default=0.0)
    if longest < _FEW_WITHIN_S:
        return []
    return [
        Finding(
            "few_rows", "warning", getattr(drive.names, role),
            f"{len(stamps)} row{'s' if len(stamps) > 1 else ''}",
            f"rows over the drive's {longest:.0f} s", "check that it is whole, or remove it",
        )
        for role, stamps in streams.items()
        if 0 < len(stamps) <= _FEW_ROWS
    ]  # fmt: skip


def _laps(drive: Drive) -> list[Finding]:
    """Laps that lie outside the drive, by half or more."""
    start, end = drive.span_s
    outside = [lap for lap in drive.laps if _inside_s(lap, start, end) < _least_s(lap)]
    if not outside or not np.isfinite(start):
        return []
    last = max(lap.end_s for lap in drive.laps)
    unit = next((name for k, name in _TICKS.items() if 0.7 < last / k / end < 1.3), None)
    # a lap to the end may end anywhere after it
    severe = unit is not None or all(_inside_s(lap, start, end) <= 0.0 for lap in drive.laps)
    return [
        Finding(
            "laps", "error" if severe else "warning", drive.names.laps,
            f"lap '{outside[0].name[:30]}' lasts from {outside[0].start_s:.3f} to "
            f"{outside[0].end_s:.3f} s" + (f" (as if in {unit})" if unit else ""),
            f"laps within {start:.3f} to {end:.3f} s",
            "write its times in seconds, by the drive's clock",
        )
    ]  # fmt: skip


def _inside_s(lap: Lap, start: float, end: float) -> float:
    return min(lap.end_s, end) - max(lap.start_s, start)


def _least_s(lap: Lap) -> float:
    length = lap.end_s - lap.start_s
    return max(min(_LAP_INSIDE * length, length - _LAP_MARGIN_S), 1e-9)
