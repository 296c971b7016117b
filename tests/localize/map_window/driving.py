"""Drives through a city of which only what lies around the car is read."""

from __future__ import annotations

import numpy as np

from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.localize.replay import Run, replay
from polemap.map.city.city_map import CityMap
from polemap.map.pole_map import PoleMap
from polemap.simulate.points.drive import PointDrive

CONFIG = LocalizeConfig(particles=150, output={"rate_hz": 20})
DURATION_S = 26.0
KIDNAPPED_S, KIDNAPPED_M = 14.0, 200.0


Poses = tuple[np.ndarray, ...]


def poses_of(drive: PointDrive, pole_map: PoleMap | CityMap) -> tuple[Run, Poses]:
    run = replay(drive.drive, pole_map, drive.scans, CONFIG, seed=3)
    return run, (run.pf.stamp_s, run.pf.poses, run.kf.poses, run.kf.covariance)


def live(drive: PointDrive, pole_map: PoleMap | CityMap, **options) -> Localizer:
    return Localizer(pole_map, CONFIG, drive.drive.wheelbase_m, np.random.default_rng(3), **options)


def play(localizer: Localizer, samples, settle: bool = False):
    """Adds samples, asks at each for the pose; `settle` waits for what is being read."""
    answers = []
    for sample in samples:
        localizer.add_sample(sample)
        loading = localizer._particle_filter._window._loading
        if settle and loading is not None:
            loading.join(60.0)
        answers.append(localizer.pose_at(sample.arrival_s))
    return [answer for answer in answers if answer is not None]


def until(drive: PointDrive, end_s: float):
    return [sample for sample in drive.samples if sample.arrival_s < end_s]
