"""Recovery and consistency of the particle filter on drives of points, case by case.

`python -m benchmarks.localize.particle_filter_recovery [SEEDS or FIRST:LAST] [CASE,CASE...]`
prints the table of docs/particle_filter.md. Not timed, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.samples import GnssFix, OdometrySample, Sample
from polemap.localize.config import LocalizeConfig
from polemap.localize.particle_filter.estimate import PfEstimate
from polemap.localize.particle_filter.filter import ParticleFilter
from polemap.simulate.config import DetectorConfig
from polemap.simulate.points.drive import WHEELBASE_M, PointDrive, PointScenario, simulate_points
from polemap.simulate.points.motion import WindingRoad
from polemap.vehicle.pose import rotate_back, wrap_angle

Floats = NDArray[np.float64]

_BASE = PointScenario(duration_s=40.0)
_POOR = DetectorConfig(clutter_share=0.3, detected_share=0.6)
A_THIRD_OF_THE_NOISE = {
    name: value / 3.0 for name, value in LocalizeConfig() if name.startswith("alpha")
}


@dataclass(frozen=True, slots=True)
class Case:
    """A scenario, what differs in the settings, a believed start, and when the trouble begins."""

    scenario: PointScenario = _BASE
    settings: dict[str, Any] = field(default_factory=dict)
    start_offset: tuple[float, float, float] | None = None
    since_s: float = 5.0


CASES = {
    "plain": Case(),
    "kidnapped_50m": Case(replace(_BASE, kidnap_s=15.0), since_s=15.0),
    "start_50m_off": Case(start_offset=(30.0, 40.0, 0.0), since_s=0.0),
    "start_turned_180": Case(start_offset=(0.0, 0.0, np.pi), since_s=0.0),
    "start_50m_and_180": Case(start_offset=(30.0, 40.0, np.pi), since_s=0.0),
    "start_50m_and_180_no_gnss": Case(
        replace(_BASE, gnss=None), start_offset=(30.0, 40.0, np.pi), since_s=0.0
    ),
    "kidnapped_no_gnss": Case(
        replace(_BASE, kidnap_s=15.0, gnss_outage_s=(10.0, np.inf)), since_s=15.0
    ),
    "gnss_outage_60s": Case(
        replace(_BASE, duration_s=90.0, gnss_outage_s=(10.0, 70.0)), since_s=10.0
    ),
    "standing_10s_few_poles": Case(
        replace(_BASE, duration_s=50.0, motion=WindingRoad(standstill_s=10.0), pole_spacing_m=12.0),
        since_s=10.0,
    ),
    "clutter_30": Case(replace(_BASE, detector=DetectorConfig(clutter_share=0.3))),
    "missed_40": Case(replace(_BASE, detector=DetectorConfig(detected_share=0.6))),
    "clutter_30_missed_40": Case(replace(_BASE, detector=_POOR)),
    "kidnapped_clutter_missed": Case(replace(_BASE, kidnap_s=15.0, detector=_POOR), since_s=15.0),
    "noise_a_third": Case(settings=A_THIRD_OF_THE_NOISE),
    "11hz_300_particles": Case(
        replace(_BASE, detector=DetectorConfig(rate_hz=11.0)), {"particles": 300}
    ),
}


def drive_through(case: Case, seed: int) -> tuple[PointDrive, list[PfEstimate], ParticleFilter]:
    """One seeded drive and the estimates of the filter."""
    drive = simulate_points(case.scenario, np.random.default_rng(seed))
    particle_filter = ParticleFilter(
        drive.pole_map,
        LocalizeConfig(**case.settings),
        WHEELBASE_M,
        np.random.default_rng(seed + 1000),
    )
    if case.start_offset is not None:
        start = drive.motion.at(0.0)[0] + np.array(case.start_offset)
        particle_filter.set_pose(0.0, start, np.diag([0.25, 0.25, 0.003]))
    return drive, play(particle_filter, drive.samples), particle_filter


def play(particle_filter: ParticleFilter, samples: Iterable[Sample]) -> list[PfEstimate]:
    """The estimates of a filter that hears samples."""
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


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def judge(drive: PointDrive, estimates: list[PfEstimate], since_s: float) -> dict[str, float]:
    """Seconds from `since_s` until the error stays below 1 m and 3 degrees, seconds in which a pose
    more than 1 m off was called healthy, and the errors of what comes 15 s after `since_s`."""
    stamps = np.array([e.stamp_s for e in estimates])
    truth = drive.motion.at(stamps)
    offset = np.array([e.pose for e in estimates]) - truth
    offset[:, 2] = wrap_angle(offset[:, 2])
    along, across = rotate_back(offset[:, :2], truth[:, 2]).T
    inverse = np.linalg.inv(np.array([e.covariance for e in estimates]))
    nees = np.einsum("ni,nij,nj->n", offset, inverse, offset) / 3.0
    bad = (np.hypot(along, across) > 1.0) | (np.abs(offset[:, 2]) > np.radians(3.0))
    bad &= stamps > since_s
    healthy = np.array([e.healthy for e in estimates])
    wrong = healthy & (np.hypot(along, across) > 1.0)
    late = stamps > since_s + 15.0
    return {
        "found_after_s": float(stamps[bad].max() - since_s) if bad.any() else 0.0,
        "claimed_wrongly_s": float(np.diff(stamps, append=stamps[-1])[wrong].sum()),
        "lateral_rmse_m": rms(across[late]),
        "longitudinal_rmse_m": rms(along[late]),
        "yaw_rmse_deg": float(np.degrees(rms(offset[late, 2]))),
        "nees": float(nees[late].mean()),
    }


def main(seeds: int, names: list[str], first: int = 0) -> None:
    print(
        "case | found within 10 s | slowest | claimed wrongly, worst | lateral, along [m] | "
        "yaw [deg] | NEES | restarts"
    )
    for name in names:
        rows, restarts = [], 0
        for seed in range(first, first + seeds):
            drive, estimates, particle_filter = drive_through(CASES[name], seed)
            rows.append(judge(drive, estimates, CASES[name].since_s))
            restarts += particle_filter.counts["reinitializations"]
        after = np.array([row["found_after_s"] for row in rows])
        claimed = max(row["claimed_wrongly_s"] for row in rows)
        mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        print(
            f"{name} | {(after <= 10.0).sum()} of {seeds} | {after.max():.1f} s | "
            f"{claimed:.1f} s | {mean['lateral_rmse_m']:.3f}, "
            f"{mean['longitudinal_rmse_m']:.3f} | "
            f"{mean['yaw_rmse_deg']:.2f} | {mean['nees']:.2f} | {restarts}",
            flush=True,
        )


if __name__ == "__main__":
    chosen = sys.argv[2].split(",") if len(sys.argv) > 2 else list(CASES)
    begin, _, end = (sys.argv[1] if len(sys.argv) > 1 else "20").rpartition(":")
    main(int(end) - int(begin or 0), chosen, int(begin or 0))
