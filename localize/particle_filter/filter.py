"""The particle filter: odometry, GNSS and pole scans to a pose, its covariance and its health."""

from __future__ import annotations

from collections import Counter
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.samples import GnssFix, OdometrySample
from polemap.localize.calibration import OdometryCalibration, OdometryCorrection
from polemap.localize.config import LocalizeConfig
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.gnss.particle_weights import FixWeights
from polemap.localize.map_window import MapWindow
from polemap.localize.odometry_history import OdometryHistory
from polemap.localize.odometry_watch import Held
from polemap.localize.particle_filter.assessment import Assessment, Weighed
from polemap.localize.particle_filter.estimate import Event, PfEstimate
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.localize.particle_filter.line_evidence import LineEvidence
from polemap.localize.particle_filter.motion_noise import NoiseScale
from polemap.localize.particle_filter.odometry_faults import demand
from polemap.localize.particle_filter.odometry_trust import OdometryTrust
from polemap.localize.particle_filter.particles import ParticleSet, log_mean
from polemap.localize.particle_filter.pole_weigher import (
    PoleWeigher,
    counted_share,
    tempered,
)
from polemap.localize.particle_filter.recovery import Recovery, Step
from polemap.localize.particle_filter.twins import TwinPoles
from polemap.localize.place.claims import patterns_of
from polemap.map.city.city_map import CityMap
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import compose, relative, rotate

Floats = NDArray[np.float64]
# share of the first scan that counts: particles from a start are few for a sharp scan
_FIRST_SHARE = 0.2
# poses surer than this teach what is wrong with the odometry
_SURE_SD_M = 0.5
# so many times more particles where the place is not known yet
_START_FACTOR = 4
# samples of the odometry are joined to arcs up to this length, three at 50 Hz: noise is drawn once
# for each
_ARC_S = 0.06
# a pose older than this is no start: the odometry that is kept must reach back to it
_STALE_S = 60.0


class ParticleFilter:
    """Monte Carlo localization in a pole map; the state is (E, N, yaw) of the front axle.

    The filter lives at the stamp of the last scan. Odometry and fixes are kept until a scan comes,
    however late, and the particles are then moved exactly to its stamp. The same samples and the
    same generator give the same poses, bit for bit.

    Source: Spangenberg (2016), section IV.
    """

    def __init__(
        self,
        pole_map: PoleMap | CityMap,
        config: LocalizeConfig,
        wheelbase_m: float,
        rng: np.random.Generator,
        *,
        receiver: GnssReceiver | None = None,
        load_in_background: bool = False,
    ) -> None:
        receiver = receiver or GnssReceiver(config=config.gnss)
        self.counts: Counter[str] = Counter()
        chosen = config.chosen_kinds
        self._window = MapWindow(
            pole_map, self.counts, background=load_in_background, chosen=chosen
        )
        poles = self._window.poles
        self._weigher = PoleWeigher(poles, config)
        self._landmarks = Landmarks.of(poles, config.p_detection, np.empty(0, dtype=np.int64))
        self._config = config
        self._rng = rng
        self._history = OdometryHistory(config.odometry.rear_slip_rad_per_mps2)
        self._calibration = OdometryCalibration(config.odometry)
        self._noise = NoiseScale(config.odometry)
        self._recovery = Recovery(poles, config.recovery, receiver, self._weigher, rng, self.counts)
        self._in_background = load_in_background
        self._use_patterns(pole_map)
        self._fixes = FixWeights(receiver, weigh=config.gnss.particles)
        self._wheelbase_m = wheelbase_m
        self._particles = ParticleSet(config, wheelbase_m, rng)
        self._stamp_s = -np.inf
        self._travelled_m = 0.0
        self._scan_evidence = 0.0
        self._used_share = 0.0
        self._trusted = False
        self._odometry = OdometryTrust(config.odometry)
        twins = TwinPoles(poles)
        self._lines = LineEvidence(poles, config, self.counts)
        self._window.users += [self._weigher, self._recovery, twins, self._lines]
        self._assessment = Assessment(
            config, self._weigher, self._recovery, self._fixes, self._odometry, twins, self._lines,
            self.counts,
        )  # fmt: skip
        # of the last estimate
        self._pose, self._odometry_pose = np.zeros(3), np.zeros(3)

    @property
    def initialized(self) -> bool:
        """Whether there are particles yet."""
        return len(self._particles) > 0

    @property
    def correction(self) -> OdometryCorrection:
        """What was learned about the odometry."""
        return self._calibration.correction

    @property
    def slip_rad_per_mps2(self) -> float:
        """Outward slip of the rear axle per lateral acceleration, as the particles guess it."""
        if not self.initialized:
            return self._config.odometry.rear_slip_rad_per_mps2
        return self._particles.slip_rad_per_mps2

    def particles(self) -> tuple[Floats, Floats]:
        """Front-axle poses `(n, 3)` and weights `(n,)`, for pictures and tests."""
        if not self.initialized:
            return np.empty((0, 3)), np.empty(0)
        return self._particles.poses.copy(), self._particles.weights

    def add_odometry(self, odometry: OdometrySample, held: Held | None = None) -> None:
        """Take in odometry; samples that are not finite or not newer are counted and dropped.

        Args:
            odometry: the sample.
            held: the rates that were believed last, where it is in doubt.
        """
        if held is not None:
            self._calibration.distrust()
        believed = self._odometry.believed(odometry, held)
        corrected = self._calibration.correct(believed)
        if not self._history.append(corrected):
            self.counts["odometry_dropped"] += 1
        elif isfinite(odometry.lateral_mps):
            self._assessment.add_course(odometry, self._history.travelled_m(odometry.stamp_s))

    def add_fix(self, fix: GnssFix) -> None:
        """Take in a fix; those that are not finite or not newer are counted and dropped."""
        values = (fix.stamp_s, fix.east_m, fix.north_m, fix.hdop)
        if not np.isfinite(values).all() or fix.stamp_s <= self._recovery.search.newest_fix_s:
            self.counts["gnss_dropped"] += 1
            return
        self._recovery.search.add_fix(fix, self._history.odometry_pose(fix.stamp_s))
        self._fixes.add_fix(fix)

    def set_pose(self, stamp_s: float, pose: Floats, covariance: Floats) -> None:
        """Start from a known (or believed) rear-axle pose `(3,)` with covariance `(3, 3)`."""
        drawn = self._rng.multivariate_normal(
            np.asarray(pose), np.asarray(covariance), size=self._config.particles, method="cholesky"
        )
        self._particles.place_all(drawn, np.zeros(len(drawn)))
        self._stamp_s, self._travelled_m = stamp_s, self._history.travelled_m(stamp_s)
        self._pose = np.array(pose, dtype=np.float64)
        self._odometry_pose = self._history.odometry_pose(stamp_s)
        self._recovery.believe()
        self._assessment.persistent.start(np.asarray(covariance, dtype=np.float64))

    def exchange_map(self, pole_map: PoleMap | CityMap) -> None:
        """Hold the next scans against another map of the same frame; see `Localizer`."""
        self._window.exchange(pole_map)
        self._use_patterns(pole_map)

    def _use_patterns(self, pole_map: PoleMap | CityMap) -> None:
        patterns = patterns_of(pole_map, background=self._in_background)
        self._recovery.search.use_patterns(patterns, pole_map.frame)

    def process_scan(self, scan: Detections) -> PfEstimate | None:
        """Move to the scan's stamp, weigh, explore, estimate, resample.

        Returns:
            None while no position is known, and for a scan that is not newer than the last one.
        """
        # of other kinds the map says nothing
        scan = scan.of_kinds(*self._window.kinds or [LandmarkKind.POLE])
        stamp = scan.stamp_s
        if not np.isfinite(stamp) or stamp <= self._stamp_s:
            self.counts["scans_late"] += 1
            return None
        if self.initialized and stamp - self._stamp_s > _STALE_S:
            # nobody has looked for so long that odometry no longer reaches back: a new start
            self._particles = ParticleSet(self._config, self._wheelbase_m, self._rng)
            self._calibration.forget()
            self._noise.reset()
            self.counts["stale_restarts"] += 1
            self._recovery.search.forget_poles()
        odometry_pose = self._history.odometry_pose(stamp)
        travelled = self._history.travelled_m(stamp)
        if not self._window.whole:
            scan = self._mapped(scan, odometry_pose)
        known = self._assessment.corners.without_suspended(scan)
        self._recovery.search.add_scan(known, odometry_pose, travelled)
        event: Event | None = None
        if self.initialized:
            arcs = self._history.arcs(self._stamp_s, stamp, _ARC_S)
            held_before, held_after = (
                Held(s, *self._history.rates_at(s), turn_doubted=True)
                for s in (self._stamp_s, stamp)
            )
            if self._odometry.release(self._particles, arcs, held_before, held_after):
                self._recovery.search.forget_poles()
            followed = self._recovery.proof.proven and self._particles.motion is None
            if followed and self._config.odometry.faults:
                self._particles.faults.step(
                    stamp - self._stamp_s,
                    *demand(self._history, stamp),
                    suspect=self._odometry.suspect(stamp),
                )
            before = self._particles.rear
            self._particles.move_along(
                arcs, self._noise.factors if self._recovery.proof.proven else np.ones(3)
            )
            self._assessment.persistent.move(
                before, self._particles.rear, stamp - self._stamp_s,
                self._calibration.uncertainty(*self._history.rates_at(stamp)),
            )  # fmt: skip
            self._recovery.scatter(self._particles, stamp, travelled)
            share = counted_share(
                travelled - self._travelled_m, stamp - self._stamp_s, self._config.poles
            )
        else:
            if self._window.waiting:
                self.counts["scans_before_map"] += 1
                return None
            count = _START_FACTOR * self._config.particles
            drawn = self._recovery.search.draw_start(count, stamp, odometry_pose, self._rng)
            if len(drawn) == 0 or not self._window.opened_at(drawn):
                return None
            self._particles.place_all(drawn, np.zeros(len(drawn)))
            event, share = "initialized", _FIRST_SHARE
            if self._config.poles.scan_errors == "independent":
                share = 1.0
        step = Step(odometry_pose, travelled - self._travelled_m, stamp - self._stamp_s, travelled)
        self._stamp_s, self._travelled_m = stamp, travelled
        particles = self._particles
        particles.log_weights = self._fixes.weigh_by_fixes(
            particles.log_weights, particles.rear, stamp, self._history
        )
        used, before_scan = self._weigh_scan(scan, share)
        self._lines.weigh(
            particles, scan, step.moved_m, step.elapsed_s, self._assessment.persistent.covariance
        )
        if event is None:
            event = self._recovery.recover(particles, used, odometry_pose, self._scan_evidence)
            if event == "reinitialized":
                # a restart starts clean: what was learned at a wrong place is wrong
                self._calibration.forget()
                self._noise.reset()
        done = Weighed(
            used, event, step, particles, self._landmarks, self._used_share, before_scan,
            self._pose, self._odometry_pose, len(scan) - len(used),
        )  # fmt: skip
        estimate = self._assessment.estimate(done, self._history, self.correction)
        self._pose, self._odometry_pose = estimate.pose, odometry_pose
        particles.resample_by_weight(estimate.health.n_eff)
        self._recovery.inject(particles, used, odometry_pose)
        # what the poles correct teaches something only where the pose is sure
        self._trusted = estimate.healthy and estimate.health.position_sd_major_m < _SURE_SD_M
        if not self._trusted and estimate.usable and self._lines.hold:
            spread = self._assessment.particle_spread
            self._calibration.learn_from_pose(stamp, estimate.pose, spread, turn_only=True)
        elif not self._trusted:
            self._calibration.interrupt()
        elif estimate.health.matched >= 2:
            self._calibration.learn_from_pose(stamp, estimate.pose, self._assessment.learned_spread)
        return estimate

    def _mapped(self, scan: Detections, odometry_pose: Floats) -> Detections:
        """Have the map around the car; the scan without what stands where it is not known."""
        stamp = scan.stamp_s
        fix = self._recovery.search.newest_fix_m(stamp)
        places = [] if fix is None else [fix]
        if not self.initialized:
            self._window.follow(places, np.zeros(2))
            if not places:
                self.counts["scans_without_place"] += 1
            return scan
        pose = compose(self._pose, relative(self._odometry_pose, odometry_pose))
        speed_mps, _ = self._history.rates_at(stamp)
        velocity = rotate([speed_mps, 0.0], pose[2])
        self._window.follow([pose[:2], *places], velocity)
        return self._window.mapped(scan, pose)

    def _weigh_scan(self, scan: Detections, share: float) -> tuple[Detections, Floats]:
        """Weigh the particles; what of the scan did so, and their covariance `(3, 3)` before."""
        particles = self._particles
        rear, before = particles.rear, particles.weights
        self._landmarks = self._weigher.near(rear, scan)
        if LandmarkKind.CORNER in self._window.kinds:
            scan, self._landmarks = self._assessment.believed_part(
                scan, self._landmarks, particles, share
            )
        result = self._weigher.weigh(rear, scan, self._landmarks)
        expected = particles.moments
        particles.log_weights, self._used_share = tempered(
            particles.log_weights,
            result.log_likelihood,
            share,
            self._config.poles.effective_share_min * len(particles),
        )
        weighed = particles.moments
        steady = self._trusted and not self._odometry.doubted
        self._noise.add_correction(expected, weighed, self._used_share, steady)
        self._odometry.add_correction(scan.stamp_s, expected, weighed, trusted=self._trusted)
        self._scan_evidence = log_mean(result.log_likelihood, before)
        self._recovery.averages.add_quality(
            scan.stamp_s, self._recovery.quality(result, before, len(scan))
        )
        return scan, expected[1]
