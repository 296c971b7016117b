"""Faults of a detector: what its scans say, or when they say it, is wrong for a while."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.campaign.drives import Case, street
from polemap.drivelog.detections import Detections
from polemap.vehicle.pose import rotate_back, rotation, wrap_angle


@dataclass(frozen=True, slots=True)
class Faulty:
    """A case with its fault in it, from `from_s` until `until_s` (infinite where it lasts)."""

    case: Case
    from_s: float = 0.0
    until_s: float = np.inf


Kind = Callable[[int], Faulty]
# of a picture's direction of motion, as on KITTI 03
_COURSE_SD_RAD = 0.002


def scans_changed(
    change: Callable[[Detections], Detections], seconds: float = np.inf, start_s: float = 18.0
) -> Kind:
    """A detector that reports something else for a while."""

    def kind(seed: int) -> Faulty:
        case, until_s = street(seed), start_s + seconds
        scans = tuple(
            change(s) if start_s <= s.stamp_s < until_s and len(s) else s for s in case.scans
        )
        return Faulty(replace(case, scans=scans), start_s, until_s)

    return kind


def mirrored(scan: Detections) -> Detections:
    """Left and right exchanged."""
    flip = np.array([1.0, -1.0])
    return scan.with_columns(
        points_vehicle_m=scan.points_vehicle_m * flip,
        covariance_m2=scan.covariance_m2 * np.outer(flip, flip),
    )


def ranges_times(factor: float) -> Callable[[Detections], Detections]:
    """A baseline or a unit that is wrong: every pole is too near, or too far."""
    return lambda scan: scan.with_columns(
        points_vehicle_m=scan.points_vehicle_m * factor,
        covariance_m2=scan.covariance_m2 * factor**2,
    )


def frozen_scans(seconds: float) -> Kind:
    """The detector repeats one scan under new stamps."""

    def kind(seed: int) -> Faulty:
        case = street(seed)
        first = next(s for s in case.scans if s.stamp_s >= 18.0 and len(s))
        scans = tuple(
            replace(first, stamp_s=s.stamp_s, arrival_s=s.arrival_s)
            if 18.0 <= s.stamp_s < 18.0 + seconds
            else s
            for s in case.scans
        )
        return Faulty(replace(case, scans=scans), 18.0, 18.0 + seconds)

    return kind


def scans_at_another_time(by_s: float, seconds: float) -> Kind:
    """The detector's clock jumps: stamps are off for a while, arrivals are not."""

    def kind(seed: int) -> Faulty:
        case, start = street(seed), 18.0
        scans = tuple(
            replace(s, stamp_s=s.stamp_s + by_s) if start <= s.stamp_s < start + seconds else s
            for s in case.scans
        )
        return Faulty(replace(case, scans=scans), start, start + seconds)

    return kind


def turned(by_rad: float) -> Callable[[Detections], Detections]:
    """A detector whose mounting has turned."""
    turn = rotation(by_rad)
    return lambda scan: scan.with_columns(
        points_vehicle_m=scan.points_vehicle_m @ turn.T,
        covariance_m2=turn @ scan.covariance_m2 @ turn.T,
    )


def with_course(kind: Kind, by_rad: float = 0.0) -> Kind:
    """A kind whose odometry is that of the detector's own camera, which sees its course, turned."""

    def course_kind(seed: int) -> Faulty:
        faulty = kind(seed)
        drive = faulty.case.drive
        odometry, reference = drive.odometry, drive.reference
        assert odometry is not None
        assert reference is not None
        before, after = (reference.at(odometry.stamp_s + by_s) for by_s in (-0.05, 0.05))
        moved = rotate_back(
            after[:, :2] - before[:, :2],
            before[:, 2] + 0.5 * wrap_angle(after[:, 2] - before[:, 2]),
        )
        slip = np.arctan2(moved[:, 1], np.maximum(moved[:, 0], 1e-3))
        noise = _COURSE_SD_RAD * np.random.default_rng([seed, 79]).standard_normal(len(slip))
        lateral = odometry.speed_mps * np.tan(slip + noise + by_rad)
        odometry = replace(odometry, lateral_mps=lateral)
        return replace(faulty, case=replace(faulty.case, drive=replace(drive, odometry=odometry)))

    return course_kind
