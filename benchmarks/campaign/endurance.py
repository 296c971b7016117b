"""Eight hours through the live interface, two of them without poles: memory, latency, rate.

`python -m benchmarks.campaign.endurance [HOURS] [PICTURE]` drives round a block, asks for the pose
100 times a simulated second, and prints a line for every quarter of an hour; with PICTURE it draws
docs/pictures/endurance.svg. So that hours pass in minutes, odometry comes at 20 Hz, the detector
looks at 2 Hz and the filter has 200 particles.
"""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from polemap.drivelog.detections import Detections
from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.simulate.config import DetectorConfig
from polemap.simulate.points.drive import ODOMETRY, PointScenario, gnss, simulate_points
from polemap.simulate.points.motion import GivenPoses

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "endurance.svg"
PART_S, RATE_HZ, RADIUS_M, SPEED_MPS = 900.0, 100, 60.0, 8.0


@dataclass(frozen=True, slots=True)
class Part:
    """What a quarter of an hour showed: memory, time per answer, error, and how often none came."""

    hours: float
    memory_mb: float
    median_us: float
    p99_us: float
    asked: int
    answered: int
    not_finite: int
    error_m: float
    healthy: float


def scenario(hours: float) -> PointScenario:
    """Round and round at 8 m/s among poles on all sides."""
    angle = SPEED_MPS / RADIUS_M * 0.1 * np.arange(round(hours * 36_000) + 2)
    yaw = np.mod(angle + 1.5 * np.pi, 2.0 * np.pi) - np.pi
    poses = np.column_stack([RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), yaw])
    return PointScenario(
        duration_s=hours * 3600.0, motion=GivenPoses(poses), pole_spacing_m=None,
        poles_per_m2=0.006, gnss=gnss(1.0), detector=DetectorConfig(rate_hz=2.0, half_view_rad=0.7),
        odometry=ODOMETRY.model_copy(update={"rate_hz": 20.0}),
    )  # fmt: skip


def memory_mb() -> float:
    """Resident set of this process now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


def drive(hours: float) -> list[Part]:
    """Run it; poles are missing from 3/8 to 5/8 of the time."""
    points = simulate_points(scenario(hours), np.random.default_rng(0))
    localizer = Localizer(
        points.pole_map, LocalizeConfig(particles=200), 2.7, np.random.default_rng(1)
    )
    nothing = np.empty(0, dtype=np.int64)
    first_s, last_s = hours * 3600.0 * 3 / 8, hours * 3600.0 * 5 / 8
    tick, asked, bad = 1, 0, 0
    parts: list[Part] = []
    spent: list[float] = []
    errors: list[float] = []
    healthy: list[bool] = []
    for sample in replace(points.drive, reference=None).samples():
        if isinstance(sample, Detections) and first_s <= sample.stamp_s < last_s:
            sample = sample.take(nothing)
        while tick / RATE_HZ < sample.arrival_s:
            begin = time.perf_counter()
            answer = localizer.pose_at(tick / RATE_HZ)
            spent.append(time.perf_counter() - begin)
            asked += 1
            if answer is not None:
                bad += not (np.isfinite(answer.pose).all() and np.isfinite(answer.covariance).all())
                healthy.append(answer.healthy)
                if tick % RATE_HZ == 0:
                    truth = points.motion.at(answer.stamp_s)[0]
                    errors.append(float(np.hypot(*(np.array(answer.pose) - truth)[:2])))
            tick += 1
        localizer.add_sample(sample)
        if tick / RATE_HZ >= PART_S * (len(parts) + 1):
            times = 1e6 * np.array(spent)
            parts.append(
                Part(
                    tick / RATE_HZ / 3600.0, memory_mb(), float(np.median(times)),
                    float(np.quantile(times, 0.99)), asked, len(healthy), bad,
                    float(np.quantile(errors, 0.95)) if errors else float("nan"),
                    float(np.mean(healthy)) if healthy else 0.0,
                )
            )  # fmt: skip
            print(parts[-1], flush=True)
            spent.clear()
            errors.clear()
            healthy.clear()
            asked = bad = 0
    return parts


def draw(parts: list[Part], path: Path) -> None:
    """Memory, latency and error over the hours."""
    import matplotlib as mpl

    mpl.use("svg")
    import matplotlib.pyplot as plt

    hours = [part.hours for part in parts]
    figure, axes = plt.subplots(3, 1, figsize=(7.0, 5.0), sharex=True)
    axes[0].plot(hours, [part.memory_mb for part in parts])
    axes[0].set_ylabel("memory [MB]")
    axes[0].set_ylim(0.0, None)
    axes[1].plot(hours, [part.median_us for part in parts], label="median")
    axes[1].plot(hours, [part.p99_us for part in parts], label="99 %")
    axes[1].set_ylabel("pose_at [µs]")
    axes[1].set_ylim(0.0, None)
    axes[1].legend()
    axes[2].plot(hours, [part.error_m for part in parts])
    axes[2].set_ylabel("error, 95 % [m]")
    axes[2].set_xlabel("simulated hours; no poles in the middle quarter")
    for axis in axes:
        axis.axvspan(hours[-1] * 3 / 8, hours[-1] * 5 / 8, color="0.9")
    figure.tight_layout()
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    done = drive(float(sys.argv[1]) if len(sys.argv) > 1 else 8.0)
    if len(sys.argv) > 2:
        draw(done, PICTURE)
