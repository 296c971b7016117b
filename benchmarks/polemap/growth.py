"""How a frame's cost grows: with the picture, the disparities, the particles, the poles in view.

    python -m benchmarks polemap.growth

Processor time of one thread, so that other work of the machine does not count; the best of a few
rounds, all sizes in turn. Pictures are those of a simulated street, taken with cameras of one field
of view; particle filter: an update as in `localize.particle_filter_speed`. Length of the drive:
`benchmarks.campaign.endurance`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from benchmarks.localize.particle_filter_speed import update_times
from benchmarks.simulate.streets import open_street
from polemap.config import PolemapConfig
from polemap.drivelog.samples import StereoFrame
from polemap.perception import PolePerception
from polemap.stereo.config import StereoConfig
from polemap.stereo.rig import StereoRig

_SIZES = ((640, 360), (768, 480), (1280, 720), (1920, 1080))
_DISPARITIES = (64, 128, 256)
_PARTICLES = (250, 500, 1000, 2000, 4000)
_POLES = ((5, 12), (10, 25), (20, 50))
_ROUNDS, _BEGIN_S = 5, 6.0


def run() -> dict[str, dict[str, float]]:
    """Milliseconds by what grows."""
    cv2.setNumThreads(1)
    figures: dict[str, dict[str, float]] = {}
    work: dict[str, Callable[[], object]] = {}
    for width, height in _SIZES:
        rig, frame = _frame(width, height)
        # the range of distances stays: disparities grow with the width
        base = 16 * round(128 * width / 768 / 16)
        for count in _DISPARITIES if width == 768 else (min(base, 256),):
            for search in ("strips", "full"):
                stereo = StereoConfig(disparities=count, search=search, threads=1)
                perception = PolePerception(rig, PolemapConfig(), stereo=stereo)
                name = f"growth_{width}x{height}_{count}"
                work[f"{name}_matching_{search}"] = partial(perception.match, frame)
                if search == "strips":
                    maps = perception.match(frame)
                    work[f"{name}_detection"] = partial(perception.perceive, frame, maps)
    best = dict.fromkeys(work, float("inf"))
    for _ in range(_ROUNDS + 1):
        for name, task in work.items():
            begin = time.process_time()
            task()
            best[name] = min(best[name], time.process_time() - begin)
    figures |= {name: {"cpu_ms": 1e3 * seconds} for name, seconds in best.items()}
    for particles in _PARTICLES:
        times = update_times(150, particles=particles)
        figures[f"growth_update_{particles}_particles"] = {
            "median_ms": 1e3 * float(np.median(times))
        }
    for seen, mapped in _POLES:
        times = update_times(150, seen=seen, in_view=mapped)
        name = f"growth_update_{seen}_seen_{mapped}_mapped"
        figures[name] = {"median_ms": 1e3 * float(np.median(times))}
    return figures


def _frame(width: int, height: int) -> tuple[StereoRig, StereoFrame]:
    focal = 384.0 / np.tan(np.pi * 25.0 / 180.0) * width / 768
    street = open_street(
        "avenue", 511, 10.0, camera={"width_px": width, "height_px": height, "focal_px": focal}
    )
    number = int(np.searchsorted(street.plan.frame_stamps_s, _BEGIN_S))
    shot = street.studio.shot(number)
    rig = street.studio.renderer.rig
    return rig, StereoFrame(_BEGIN_S, _BEGIN_S, number, shot.left.copy(), shot.right.copy())
