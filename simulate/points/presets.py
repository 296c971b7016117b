"""Scenarios that tests and benchmarks share; `dataclasses.replace` makes others of them."""

from __future__ import annotations

from polemap.simulate.config import DetectorConfig, GnssConfig
from polemap.simulate.points.drive import GNSS, PointScenario
from polemap.simulate.points.motion import CityTraffic, Slip
from polemap.simulate.points.pose_source import PoseSource
from polemap.simulate.sensors import ReferenceErrors


def gnss(rate_hz: float = 1.0, wander_sd_m: float = 2.5) -> GnssConfig:
    """The receiver of `GNSS` at another rate, with another error."""
    return GNSS.model_copy(update={"rate_hz": rate_hz, "wander_sd_m": wander_sd_m})


POSES_IN_CITY = PointScenario(
    motion=CityTraffic(), gnss=gnss(), detector=None, pose_source=PoseSource()
)
"""For the output filter alone: odometry, GNSS, and poses in place of a particle filter."""

STREWN_CITY = PointScenario(
    duration_s=20.0,
    motion=CityTraffic(slip=Slip(0.007, 0.0, 0.0)),
    pole_spacing_m=None,
    map_sd_m=0.04,
    gnss=gnss(),
    detector=DetectorConfig(
        rate_hz=10.0, half_view_rad=0.6, range_max_m=25.0, detected_share=0.85,
        clutter_share=0.05, range_sd_per_m2=0.0002, bearing_sd_rad=0.003, correlated_share=0.0,
        latency_s=0.03,
    ),
    reference=ReferenceErrors(0.01, 40.0, 0.0),
)  # fmt: skip
"""For the whole localizer: poles all around, seen by a detector whose errors do not last."""
