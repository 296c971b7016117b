"""Lines and corners laid onto scans of poles: what further detectors saw at the same moments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.simulate.config import CornerDetectorConfig, DetectorConfig, LineDetectorConfig
from polemap.simulate.detector import PoleDetector
from polemap.simulate.line_detector import LineDetector
from polemap.simulate.sensors import Motion
from polemap.simulate.street_lines import Corners, StreetTruth
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]


def with_kinds(
    scans: Sequence[Detections],
    motion: Motion,
    truth: StreetTruth,
    view: DetectorConfig,
    lines: LineDetectorConfig | None,
    corners: CornerDetectorConfig | None,
    rng: np.random.Generator,
) -> tuple[Detections, ...]:
    """The scans with what detectors of lines and corners, where there are any, saw as well.

    Args:
        scans: by the clock of `motion`.
        view: of the pole detector, which the one of corners shares.
        rng: all randomness.
    """
    stamps = np.array([scan.stamp_s for scan in scans])
    poses = motion.at(stamps) if len(scans) else np.empty((0, 3))
    out = list(scans)
    if corners is not None:
        seen = _corner_scans(truth.corners, view, corners, stamps, poses, rng)
        out = [_joined(scan, more) for scan, more in zip(out, seen, strict=True)]
    if lines is not None:
        detector = LineDetector(truth.lines, lines, rng)
        out = [
            replace(scan, lines=detector.scan(float(stamp), pose))
            for scan, stamp, pose in zip(out, stamps, poses, strict=True)
        ]
    return tuple(out)


def _corner_scans(
    corners: Corners, view: DetectorConfig, config: CornerDetectorConfig,
    stamps: Floats, poses: Floats, rng: np.random.Generator,
) -> list[Detections]:  # fmt: skip
    like_poles = view.model_copy(
        update={
            "range_max_m": config.range_max_m, "detected_share": config.detected_share,
            "clutter_share": config.clutter_share, "range_sd_per_m2": config.range_sd_per_m2,
            "bearing_sd_rad": config.bearing_sd_rad, "correlated_share": config.correlated_share,
        }
    )  # fmt: skip
    widths = np.zeros(len(corners))
    detector = PoleDetector(corners.points_m, widths, like_poles, rng)
    found = []
    for stamp, pose in zip(stamps, poses, strict=True):
        scan, rows = detector.scan_with_rows(float(stamp), pose)
        facing = corners.facing_rad[rows] - pose[2]
        facing = facing + config.facing_sd_rad * rng.standard_normal(len(rows))
        false = rng.uniform(-np.pi, np.pi, len(scan) - len(rows))
        found.append(
            replace(
                scan,
                kind=np.full(len(scan), LandmarkKind.CORNER, dtype=np.int8),
                width_m=np.full(len(scan), np.nan),
                facing_rad=np.asarray(wrap_angle(np.concatenate([facing, false]))),
            )
        )
    return found


def _joined(scan: Detections, more: Detections) -> Detections:
    return Detections.concatenate([scan, more])
