"""A drive past poles, at the level of points: for statistics of what stands behind perception."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from polemap.drivelog.drive import Drive
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import PoleScan, VisibleRegion
from polemap.drivelog.streams import GnssStream, OdometryStream, ReferenceStream
from polemap.map.landmark_map import PoleMap
from polemap.simulate.point_drive import PointDrive, PointNoise, point_drive

Floats = NDArray[np.float64]
FRAME = EarthFrame("local", name="street")


@dataclass(frozen=True, slots=True)
class Street:
    """A drive with reference, odometry and GNSS, its map, and what a detector saw on it."""

    drive: Drive
    pole_map: PoleMap
    scans: tuple[PoleScan, ...]
    truth: PointDrive


def pole_street(
    seed: int,
    *,
    duration_s: float = 20.0,
    scan_hz: float = 10.0,
    arrival_s: float = 0.03,
    poles_per_m2: float = 0.008,
    noise: PointNoise | None = None,
    slip_rad_per_mps2: float = 0.007,
) -> Street:
    """Poles at random beside the path, seen with noise, misses and clutter.

    Args:
        seed: of the path, the poles and every noise.
        scan_hz: rate of the detector, from half a second after the start.
        arrival_s: from a scan's stamp to its arrival.
        poles_per_m2: density over the whole surroundings; a strip of 3.5 m is free of them.
        noise: of odometry and GNSS.
        slip_rad_per_mps2: outward slip of the rear axle per lateral acceleration.
    """
    rng = np.random.default_rng(seed)
    truth = point_drive(
        rng,
        duration_s=duration_s,
        pose_hz=scan_hz,
        noise=noise,
        slip_rad_per_mps2=slip_rad_per_mps2,
    )
    low = truth.states[:, :2].min(axis=0) - 40
    high = truth.states[:, :2].max(axis=0) + 40
    points = rng.uniform(low, high, (int(np.prod(high - low) * poles_per_m2), 2))
    points = points[KDTree(truth.states[::50, :2]).query(points)[0] > 3.5]
    width = rng.uniform(0.1, 0.4, len(points))
    scans = tuple(
        _scan(rng, float(stamp), arrival_s, truth.truth(np.array([stamp]))[0], points, width)
        for stamp in np.arange(0.5, duration_s, 1.0 / scan_hz)
    )
    odometry, fixes = truth.odometry, truth.gnss
    drive = Drive(
        name="street",
        path=Path("street"),
        frame=FRAME,
        wheelbase_m=2.7,
        odometry=OdometryStream(
            np.array([o.stamp_s for o in odometry]),
            np.array([o.arrival_s for o in odometry]),
            np.array([o.speed_mps for o in odometry]),
            np.array([o.yaw_rate_radps for o in odometry]),
        ),
        gnss=GnssStream(
            np.array([fix.stamp_s for fix in fixes]),
            np.array([fix.arrival_s for fix in fixes]),
            np.array([fix.east_m for fix in fixes]),
            np.array([fix.north_m for fix in fixes]),
            np.array([fix.hdop for fix in fixes]),
        ),
        reference=ReferenceStream(
            truth.stamps_s[::25], truth.states[::25, :3], np.full(len(truth.stamps_s[::25]), 0.01)
        ),
        notes=("made of points",),
        problems={"odometry: bad rows": 2},
    )
    n = len(points)
    pole_map = PoleMap(
        frame=FRAME,
        ids=np.arange(n),
        points_m=points + rng.normal(0.0, 0.04, points.shape),
        covariance_m2=np.tile(np.eye(2) * 0.04**2, (n, 1, 1)),
        width_m=width,
        height_m=np.full(n, np.nan),
        observations=np.full(n, 10),
        drives=np.full(n, 1),
        existence=np.ones(n),
    )
    return Street(drive, pole_map, scans, truth)


def _scan(
    rng: np.random.Generator,
    stamp: float,
    arrival_s: float,
    state: Floats,
    points: Floats,
    width: Floats,
) -> PoleScan:
    view = VisibleRegion(np.zeros(2), -0.6, 0.6, 3.0, np.array([25.0]))
    c, s = np.cos(state[2]), np.sin(state[2])
    local = (points - state[:2]) @ np.array([[c, -s], [s, c]])
    seen = view.contains(local) & (rng.random(len(points)) < 0.85)
    sd = 0.05
    found = local[seen] + rng.normal(0.0, sd, (int(seen.sum()), 2))
    clutter = rng.uniform([5.0, -8.0], [22.0, 8.0], (rng.poisson(0.2), 2))
    every = np.vstack([found, clutter])
    n = len(every)
    return PoleScan(
        stamp,
        stamp + arrival_s,
        every,
        np.tile(np.eye(2) * sd**2, (n, 1, 1)),
        np.concatenate([width[seen], np.full(len(clutter), 0.2)]),
        np.full(n, -1),
        np.full(n, 0.9),
        view=view,
    )
