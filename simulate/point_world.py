"""Drives of points: poles, odometry, GNSS and noisy pole scans, without images.

Fast enough for statistics over many seeds, and honest for the localizer alone: what a detector
does wrong is drawn from stated distributions here, not made from pixels. The errors of a pole's
position stay alike from scan to scan, as those of stereo and of tracks do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import GnssFix, OdometrySample, PoleScan, Sample
from polemap.map.landmark_map import PoleMap
from polemap.simulate.config import DetectorConfig
from polemap.simulate.detector import PoleDetector
from polemap.vehicle.motion import move_along_arc
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

_STEP_S = 0.01
_START_MPS2 = 1.5
FRAME = EarthFrame("local", name="point_world")


@dataclass(frozen=True, slots=True)
class PointScenario:
    """What to drive through, and how badly it is sensed.

    Attributes:
        pole_spacing_m: mean way along the road from one pole to the next, on both sides together.
        slip_rad: standard deviation of a slowly wandering angle between heading and motion, beside
            what the rear axle slips outward in bends.
        slip_rad_per_mps2, slip_sd_rad_per_mps2: that, per lateral acceleration; drawn once a drive.
        scan_hz ... correlated_share: the detector, see `detector`.
        map_sd_m: of the map's positions, in each axis.
        odometry_scale, odometry_bias_radps: what stays wrong over the whole drive.
        gnss_outage: first and last second without GNSS.
        standstill_s: the car stands for so long before it drives off.
        kidnap_s: moment at which the car is put 50 m ahead on its way, unknown to the odometry.
    """

    duration_s: float = 60.0
    speed_mps: float = 9.0
    pole_spacing_m: float = 5.0
    slip_rad: float = 0.002
    slip_rad_per_mps2: float = 0.0065
    slip_sd_rad_per_mps2: float = 0.001
    scan_hz: float = 22.0
    scan_delay_s: float = 0.1
    half_view_rad: float = 0.44
    range_max_m: float = 30.0
    p_detection: float = 0.75
    clutter_share: float = 0.1
    range_sd_per_m2: float = 0.0008
    bearing_sd_rad: float = 0.002
    correlated_share: float = 0.5
    map_sd_m: float = 0.05
    odometry_hz: float = 50.0
    odometry_scale: float = 0.01
    speed_sd_mps: float = 0.05
    odometry_bias_radps: float = 0.001
    yaw_rate_sd_radps: float = 0.002
    gnss_hz: float = 5.0
    gnss_sd_m: float = 2.5
    gnss_correlation_s: float = 60.0
    gnss_outage: tuple[float, float] = (np.inf, np.inf)
    standstill_s: float = 0.0
    kidnap_s: float = np.inf
    kidnap_m: float = 50.0

    def detector(self) -> DetectorConfig:
        """The part of it that says what is seen of poles."""
        return DetectorConfig(
            rate_hz=self.scan_hz,
            latency_s=self.scan_delay_s,
            half_view_rad=self.half_view_rad,
            range_max_m=self.range_max_m,
            detected_share=self.p_detection,
            clutter_share=self.clutter_share,
            range_sd_per_m2=self.range_sd_per_m2,
            bearing_sd_rad=self.bearing_sd_rad,
            correlated_share=self.correlated_share,
        )


@dataclass(frozen=True, slots=True)
class PointDrive:
    """A drive of points: the map of its road, its samples in arrival order, and the truth.

    `truth_s` is `(n,)`, `truth` `(n, 3)` poses of the rear axle.
    """

    pole_map: PoleMap
    samples: tuple[Sample, ...]
    truth_s: Floats
    truth: Floats
    wheelbase_m: float = 2.7

    def truth_at(self, stamp_s: float) -> Floats:
        """True rear-axle pose `(3,)` of the nearest simulated instant (10 ms apart)."""
        return np.asarray(self.truth[np.argmin(np.abs(self.truth_s - stamp_s))])


def simulate_points(scenario: PointScenario, rng: np.random.Generator) -> PointDrive:
    """Draw a road, its poles and one drive along it; the same generator, the same drive."""
    stamps, path, speed, yaw_rate = _drive_path(scenario, rng)
    pole_map, true_points, widths = plant_poles(path, scenario, rng)
    truth = path
    jump = round(scenario.kidnap_m / scenario.speed_mps / _STEP_S)
    if np.isfinite(scenario.kidnap_s):
        # the road goes on for longer than the drive, so the jump stays on it
        row = np.arange(len(stamps))
        row = np.where(stamps >= scenario.kidnap_s, row + jump, row)
        truth, speed, yaw_rate = path[row], speed[row], yaw_rate[row]
    samples: list[Sample] = []
    samples.extend(_odometry(stamps, speed, yaw_rate, scenario, rng))
    samples.extend(_gnss(stamps, truth, scenario, rng))
    samples.extend(_scans(stamps, truth, true_points, widths, scenario, rng))
    samples.sort(key=lambda sample: (_arrival(sample), sample.stamp_s))
    return PointDrive(pole_map, tuple(samples), stamps, truth)


def _arrival(sample: Sample) -> float:
    return getattr(sample, "arrival_s", sample.stamp_s)


def _wander(count: int, step_s: float, time_s: float, rng: np.random.Generator) -> Floats:
    """Gauss-Markov noise `(count,)` of unit variance and correlation time `time_s`."""
    keep = np.exp(-step_s / time_s)
    kicks = rng.standard_normal(count) * np.sqrt(1.0 - keep**2)
    values = np.empty(count)
    values[0] = rng.standard_normal()
    for i in range(1, count):
        values[i] = keep * values[i - 1] + kicks[i]
    return values


def _drive_path(
    scenario: PointScenario, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats, Floats]:
    """Stamps `(n,)` and, for a longer time, path `(m, 3)`, speed and yaw rate `(m,)`."""
    count = round(scenario.duration_s / _STEP_S)
    spare = round((2.0 * scenario.kidnap_m + 60.0) / scenario.speed_mps / _STEP_S)
    total = count + spare
    speed = scenario.speed_mps * (1.0 + 0.25 * _wander(total, _STEP_S, 8.0, rng))
    speed = np.asarray(np.clip(speed, 0.4 * scenario.speed_mps, 1.6 * scenario.speed_mps))
    if scenario.standstill_s > 0.0:
        driven_s = _STEP_S * np.arange(total) - scenario.standstill_s
        speed = np.clip(_START_MPS2 * driven_s, 0.0, speed)
    # curvature wanders with the way, so a slow car drives the same streets
    curvature = np.clip(0.012 * _wander(total, _STEP_S, 5.0, rng), -0.03, 0.03)
    yaw_rate = np.asarray(speed * curvature)
    slip = scenario.slip_rad * _wander(total, _STEP_S, 10.0, rng)
    softness = rng.normal(scenario.slip_rad_per_mps2, scenario.slip_sd_rad_per_mps2)
    slip -= softness * speed * yaw_rate
    path = np.empty((total, 3))
    pose = np.array([rng.uniform(-100, 100), rng.uniform(-100, 100), rng.uniform(-np.pi, np.pi)])
    for i in range(total):
        path[i] = pose
        course = pose + np.array([0.0, 0.0, slip[i]])
        pose = move_along_arc(course, speed[i] * _STEP_S, yaw_rate[i] * _STEP_S)
        pose[2] = wrap_angle(pose[2] - slip[i])
    return np.asarray(np.arange(count) * _STEP_S, dtype=np.float64), path, speed, yaw_rate


def plant_poles(
    path: Floats, scenario: PointScenario, rng: np.random.Generator
) -> tuple[PoleMap, Floats, Floats]:
    """The map, and where its poles really stand `(m, 2)`."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])
    gaps = rng.gamma(2.0, scenario.pole_spacing_m / 2.0, size=int(way[-1] / 2) + 10)
    station = np.cumsum(gaps) - 10.0
    station = station[station < way[-1]]
    row = np.clip(np.searchsorted(way, station), 0, len(path) - 1)
    side = rng.choice([-1.0, 1.0], len(row)) * rng.uniform(3.5, 9.0, len(row))
    across = path[row, 2] + np.pi / 2
    points = path[row, :2] + side[:, None] * np.stack([np.cos(across), np.sin(across)], axis=1)
    clear = np.hypot(*(points[:, None] - path[None, ::20, :2]).T).min(axis=0) > 2.5
    points = points[clear]
    count = len(points)
    widths = rng.uniform(0.08, 0.5, count)
    pole_map = PoleMap(
        frame=FRAME,
        ids=np.arange(count),
        points_m=points + scenario.map_sd_m * rng.standard_normal((count, 2)),
        covariance_m2=np.tile(np.eye(2) * scenario.map_sd_m**2, (count, 1, 1)),
        width_m=widths,
        height_m=np.full(count, np.nan),
        observations=np.full(count, 20),
        drives=np.ones(count, dtype=np.int64),
        existence=np.ones(count),
    )
    return pole_map, points, widths


def _odometry(
    stamps: Floats,
    speed: Floats,
    yaw_rate: Floats,
    scenario: PointScenario,
    rng: np.random.Generator,
) -> Iterator[OdometrySample]:
    scale = 1.0 + scenario.odometry_scale * rng.standard_normal()
    bias = scenario.odometry_bias_radps * rng.standard_normal()
    for i in range(0, len(stamps), round(1.0 / scenario.odometry_hz / _STEP_S)):
        yield OdometrySample(
            float(stamps[i]),
            float(stamps[i]),
            float(scale * speed[i] + scenario.speed_sd_mps * rng.standard_normal()),
            float(yaw_rate[i] + bias + scenario.yaw_rate_sd_radps * rng.standard_normal()),
        )


def _gnss(
    stamps: Floats, truth: Floats, scenario: PointScenario, rng: np.random.Generator
) -> Iterator[GnssFix]:
    rows = range(0, len(stamps), round(1.0 / scenario.gnss_hz / _STEP_S))
    step = 1.0 / scenario.gnss_hz
    error = np.stack(
        [_wander(len(rows), step, scenario.gnss_correlation_s, rng) for _ in range(2)], axis=1
    )
    white = 0.2 * rng.standard_normal((len(rows), 2))
    first, last = scenario.gnss_outage
    for k, i in enumerate(rows):
        if first <= stamps[i] <= last:
            continue
        position = truth[i, :2] + scenario.gnss_sd_m * error[k] + white[k]
        yield GnssFix(
            float(stamps[i]), float(stamps[i]), float(position[0]), float(position[1]), 1.0
        )


def _scans(
    stamps: Floats,
    truth: Floats,
    points: Floats,
    widths: Floats,
    scenario: PointScenario,
    rng: np.random.Generator,
) -> Iterator[PoleScan]:
    detector = PoleDetector(points, widths, scenario.detector(), rng)
    for stamp in np.arange(0.5, stamps[-1], 1.0 / scenario.scan_hz):
        # the truth is known every 10 ms only: the scan is stamped with its instant
        row = np.argmin(np.abs(stamps - stamp))
        yield detector.scan(float(stamps[row]), truth[row])
