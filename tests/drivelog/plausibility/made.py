"""A clean drive made of formulas: stop and go, bends to both sides, poles along the way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import pole_detections
from polemap.drivelog.drive import Drive, GnssStream, OdometryStream, ReferenceStream
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.source_names import FOLDER

Floats = NDArray[np.float64]
EAST_M, NORTH_M = 388_500.0, 5_819_500.0


def clean_drive(
    seed: int = 0, duration_s: float = 80.0, pace: float = 1.0, bends: float = 1.0
) -> Drive:
    """A drive in EPSG:32633 with all streams; noise as of a cheap receiver and of good wheels.

    `pace` multiplies the speed (11 m/s at most), `bends` the yaw rate.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration_s, 0.02)
    speed = 8.0 + 3.0 * np.sin(2 * np.pi * t / 31.0) + 1.5 * np.sin(2 * np.pi * t / 12.7 + 1.0)
    speed *= pace
    rate = 0.22 * np.sin(2 * np.pi * t / 23.0) * (np.sin(2 * np.pi * t / 57.0) > -0.2) + 0.02
    rate *= bends
    yaw = 0.3 + np.cumsum(rate) * 0.02
    east = EAST_M + np.cumsum(speed * np.cos(yaw)) * 0.02
    north = NORTH_M + np.cumsum(speed * np.sin(yaw)) * 0.02
    poses = np.column_stack([east, north, (yaw + np.pi) % (2 * np.pi) - np.pi])
    n = len(t)
    k = np.arange(5, n, 25)
    wander = 1.5 * np.column_stack([np.sin(t[k] / 40.0 + seed), np.cos(t[k] / 33.0)])
    fixes = poses[k, :2] + wander + 0.3 * rng.standard_normal((len(k), 2))
    return Drive(
        names=FOLDER,
        name="made",
        path=Path("made"),
        frame=EarthFrame("utm", 32633),
        wheelbase_m=2.7,
        odometry=OdometryStream(
            t,
            t + 0.01,
            1.003 * speed + 0.03 * rng.standard_normal(n),
            rate + 0.002 + 0.003 * rng.standard_normal(n),
        ),
        gnss=GnssStream(t[k], t[k] + 0.2, fixes[:, 0], fixes[:, 1], np.full(len(k), 1.2)),
        reference=ReferenceStream(t, poses, np.full(n, 0.02)),
        scans=_scans(t, poses, rng),
    )


def _scans(t: Floats, poses: Floats, rng: np.random.Generator) -> tuple:
    way = poses[::75]
    side = np.where(np.arange(len(way)) % 2 == 0, 5.0, -6.0)
    poles = np.column_stack(
        [
            way[:, 0] - side * np.sin(way[:, 2]),
            way[:, 1] + side * np.cos(way[:, 2]),
        ]
    ) + rng.standard_normal((len(way), 2))
    scans = []
    for row in range(0, len(t), 10):
        east, north, yaw = poses[row]
        c, s = np.cos(yaw), np.sin(yaw)
        local = (poles - [east, north]) @ np.array([[c, -s], [s, c]])
        seen = local[(local[:, 0] > 4.0) & (np.hypot(*local.T) < 25.0)]
        seen = seen + 0.05 * rng.standard_normal(seen.shape)
        covariance = np.tile(np.diag([0.05**2, 0.05**2]), (len(seen), 1, 1))
        scans.append(
            pole_detections(
                float(t[row]), float(t[row]), seen, covariance, width_m=np.full(len(seen), 0.2)
            )
        )
    return tuple(scans)


def with_odometry(drive: Drive, **columns: Floats) -> Drive:
    assert drive.odometry is not None
    return replace(drive, odometry=replace(drive.odometry, **columns))


def with_gnss(drive: Drive, **columns: Floats) -> Drive:
    assert drive.gnss is not None
    return replace(drive, gnss=replace(drive.gnss, **columns))


def with_reference(drive: Drive, **columns: Floats) -> Drive:
    assert drive.reference is not None
    return replace(drive, reference=replace(drive.reference, **columns))


def late(drive: Drive, stream: str, seconds: float) -> Drive:
    """One stream with stamps that are late."""
    if stream == "poles":
        moved = tuple(
            replace(s, stamp_s=s.stamp_s + seconds, arrival_s=s.arrival_s + seconds)
            for s in drive.scans
        )
        return replace(drive, scans=moved)
    given = getattr(drive, stream)
    changes = {"stamp_s": given.stamp_s + seconds}
    if hasattr(given, "arrival_s"):
        changes["arrival_s"] = given.arrival_s + seconds
    return replace(drive, **{stream: replace(given, **changes)})


def with_points(drive: Drive, change) -> Drive:  # type: ignore[no-untyped-def]
    """The poles of every scan `(n, 2)` changed."""
    scans = tuple(
        replace(s, points_vehicle_m=np.ascontiguousarray(change(s.points_vehicle_m)))
        for s in drive.scans
    )
    return replace(drive, scans=scans)
