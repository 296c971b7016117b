"""Drives of points through the particle filter, and how far its poses are off."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from polemap.drivelog.detections import Detections
from polemap.drivelog.samples import GnssFix, OdometrySample, Sample
from polemap.localize.config import LocalizeConfig
from polemap.localize.particle_filter.estimate import PfEstimate
from polemap.localize.particle_filter.filter import ParticleFilter
from polemap.simulate.points.drive import (
    STREWN_CITY,
    WHEELBASE_M,
    PointDrive,
    PointScenario,
    gnss,
    simulate_points,
)
from polemap.vehicle.pose import wrap_angle

SHORT = PointScenario(duration_s=25.0)


def street(duration_s: float = 20.0) -> PointScenario:
    """With poles and GNSS enough to find the first position easily."""
    return replace(
        STREWN_CITY, duration_s=duration_s, poles_per_m2=0.02, gnss=gnss(wander_sd_m=0.7)
    )


def street_drive(seed: int, duration_s: float = 20.0) -> PointDrive:
    """A drive along `street`, with a reader's notes."""
    made = simulate_points(street(duration_s), np.random.default_rng(seed))
    noted = replace(made.drive, notes=("made of points",), problems={"odometry: bad rows": 2})
    return replace(made, drive=noted)


def play(particle_filter: ParticleFilter, samples: Iterable[Sample]) -> list[PfEstimate]:
    estimates = []
    for sample in samples:
        if isinstance(sample, OdometrySample):
            particle_filter.add_odometry(sample)
        elif isinstance(sample, GnssFix):
            particle_filter.add_fix(sample)
        elif isinstance(sample, Detections):
            estimate = particle_filter.process_scan(sample)
            if estimate is not None:
                estimates.append(estimate)
    return estimates


def run(
    drive: PointDrive,
    seed: int = 0,
    config: LocalizeConfig | None = None,
    start: np.ndarray | None = None,
) -> list[PfEstimate]:
    particle_filter = ParticleFilter(
        drive.pole_map, config or LocalizeConfig(), WHEELBASE_M, np.random.default_rng(seed)
    )
    if start is not None:
        particle_filter.set_pose(0.0, start, np.diag([0.25, 0.25, 0.003]))
    return play(particle_filter, drive.samples)


def errors(drive: PointDrive, estimates: list[PfEstimate]) -> np.ndarray:
    """`(n, 3)` along, across, yaw."""
    truth = drive.motion.at(np.array([e.stamp_s for e in estimates]))
    offset = np.array([e.pose for e in estimates]) - truth
    c, s = np.cos(truth[:, 2]), np.sin(truth[:, 2])
    return np.stack(
        [
            c * offset[:, 0] + s * offset[:, 1],
            -s * offset[:, 0] + c * offset[:, 1],
            wrap_angle(offset[:, 2]),
        ],
        axis=1,
    )


def found_after(drive: PointDrive, estimates: list[PfEstimate], since_s: float) -> float:
    """Seconds after `since_s` until the error stays below 1 m and 5 degrees."""
    error = errors(drive, estimates)
    stamp = np.array([e.stamp_s for e in estimates])
    bad = (np.hypot(error[:, 0], error[:, 1]) > 1.0) | (np.abs(error[:, 2]) > 0.09)
    bad &= stamp > since_s
    return float(stamp[bad].max() - since_s) if bad.any() else 0.0
