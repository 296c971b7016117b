"""From picture to pose: frames a second and latency, one stage after the other and overlapped.

    python -m benchmarks polemap.pipeline_speed

A simulated street of 768x480 (or the drive that the environment variable POLEMAP_BENCH_DRIVE
names), pictures in memory: matching, detection, tracking, particle filter of 1000 particles in the
map of the street's poles. All variants are interleaved in one run: `search: full` and `strips`, one
thread and two for the matcher, and `ahead`, where a frame is matched while the one before is looked
at and localized. Latency is from the moment a frame is taken up to its pose.
"""

from __future__ import annotations

import time
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import summary
from benchmarks.simulate.streets import open_street
from polemap.config import PolemapConfig
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import OdometrySample, StereoFrame
from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.map.pole_map import PoleMap
from polemap.matching_ahead import MatchedFrame, match_ahead
from polemap.perception import PolePerception
from polemap.simulate.truth import true_map
from polemap.stereo.config import StereoConfig
from polemap.stereo.rig import StereoRig

SEARCHES: tuple[Literal["full", "strips"], ...] = ("full", "strips")
_WORLD, _SEED, _RATE_HZ, _BEGIN_S, _FRAMES, _ROUNDS = "avenue", 511, 10.0, 6.0, 40, 7
Floats = NDArray[np.float64]
Pose = tuple[float, Floats]
Samples = list[OdometrySample | StereoFrame]


def run() -> dict[str, dict[str, float]]:
    """Milliseconds a frame (throughput) and from a frame to its pose (latency), by variant."""
    rig, samples, pole_map, start = _street()
    variants = {
        f"{search}_{threads}threads{'_ahead' if ahead else ''}": (search, threads, ahead)
        for search in SEARCHES
        for threads in (1, 2)
        for ahead in (False, True)
    }
    frame_s: dict[str, list[float]] = {name: [] for name in variants}
    latency_s: dict[str, list[float]] = {name: [] for name in variants}
    poses: list[Floats] = []
    for number in range(_ROUNDS + 1):  # the first allocates
        for name, (search, threads, ahead) in variants.items():
            stereo = StereoConfig(search=search, threads=threads)
            begin = time.perf_counter()
            late, pose = _localize(rig, samples, pole_map, start, stereo, ahead)
            if number == 0:
                poses.append(pose)
                continue
            frame_s[name].append((time.perf_counter() - begin) / _FRAMES)
            latency_s[name] += late
    if any(not np.array_equal(poses[k], poses[0 if k < 4 else 4]) for k in range(8)):
        raise SystemExit("the poses differ between one frame after the other and one ahead")
    plain = float(np.median(frame_s["full_2threads"]))
    return {
        f"pipeline_{name}": {
            **summary(frame_s[name]),
            "frames_per_s": 1.0 / float(np.median(frame_s[name])),
            "times_full_2threads": plain / float(np.median(frame_s[name])),
            "latency_median_ms": 1e3 * float(np.median(latency_s[name])),
        }
        for name in variants
    }


def _street() -> tuple[StereoRig, Samples, PoleMap, Pose]:
    street = open_street(_WORLD, _SEED, _RATE_HZ)
    stamps = street.plan.frame_stamps_s
    first = int(np.searchsorted(stamps, _BEGIN_S))
    stamps = stamps[first : first + _FRAMES]
    inside = (street.odometry.stamp_s >= stamps[0] - 1.0) & (street.odometry.stamp_s <= stamps[-1])
    samples: Samples = [street.odometry.sample(row) for row in np.flatnonzero(inside).tolist()]
    for number, stamp in enumerate(stamps.tolist(), first):
        shot = street.studio.shot(number)
        samples.append(StereoFrame(stamp, stamp, number, shot.left.copy(), shot.right.copy()))
    samples.sort(key=lambda sample: sample.stamp_s)
    origin = np.zeros(2)
    pole_map = true_map(street.world, EarthFrame("local", name="street"), origin)
    start_s = float(stamps[0]) - 0.5
    pose = street.plan.motion.at(np.array([start_s]))[0]
    return street.studio.renderer.rig, samples, pole_map, (start_s, pose)


def _localize(
    rig: StereoRig,
    samples: Samples,
    pole_map: PoleMap,
    start: Pose,
    stereo: StereoConfig,
    ahead: bool,
) -> tuple[list[float], Floats]:
    """Seconds from each frame to its pose, and the last pose."""
    perception = PolePerception(rig, PolemapConfig(), stereo=stereo)
    localizer = Localizer(
        pole_map, LocalizeConfig(), 2.7, np.random.default_rng(1), perception=perception
    )
    localizer.start_at(start[0], start[1], np.diag([0.25, 0.25, 0.001]))
    taken: dict[int, float] = {}

    def matched(frame: StereoFrame) -> MatchedFrame:
        taken[frame.index] = time.perf_counter()
        return perception.matched(frame)

    late, last = [], np.empty(3)
    for sample in match_ahead(samples, matched) if ahead else samples:
        if isinstance(sample, StereoFrame):
            begin = taken.get(sample.index, time.perf_counter())
            found = localizer.add_sample(sample)
            late.append(time.perf_counter() - begin)
            if found is not None:
                last = found.pose
        else:
            localizer.add_sample(sample)
    return late, last
