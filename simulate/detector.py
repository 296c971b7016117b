"""Poles as a detector reports them, drawn from stated errors instead of seen in pictures."""

from __future__ import annotations

import numpy as np

from drivelog.samples import PoleScan
from simulate.config import DetectorConfig
from simulate.driver import Motion
from simulate.point_world import PointScenario, PoleDetector
from simulate.world import World


def point_scans(
    world: World, motion: Motion, config: DetectorConfig, rng: np.random.Generator
) -> list[PoleScan]:
    """What a detector reports of a world's poles along a drive; nothing hides them."""
    poles = world.poles()
    detector = PoleDetector(
        np.array([[pole.x_m, pole.y_m] for pole in poles]).reshape(-1, 2),
        np.array([pole.width_m for pole in poles]),
        PointScenario(
            scan_delay_s=config.latency_s,
            half_view_rad=config.half_view_rad,
            range_max_m=config.range_max_m,
            p_detection=config.detected_share,
            clutter_share=config.clutter_share,
            range_sd_per_m2=config.range_sd_per_m2,
            bearing_sd_rad=config.bearing_sd_rad,
            correlated_share=config.correlated_share,
        ),
        rng,
    )
    stamps = np.arange(motion.stamp_s[0], motion.stamp_s[-1], 1.0 / config.rate_hz)
    poses = motion.at(stamps)
    return [detector.scan(float(t), pose) for t, pose in zip(stamps, poses, strict=True)]
