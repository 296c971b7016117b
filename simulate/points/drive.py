"""A drive of points: what odometry, GNSS, a pole detector and a pose source say of a true motion.

For statistics over many seeds, where pictures would take hours, and honest for what stands behind
perception: what a detector does wrong is drawn from stated distributions. The sensors are those
of the rendered drives (`simulate/sensors.py`, `simulate/detector.py`), and the result holds a
`Drive`, so that faults and recorders work on both alike.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import Sample
from polemap.drivelog.source_names import FOLDER
from polemap.map.pole_map import PoleMap
from polemap.simulate import sensors
from polemap.simulate.config import (
    CornerDetectorConfig,
    DetectorConfig,
    GnssConfig,
    LineDetectorConfig,
    OdometryConfig,
)
from polemap.simulate.detector import PoleDetector
from polemap.simulate.kind_scans import with_kinds
from polemap.simulate.points.motion import (
    CityTraffic,
    MotionModel,
    PointMotion,
    Slip,
    WindingRoad,
    put_ahead,
)
from polemap.simulate.points.poles import Poles, roadside_poles, scattered_poles
from polemap.simulate.points.pose_source import PointPose, PoseSource
from polemap.simulate.sensors import ReferenceErrors
from polemap.simulate.skyline import Fronts
from polemap.simulate.street_lines import Street, StreetTruth

Floats = NDArray[np.float64]

FRAME = EarthFrame("local", name="points")
WHEELBASE_M = 2.7
_OPEN_SKY = Fronts.of([])

ODOMETRY = OdometryConfig(
    speed_scale_sd=0.01, speed_noise_sd_mps=0.05, yaw_bias_sd_radps=0.001,
    yaw_noise_sd_radps=0.002, latency_s=0.0,
)  # fmt: skip
"""What stays wrong is a scale and a bias; the rest is white."""

GNSS = GnssConfig(
    rate_hz=5.0, wander_sd_m=2.5, multipath_per_min=0.0, outages_per_min=0.0, antenna_x_m=0.0,
    latency_s=0.0,
)  # fmt: skip
"""Under open sky, the antenna at the rear axle."""

RECEIVER = sensors.ReceiverErrors(noise_sd_m=0.2)


@dataclass(frozen=True, slots=True)
class PointScenario:
    """What to drive through, and how badly it is sensed; `replace` makes another of it.

    Attributes:
        duration_s: of the drive.
        motion: how the car moves.
        pole_spacing_m: mean way along the path between poles on both sides together, or None for
            poles strewn over the whole surroundings, `poles_per_m2` of them.
        map_sd_m: of the map's positions, in each axis.
        odometry, gnss, detector, reference, pose_source: the sensors; None where there is none.
        detector_error_time_s: for how long the share of a detector's error lasts that its settings
            call correlated; by default for the whole drive.
        gnss_outage_s: first and last second without GNSS, counted from the begin.
        kidnap_s: moment at which the car is put `kidnap_m` ahead on its way, unknown to the
            odometry.
        start_s: stamp of the drive's begin.
        street: the lines and corners along the path; None without any.
        lines, corners: their detectors, None where there are none.
        without_poles_m: a part of the path's length beside which no pole stands.
    """

    duration_s: float = 60.0
    motion: MotionModel = field(default_factory=WindingRoad)
    pole_spacing_m: float | None = 5.0
    poles_per_m2: float = 0.008
    map_sd_m: float = 0.05
    odometry: OdometryConfig | None = ODOMETRY
    gnss: GnssConfig | None = GNSS
    detector: DetectorConfig | None = field(default_factory=DetectorConfig)
    detector_error_time_s: float = np.inf
    reference: sensors.ReferenceErrors | None = None
    reference_hz: float = 50.0
    pose_source: PoseSource | None = None
    gnss_outage_s: tuple[float, float] = (np.inf, np.inf)
    kidnap_s: float = np.inf
    kidnap_m: float = 50.0
    start_s: float = 0.0
    frame: EarthFrame = FRAME
    street: Street | None = None
    lines: LineDetectorConfig | None = None
    corners: CornerDetectorConfig | None = None
    without_poles_m: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class PointDrive:
    """A drive of points.

    Attributes:
        drive: odometry, GNSS, reference and pole scans as a recorder would have them.
        motion: the truth.
        poles: where they really stand.
        pole_map: the map of them.
        poses: what the pose source gave, by stamp.
        street: lines and corners as they are during the drive.
    """

    drive: Drive
    motion: PointMotion
    poles: Poles
    pole_map: PoleMap
    poses: tuple[PointPose, ...] = ()
    street: StreetTruth = field(default_factory=StreetTruth)

    @property
    def samples(self) -> tuple[Sample, ...]:
        """Odometry, GNSS and scans in the order of arrival; the reference is no input."""
        return tuple(replace(self.drive, reference=None).samples())

    @property
    def scans(self) -> tuple[Detections, ...]:
        """The pole scans by stamp."""
        return self.drive.scans


def simulate_points(
    scenario: PointScenario, rng: np.random.Generator, poles: Poles | None = None
) -> PointDrive:
    """Draw a drive; the same generator, the same drive.

    Args:
        scenario: what to drive through.
        rng: all randomness.
        poles: what stands there; by default it is drawn beside the path.
    """
    spare_s = 0.0
    if np.isfinite(scenario.kidnap_s):
        # the road goes on for longer than the drive, so that the jump stays on it
        spare_s = scenario.duration_s
    path = scenario.motion.drawn(scenario.duration_s + spare_s, rng)
    if poles is None:
        poles = _poles(path, scenario, rng)
    if scenario.without_poles_m is not None:
        poles = poles.rows(~_beside(poles.points_m, path, scenario.without_poles_m))
    pole_map = poles.surveyed(scenario.frame, scenario.map_sd_m, rng)
    street = StreetTruth()
    if scenario.street is not None:
        street, pole_map = _street(scenario.street, path, pole_map, rng)
    if np.isfinite(scenario.kidnap_s):
        path = put_ahead(path, scenario.kidnap_s, scenario.kidnap_m)
    motion = path.until(scenario.duration_s)
    drive = sensed(scenario, motion, poles, rng, street)
    given = () if scenario.pose_source is None else scenario.pose_source.poses(motion, rng)
    moved = tuple(pose.later(scenario.start_s) for pose in given)
    return PointDrive(drive, motion.later(scenario.start_s), poles, pole_map, moved, street)


def sensed(
    scenario: PointScenario, motion: PointMotion, poles: Poles, rng: np.random.Generator,
    street: StreetTruth | None = None,
) -> Drive:  # fmt: skip
    """What the scenario's sensors record of a motion that begins at 0, on the drive's clock."""
    origin, begin = np.zeros(2), scenario.start_s
    odometry = gnss = reference = None
    scans: tuple[Detections, ...] = ()
    if scenario.odometry is not None:
        odometry = sensors.odometry(motion, scenario.odometry, rng, sensors.NO_WHEEL_ERRORS)
        odometry = replace(
            odometry, stamp_s=odometry.stamp_s + begin, arrival_s=odometry.arrival_s + begin
        )
    if scenario.gnss is not None:
        gnss = sensors.gnss(motion, origin, scenario.gnss, rng, _OPEN_SKY, RECEIVER)
        first, last = scenario.gnss_outage_s
        gnss = gnss.take((gnss.stamp_s < first) | (gnss.stamp_s > last))
        gnss = replace(gnss, stamp_s=gnss.stamp_s + begin, arrival_s=gnss.arrival_s + begin)
    if scenario.detector is not None:
        detector = PoleDetector(
            poles.points_m,
            poles.width_m,
            scenario.detector,
            rng,
            visibility=poles.visibility,
            error_time_s=scenario.detector_error_time_s,
        )
        seen = tuple(sensors.pole_scans(detector, motion, scenario.detector.rate_hz))
        if street is not None and (scenario.lines is not None or scenario.corners is not None):
            # draws of their own, so that poles are seen alike with and without them
            seen = with_kinds(
                seen, motion, street, scenario.detector, scenario.lines, scenario.corners,
                rng.spawn(1)[0],
            )  # fmt: skip
        scans = tuple(
            replace(scan, stamp_s=scan.stamp_s + begin, arrival_s=scan.arrival_s + begin)
            for scan in seen
        )
    if scenario.reference is not None:
        reference = sensors.reference(
            motion, origin, scenario.reference, scenario.reference_hz, rng
        )
        reference = replace(reference, stamp_s=reference.stamp_s + begin)
    return Drive(
        names=FOLDER,
        name="points",
        path=Path("points"),
        frame=scenario.frame,
        wheelbase_m=WHEELBASE_M,
        odometry=odometry,
        gnss=gnss,
        reference=reference,
        scans=scans,
    )


def _street(
    street: Street, path: PointMotion, pole_map: PoleMap, rng: np.random.Generator
) -> tuple[StreetTruth, PoleMap]:
    """Lines and corners along a path as they are now, and the map with their survey."""
    own = rng.spawn(1)[0]
    places = path.states[:, :2]
    surveyed = StreetTruth(street.lines(places, own), street.corners(places, own))
    pole_map = surveyed.onto(pole_map, street.map_sd_m, own)
    return replace(surveyed, lines=street.repainted(surveyed.lines)), pole_map


def _beside(points_m: Floats, path: PointMotion, part_m: tuple[float, float]) -> NDArray[np.bool_]:
    """Which points `(n, 2)` stand beside a part of the path, by the nearest place of it."""
    places = path.states[:, :2]
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    station = way[scipy.spatial.KDTree(places).query(points_m)[1]]
    return np.asarray((station >= part_m[0]) & (station < part_m[1]))


def _poles(path: PointMotion, scenario: PointScenario, rng: np.random.Generator) -> Poles:
    # a place every decimetre or so is enough to say where poles may stand
    poses = path.states[:: max(1, len(path.stamp_s) // 6000), :3]
    if scenario.pole_spacing_m is None:
        return scattered_poles(poses, scenario.poles_per_m2, rng)
    return roadside_poles(poses, scenario.pole_spacing_m, rng)


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
