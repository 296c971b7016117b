"""The particle filter: odometry, GNSS and pole scans to a pose, its covariance and its health."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import GnssFix, OdometrySample, PoleScan
from polemap.localize.calibration import OdometryCalibration, OdometryCorrection
from polemap.localize.config import LocalizeConfig
from polemap.localize.gnss.particle_weights import FixWeights
from polemap.localize.gnss.receiver import GnssReceiver
from polemap.localize.odometry_history import OdometryHistory
from polemap.localize.particle_filter.cloud import Cloud
from polemap.localize.particle_filter.estimate import Event, PfEstimate
from polemap.localize.particle_filter.exploration import LikelihoodAverages, normalized_quality
from polemap.localize.particle_filter.health import HealthRecord, LostDetector
from polemap.localize.particle_filter.noise_scale import NoiseScale
from polemap.localize.particle_filter.particles import (
    effective_count,
    log_mean,
    mean_and_covariance,
    modes_of,
    position_sd,
)
from polemap.localize.particle_filter.pole_model import Landmarks
from polemap.localize.particle_filter.relocation import Relocation, Verdict
from polemap.localize.particle_filter.sensor_model import (
    Match,
    PoleWeigher,
    independent_share,
    tempered,
)
from polemap.localize.particle_filter.start_proof import PROVEN_SD_M, StartProof
from polemap.map.landmark_map import PoleMap

Floats = NDArray[np.float64]
_RESTART_SHARE = 0.75
_FIRST_SHARE = 0.2
_DOUBT_INTERVALS = 4.0
_SURE_SD_M = 0.5
# so many times more particles where the place is not known yet
_START_FACTOR = 4
# samples of the odometry are joined to arcs up to this length, three at 50 Hz: noise is drawn once
# for each
_ARC_S = 0.06
# share of the particles that must stay effective when a sharp scan meets wide-spread particles
_MIN_EFFECTIVE_SHARE = 0.03


@dataclass(frozen=True, slots=True)
class _Step:
    """Dead-reckoned pose `(3,)` at a scan, and the way and time since the last one."""

    reckoned: Floats
    moved_m: float
    elapsed_s: float


class ParticleFilter:
    """Monte Carlo localization in a pole map; the state is (E, N, yaw) of the front axle.

    The filter lives at the stamp of the last scan. Odometry and fixes are kept until a scan comes,
    however late, and the particles are then moved exactly to its stamp. The same samples and the
    same generator give the same poses, bit for bit.

    Source: Spangenberg (2016), section IV.
    """

    def __init__(
        self,
        pole_map: PoleMap,
        config: LocalizeConfig,
        wheelbase_m: float,
        rng: np.random.Generator,
        *,
        receiver: GnssReceiver | None = None,
    ) -> None:
        receiver = receiver or GnssReceiver(config=config.gnss)
        self._weigher = PoleWeigher(pole_map, config)
        self._landmarks = Landmarks.of(pole_map, config.p_detection)
        self._config = config
        self._rng = rng
        self._history = OdometryHistory(config.odometry.slip_rad_per_mps2)
        self._calibration = OdometryCalibration(config.odometry)
        self._noise = NoiseScale(config.odometry)
        self._relocation = Relocation(pole_map, config.recovery, receiver)
        self._averages = LikelihoodAverages(config.recovery.explore_share_max)
        self._lost = LostDetector(config.recovery)
        self._fixes = FixWeights(receiver)
        self._cloud = Cloud(config, wheelbase_m, rng)
        self._stamp_s = -np.inf
        self._travelled_m = 0.0
        self._scan_evidence = 0.0
        self._used_share = 0.0
        self._explored_share = 0.0
        self._proof = StartProof(config.recovery)
        self._trusted = False
        self.counts: Counter[str] = Counter()

    @property
    def initialized(self) -> bool:
        """Whether there is a cloud yet."""
        return len(self._cloud) > 0

    @property
    def correction(self) -> OdometryCorrection:
        """What was learned about the odometry."""
        return self._calibration.correction

    @property
    def slip_rad_per_mps2(self) -> float:
        """Outward slip of the rear axle per lateral acceleration, as the cloud guesses it."""
        if not self.initialized:
            return self._config.odometry.slip_rad_per_mps2
        return self._cloud.slip_rad_per_mps2

    def particles(self) -> tuple[Floats, Floats]:
        """Front-axle poses `(n, 3)` and weights `(n,)`, for pictures and tests."""
        if not self.initialized:
            return np.empty((0, 3)), np.empty(0)
        return self._cloud.poses.copy(), self._cloud.weights

    def predict(self, odometry: OdometrySample) -> None:
        """Take in odometry; samples that are not finite or not newer are counted and dropped."""
        corrected = self._calibration.correct(odometry)
        if not self._history.append(corrected):
            self.counts["odometry_dropped"] += 1

    def add_fix(self, fix: GnssFix) -> None:
        """Take in a fix; those that are not finite or not newer are counted and dropped."""
        values = (fix.stamp_s, fix.east_m, fix.north_m, fix.hdop)
        if not np.isfinite(values).all() or fix.stamp_s <= self._relocation.newest_fix_s:
            self.counts["gnss_dropped"] += 1
            return
        self._relocation.add_fix(fix, self._history.odometry_pose(fix.stamp_s))
        self._fixes.add_fix(fix)

    def set_pose(self, stamp_s: float, pose: Floats, covariance: Floats) -> None:
        """Start from a known (or believed) rear-axle pose `(3,)` with covariance `(3, 3)`."""
        drawn = self._rng.multivariate_normal(
            np.asarray(pose), np.asarray(covariance), size=self._config.particles, method="cholesky"
        )
        self._cloud.place(drawn, np.zeros(len(drawn)))
        self._stamp_s, self._travelled_m = stamp_s, self._history.travelled_m(stamp_s)
        self._averages.reset()
        self._lost.reset()
        self._proof.believe()

    def update(self, scan: PoleScan) -> PfEstimate | None:
        """Move to the scan's stamp, weigh, explore, estimate, resample.

        Returns:
            None while no position is known, and for a scan that is not newer than the last one.
        """
        stamp = scan.stamp_s
        if not np.isfinite(stamp) or stamp <= self._stamp_s:
            self.counts["scans_late"] += 1
            return None
        reckoned = self._history.odometry_pose(stamp)
        travelled = self._history.travelled_m(stamp)
        self._relocation.add_scan(scan, reckoned, travelled)
        event: Event | None = None
        if self.initialized:
            arcs = self._history.arcs(self._stamp_s, stamp, _ARC_S)
            self._cloud.move(arcs, self._noise.factors if self._proof.proven else np.ones(3))
            share = independent_share(
                travelled - self._travelled_m, stamp - self._stamp_s, self._config.poles
            )
        else:
            count = _START_FACTOR * self._config.particles
            drawn = self._relocation.start(count, stamp, reckoned, self._rng)
            if len(drawn) == 0:
                return None
            self._cloud.place(drawn, np.zeros(len(drawn)))
            event, share = "initialized", _FIRST_SHARE
        step = _Step(reckoned, travelled - self._travelled_m, stamp - self._stamp_s)
        self._stamp_s, self._travelled_m = stamp, travelled
        cloud = self._cloud
        cloud.log_weights = self._fixes.weigh_by_fixes(
            cloud.log_weights, cloud.rear, stamp, self._history
        )
        self._weigh_scan(scan, share)
        if event is None:
            event = self._recover(scan, reckoned)
        estimate = self._estimate(scan, event, step)
        cloud.resample(estimate.health.n_eff)
        # what the poles correct teaches something only where the pose is sure
        self._trusted = estimate.healthy and estimate.health.position_sd_major_m < _SURE_SD_M
        held = self._trusted and estimate.health.matched >= 2
        self._calibration.learn_from_pose(stamp, estimate.pose, estimate.covariance, held)
        return estimate

    def _weigh_scan(self, scan: PoleScan, share: float) -> None:
        cloud = self._cloud
        rear, before = cloud.rear, cloud.weights
        self._landmarks = self._weigher.near(rear, scan)
        result = self._weigher.weigh(rear, scan, self._landmarks)
        expected = mean_and_covariance(rear, before)
        cloud.log_weights, self._used_share = tempered(
            cloud.log_weights,
            result.log_likelihood,
            share,
            _MIN_EFFECTIVE_SHARE * len(cloud),
        )
        weighed = mean_and_covariance(rear, cloud.weights)
        self._noise.add(expected, weighed, self._used_share, self._trusted)
        self._scan_evidence = log_mean(result.log_likelihood, before)
        self._averages.update(scan.stamp_s, normalized_quality(result, before, len(scan)))

    def _recover(self, scan: PoleScan, reckoned: Floats) -> Event | None:
        """Start anew when lost, explore when the likelihood has fallen."""
        self._explored_share = 0.0
        total = len(self._cloud)
        if self._proof.contradicted:
            return self._begin_elsewhere(scan, reckoned)
        if self._lost.lost and self._relocation.rested(scan.stamp_s):
            # where poles just do not fit, the map may have changed: the old cloud keeps a part
            elsewhere = self._lost.scattered or self._lost.astray
            if not self._restart(1.0 if elsewhere else _RESTART_SHARE, scan, reckoned):
                return None
            self.counts["reinitializations"] += 1
            return "reinitialized"
        wanted = round(self._averages.share * total)
        if wanted == 0 or len(scan) < 2 or not self._relocation.rested(scan.stamp_s):
            return None
        drawn = self._relocation.draw(wanted, scan.stamp_s, reckoned, self._rng)
        if len(drawn) == 0:
            return None
        # newcomers have passed no scan yet: they count by how they stand this one beside the others
        result = self._weigher.weigh(drawn, scan)
        self._mix_in(drawn, np.minimum(result.log_likelihood - self._scan_evidence, 0.0))
        self.counts["exploration_events"] += 1
        return "explored"

    def _begin_elsewhere(self, scan: PoleScan, reckoned: Floats) -> Event | None:
        """The poles of the last metres fit clearly better at another place."""
        if not self._restart(_RESTART_SHARE, scan, reckoned):
            return None
        if self._proof.proven:
            self.counts["reinitializations"] += 1
            return "reinitialized"
        self.counts["start_corrections"] += 1
        return "initialized"

    def _restart(self, share: float, scan: PoleScan, reckoned: Floats) -> bool:
        """Let a share of the cloud start anew; whether there was anywhere to start."""
        count = round(share * len(self._cloud))
        drawn = self._relocation.draw(count, scan.stamp_s, reckoned, self._rng)
        if len(drawn) == 0:
            return False
        self._mix_in(drawn, np.zeros(len(drawn)))
        self._averages.reset()
        self._lost.reset()
        return True

    def _mix_in(self, rear: Floats, log_weights: Floats) -> None:
        """Let poses take the places of as many particles."""
        self._explored_share = len(rear) / len(self._cloud)
        self._cloud.mix_in(rear, log_weights)

    def _estimate(self, scan: PoleScan, event: Event | None, step: _Step) -> PfEstimate:
        config = self._config
        rear, weights = self._cloud.rear, self._cloud.weights
        mean, covariance = mean_and_covariance(rear, weights)
        major, minor = position_sd(covariance)
        modes = modes_of(rear, weights, mean, covariance)
        pose, spread = mean, covariance
        if config.estimate == "best_mode" and modes:
            # also where the others are too light to count: they would still pull the mean
            pose, spread = modes[0].mean, modes[0].covariance
        fit = self._weigher.match(pose, scan, self._landmarks)
        self._lost.update(
            scan.stamp_s,
            fit.matched,
            len(scan),
            fit.expected,
            float(np.sqrt(major * minor)),
            self._fixes.distance_sd(pose, spread),
        )
        if event in ("initialized", "reinitialized"):
            self._proof.begin()
        else:
            narrow = len(modes) == 1 and major <= PROVEN_SD_M
            self._prove(scan, fit, pose, step, narrow=narrow)
        settled = self._proof.proven and len(modes) == 1
        healthy = settled and major <= config.health.sd_max_m and self._lost.fits
        health = HealthRecord(
            stamp_s=scan.stamp_s,
            matched=fit.matched,
            seen=len(scan),
            in_view=fit.in_view,
            n_eff=effective_count(weights),
            position_sd_major_m=major,
            position_sd_minor_m=minor,
            exploration_ratio=self._explored_share,
            lag_s=scan.arrival_s - scan.stamp_s,
            particles=len(rear),
            match_share=self._lost.match_share,
            modes=len(modes),
            mode_share=modes[0].share if modes else 0.0,
            evidence_share=self._used_share,
            yaw_rate_offset_radps=self.correction.yaw_rate_offset_radps,
            speed_scale=self.correction.speed_scale,
        )
        return PfEstimate(
            scan.stamp_s, scan.arrival_s, pose, spread, healthy, len(modes), health, event
        )

    def _prove(
        self, scan: PoleScan, fit: Match, pose: Floats, step: _Step, *, narrow: bool
    ) -> None:
        """Ask the last metres' constellation while the place is not proven, or in doubt again."""
        proof = self._proof
        proof.see(fit.matched, len(scan), step.elapsed_s)
        verdict: Verdict = "open"
        if not proof.proven or proof.in_doubt:
            intervals = _DOUBT_INTERVALS if proof.proven else 1.0
            if self._relocation.rested(scan.stamp_s, intervals):
                verdict = self._relocation.verify(
                    pose, scan.stamp_s, step.reckoned, self._rng, proven=proof.proven
                )
        proof.add(
            verdict,
            narrow=narrow,
            matched=fit.matched,
            possible=min(float(len(scan)), fit.expected),
            moved_m=step.moved_m,
        )
