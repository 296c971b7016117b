"""The particle filter: odometry, GNSS and pole scans to a pose, its covariance and its health."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivelog.samples import GnssFix, OdometrySample, PoleScan
from localize.calibration import OdometryCalibration
from localize.config import LocalizeConfig
from localize.constellation import Candidates, ConstellationIndex, PoleMemory
from localize.exploration import LikelihoodAverages, draw_poses, normalized_quality
from localize.gnss_alignment import GnssAlignment, GnssPose
from localize.health import HealthRecord, LostDetector
from localize.likelihood import (
    default_view,
    gnss_log_likelihood,
    independent_share,
    pole_model,
    tempered,
    weigh_scan,
)
from localize.motion_noise import sample_motion
from localize.odometry_history import OdometryHistory
from localize.particles import (
    Mode,
    effective_count,
    find_modes,
    mean_and_covariance,
    normalized,
    position_sd,
)
from localize.resampling import kld_count, low_variance_indices
from polemap.association import Landmarks, PoseLikelihoods, pole_log_likelihood
from polemap.landmark_map import PoleMap
from vehicle.pose import shift_forward, wrap_angle

Floats = NDArray[np.float64]

_NO_CANDIDATES = Candidates(np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty(0))


@dataclass(frozen=True, slots=True)
class PfEstimate:
    """What the filter says after a scan.

    Attributes:
        stamp_s, arrival_s: of the scan.
        pose: `(3,)` east, north, yaw of the rear axle in the map's frame.
        covariance: `(3, 3)`.
        healthy: whether the pose may be used: one mode, narrow, and poles that fit or are absent.
        modes: clusters of the cloud; above 1 the pose is one of several possible ones.
        health: the row of health.csv.
        event: "initialized", "reinitialized", "explored" or None.
    """

    stamp_s: float
    arrival_s: float
    pose: Floats
    covariance: Floats
    healthy: bool
    modes: int
    health: HealthRecord
    event: str | None


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
    ) -> None:
        self._map = pole_map
        self._config = config
        self._wheelbase_m = wheelbase_m
        self._rng = rng
        self._history = OdometryHistory(config.odometry_gap_s)
        self._calibration = OdometryCalibration(config)
        self._alignment = GnssAlignment(config)
        self._memory = PoleMemory()
        self._index = ConstellationIndex(pole_map)
        self._averages = LikelihoodAverages(config)
        self._lost = LostDetector(config)
        self._fixes: list[tuple[GnssFix, Floats]] = []
        self._last_fix_s: float | None = None
        self._poses: Floats | None = None
        self._log_weights = np.empty(0)
        self._stamp_s = -np.inf
        self._travelled_m = 0.0
        self._searched_s = -np.inf
        self._candidates = _NO_CANDIDATES
        self.counts: Counter[str] = Counter()

    @property
    def initialized(self) -> bool:
        """Whether there is a cloud yet."""
        return self._poses is not None

    @property
    def calibration(self) -> OdometryCalibration:
        """What was learned about the odometry."""
        return self._calibration

    def particles(self) -> tuple[Floats, Floats]:
        """Front-axle poses `(n, 3)` and weights `(n,)`, for pictures and tests."""
        if self._poses is None:
            return np.empty((0, 3)), np.empty(0)
        return self._poses.copy(), normalized(self._log_weights)[0]

    def predict(self, odometry: OdometrySample) -> None:
        """Take in odometry; samples that are not finite or not newer are counted and dropped."""
        corrected = self._calibration.correct(odometry)
        if not self._history.push(corrected):
            self.counts["odometry_dropped"] += 1

    def gnss(self, fix: GnssFix, antenna_m: Floats) -> None:
        """Take in a fix of the antenna at `(2,)` in the vehicle frame."""
        values = (fix.stamp_s, fix.east_m, fix.north_m, fix.hdop)
        if not np.isfinite(values).all() or fix.stamp_s <= self._alignment.newest_s:
            self.counts["gnss_dropped"] += 1
            return
        self._alignment.push(fix, antenna_m, self._history.dead_reckoning(fix.stamp_s))
        self._fixes.append((fix, np.asarray(antenna_m, dtype=np.float64)))
        del self._fixes[:-200]

    def set_pose(self, stamp_s: float, pose: Floats, covariance: Floats) -> None:
        """Start from a known (or believed) rear-axle pose `(3,)` with covariance `(3, 3)`."""
        drawn = self._rng.multivariate_normal(pose, covariance, size=self._config.particles)
        self._place(drawn, stamp_s)

    def update(self, scan: PoleScan) -> PfEstimate | None:
        """Move to the scan's stamp, weigh, estimate, explore, resample.

        Returns:
            None while no position is known, and for a scan older than the last one.
        """
        if not np.isfinite(scan.stamp_s) or scan.stamp_s <= self._stamp_s:
            self.counts["scans_late"] += 1
            return None
        reckoned = self._history.dead_reckoning(scan.stamp_s)
        travelled = self._history.travelled_m(scan.stamp_s)
        self._memory.push(scan, reckoned, travelled)
        event = None
        if self._poses is None:
            if not self._initialize(scan, reckoned):
                return None
            event = "initialized"
        else:
            self._move(scan.stamp_s)
        moved, elapsed = travelled - self._travelled_m, scan.stamp_s - self._stamp_s
        self._stamp_s, self._travelled_m = scan.stamp_s, travelled
        self._weigh_fixes(reckoned)
        share = 1.0 if event else independent_share(moved, elapsed, self._config)
        return self._measure(scan, reckoned, share, event)

    def _measure(
        self, scan: PoleScan, reckoned: Floats, share: float, event: str | None
    ) -> PfEstimate:
        config = self._config
        assert self._poses is not None
        rear = shift_forward(self._poses, -self._wheelbase_m)
        prior, _ = normalized(self._log_weights)
        result, landmarks = weigh_scan(rear, scan, self._map, config)
        self._log_weights, used = tempered(
            self._log_weights,
            result.log_likelihood,
            share,
            config.min_effective_share * len(rear),
        )
        weights, _ = normalized(self._log_weights)
        if len(scan) and (result.visible.max(initial=0) or result.matched.max(initial=0)):
            self._averages.update(normalized_quality(result, prior))
        n_eff = effective_count(weights)
        mean, covariance = mean_and_covariance(rear, weights)
        major, minor = position_sd(covariance)
        modes = self._modes(rear, weights, mean, covariance)
        pose, cov = mean, covariance
        if config.estimate == "best_mode" and modes and len(modes) > 1:
            pose, cov = modes[0].mean, modes[0].covariance
        fit = self._at_estimate(pose, scan, landmarks)
        matched, in_view = int(fit.matched[0]), int(fit.visible[0])
        lost = self._lost.update(
            scan.stamp_s, matched, len(scan), in_view, float(np.sqrt(major * minor))
        )
        explored = 0
        if lost and self._initialize(scan, reckoned):
            event = "reinitialized"
            self.counts["reinitializations"] += 1
        elif event is None:
            explored = self._explore(reckoned, scan.stamp_s)
            if explored:
                event = "explored"
                self.counts["exploration_events"] += 1
        count = len(weights)
        if event != "reinitialized" and not explored:
            self._resample(n_eff)
        few_fit = self._lost.match_share < config.lost_match_share
        best_share = modes[0].share if modes else 0.0
        healthy = (
            major <= config.healthy_sd_m
            and len(modes) == 1
            and not few_fit
            and event not in ("initialized", "reinitialized")
        )
        held = healthy and matched >= 2 and major < 0.5
        self._calibration.learn(scan.stamp_s, pose, cov, held)
        health = HealthRecord(
            stamp_s=scan.stamp_s,
            matched=matched,
            seen=len(scan),
            in_view=in_view,
            n_eff=n_eff,
            position_sd_major_m=major,
            position_sd_minor_m=minor,
            exploration_ratio=explored / count,
            lag_s=scan.arrival_s - scan.stamp_s,
            particles=count,
            match_share=self._lost.match_share,
            modes=len(modes),
            mode_share=best_share,
            evidence_share=used,
            yaw_rate_offset_radps=self._calibration.yaw_rate_offset_radps,
            speed_scale=self._calibration.speed_scale,
        )
        return PfEstimate(
            scan.stamp_s, scan.arrival_s, pose, cov, healthy, len(modes), health, event
        )

    def _move(self, stamp_s: float) -> None:
        assert self._poses is not None
        arcs = self._history.arcs(self._stamp_s, stamp_s, self._config.arc_s)
        moved = sample_motion(self._poses, arcs, self._wheelbase_m, self._config, self._rng)
        moved[:, 2] = wrap_angle(moved[:, 2])
        self._poses = moved

    def _weigh_fixes(self, reckoned: Floats) -> None:
        """Weigh by the fixes up to now; later ones wait for the next scan."""
        assert self._poses is not None
        due = [entry for entry in self._fixes if entry[0].stamp_s <= self._stamp_s]
        self._fixes = [entry for entry in self._fixes if entry[0].stamp_s > self._stamp_s]
        rear = None
        for fix, antenna in due:
            last, self._last_fix_s = self._last_fix_s, fix.stamp_s
            if last is None or self._stamp_s - fix.stamp_s > self._config.gnss_max_age_s:
                continue
            # fixes share one slowly wandering error: their information grows with time, not number
            share = min(1.0, (fix.stamp_s - last) / (2.0 * self._config.gnss_correlation_s))
            rear = shift_forward(self._poses, -self._wheelbase_m) if rear is None else rear
            moved = _relative(reckoned, self._history.dead_reckoning(fix.stamp_s))
            self._log_weights = self._log_weights + share * gnss_log_likelihood(
                rear, fix, antenna, moved, self._config
            )

    def _modes(self, rear: Floats, weights: Floats, mean: Floats, covariance: Floats) -> list[Mode]:
        """A narrow cloud is one mode, which needs no search."""
        config = self._config
        major, _ = position_sd(covariance)
        if (
            major < 0.4 * config.mode_radius_m
            and covariance[2, 2] < (0.4 * config.mode_radius_rad) ** 2
        ):
            return [Mode(1.0, mean, covariance)]
        return find_modes(
            rear,
            weights,
            radius_m=config.mode_radius_m,
            radius_rad=config.mode_radius_rad,
            share_min=config.mode_share_min,
        )

    def _at_estimate(self, pose: Floats, scan: PoleScan, landmarks: Landmarks) -> PoseLikelihoods:
        view = scan.view if scan.view is not None else default_view(self._config)
        return pole_log_likelihood(
            pose[np.newaxis], scan, landmarks, pole_model(self._config), view=view
        )

    def _resample(self, n_eff: float) -> None:
        assert self._poses is not None
        config = self._config
        weights, _ = normalized(self._log_weights)
        count = config.particles
        if config.kld_adaptive:
            count = kld_count(
                self._poses,
                weights,
                bin_m=config.kld_bin_m,
                bin_rad=config.kld_bin_rad,
                error=config.kld_error,
                quantile=config.kld_quantile,
                least=config.kld_particles_min,
                most=config.kld_particles_max,
            )
        if n_eff >= config.resample_below * len(weights) and len(weights) == config.particles:
            return
        chosen = low_variance_indices(weights, count, self._rng)
        self._poses = self._poses[chosen]
        self._log_weights = np.zeros(count)

    def _gnss_pose(self, reckoned: Floats, stamp_s: float) -> GnssPose | None:
        if stamp_s - self._alignment.newest_s > self._config.gnss_max_age_s:
            return None
        return self._alignment.pose(reckoned)

    def _search(self, reckoned: Floats, stamp_s: float, gnss: GnssPose | None) -> Candidates:
        """Constellation matches, searched at most every `constellation_interval_s`."""
        config = self._config
        if stamp_s - self._searched_s < config.constellation_interval_s:
            return _NO_CANDIDATES
        self._searched_s = stamp_s
        reach = np.inf
        if gnss is not None:
            reach = max(config.constellation_reach_m, 3.0 * position_sd(gnss.covariance)[0])
        return self._index.find(
            self._memory.around(reckoned),
            tolerance_m=config.constellation_tolerance_m,
            min_poles=config.constellation_min_poles + (gnss is None),
            rng=self._rng,
            centre_m=None if gnss is None else gnss.pose[:2],
            reach_m=float(reach),
        )

    def _initialize(self, scan: PoleScan, reckoned: Floats) -> bool:
        """Spread the particles where GNSS and the constellation of poles allow; False if neither
        says anything."""
        gnss = self._gnss_pose(reckoned, scan.stamp_s)
        candidates = self._search(reckoned, scan.stamp_s, gnss)
        drawn = draw_poses(self._config.particles, gnss, candidates, self._rng)
        if len(drawn) == 0:
            return False
        self._place(drawn, scan.stamp_s)
        return True

    def _place(self, rear: Floats, stamp_s: float) -> None:
        self._poses = shift_forward(rear, self._wheelbase_m)
        self._poses[:, 2] = wrap_angle(self._poses[:, 2])
        self._log_weights = np.zeros(len(rear))
        self._stamp_s = stamp_s
        self._travelled_m = self._history.travelled_m(stamp_s)
        self._averages.reset()
        self._lost.reset()

    def _explore(self, reckoned: Floats, stamp_s: float) -> int:
        """Replace a share of the particles when the likelihood has fallen; how many."""
        assert self._poses is not None
        share = self._averages.share
        wanted = int(share * len(self._poses))
        if wanted == 0 or stamp_s - self._searched_s < self._config.constellation_interval_s:
            return 0
        gnss = self._gnss_pose(reckoned, stamp_s)
        drawn = draw_poses(wanted, gnss, self._search(reckoned, stamp_s, gnss), self._rng)
        if len(drawn) == 0:
            return 0
        weights, _ = normalized(self._log_weights)
        kept = low_variance_indices(weights, len(self._poses) - len(drawn), self._rng)
        added = shift_forward(drawn, self._wheelbase_m)
        self._poses = np.vstack([self._poses[kept], added])
        self._poses[:, 2] = wrap_angle(self._poses[:, 2])
        self._log_weights = np.zeros(len(self._poses))
        return len(drawn)


def _relative(start: Floats, end: Floats) -> Floats:
    """Motion `(3,)` from one dead-reckoned pose to another, in the axes of the first."""
    c, s = np.cos(start[2]), np.sin(start[2])
    dx, dy = end[0] - start[0], end[1] - start[1]
    return np.array([c * dx + s * dy, -s * dx + c * dy, end[2] - start[2]])
