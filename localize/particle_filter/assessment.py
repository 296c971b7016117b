"""After a scan is weighed: the pose to hand on, what is stated of it, and whether it is healthy."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import POINT_KINDS, LandmarkKind
from polemap.drivelog.samples import OdometrySample
from polemap.localize.calibration import OdometryCorrection
from polemap.localize.config import LocalizeConfig
from polemap.localize.gnss.particle_weights import FixWeights
from polemap.localize.odometry_history import OdometryHistory
from polemap.localize.particle_filter.corner_trust import CornerTrust, without_corners
from polemap.localize.particle_filter.detector_trust import DetectorTrust
from polemap.localize.particle_filter.estimate import (
    Event,
    HealthRecord,
    KindHealth,
    LineHealth,
    Mode,
    PfEstimate,
    best_pose,
    modes_of,
    position_sd,
)
from polemap.localize.particle_filter.health import PROVEN_SD_M
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.localize.particle_filter.line_evidence import LineEvidence
from polemap.localize.particle_filter.line_modes import ridge_modes
from polemap.localize.particle_filter.odometry_trust import OdometryTrust
from polemap.localize.particle_filter.particles import ParticleSet, effective_count
from polemap.localize.particle_filter.persistent_errors import PersistentErrors, at_least
from polemap.localize.particle_filter.pole_weigher import Match, PoleWeigher, independent_share
from polemap.localize.particle_filter.recovery import Recovery, Step
from polemap.localize.particle_filter.twins import TwinPoles
from polemap.vehicle.pose import transform_points

Floats = NDArray[np.float64]

# a place that is known along the street no better than this is none, however well it is known aside
_RIDGE_MAX_M = 5.0
# after so long a way without a pole what it put aside is put right by the lines
_LINES_ALONE_M = 30.0


@dataclass(frozen=True, slots=True)
class Weighed:
    """What a scan has left: its event and step, the particles after it, poses of the one before.

    Attributes:
        share: power that the scan's likelihood was raised to.
        before: `(3, 3)` covariance of the particles before that.
        last_pose, last_odometry_pose: of the last estimate.
        left_out: corners that were seen and are not believed.
    """

    scan: Detections
    event: Event | None
    step: Step
    particles: ParticleSet
    landmarks: Landmarks
    share: float
    before: Floats
    last_pose: Floats
    last_odometry_pose: Floats
    left_out: int = 0

    @property
    def restarted(self) -> bool:
        """Whether the particles were just drawn at a new place."""
        return self.event in ("initialized", "reinitialized")


class Assessment:
    """Estimates a pose of weighed particles and judges it: place, odometry and detector.

    Each of them may be why poles do not fit; which one is told by when it happened and by what the
    others have proven.
    """

    def __init__(
        self, config: LocalizeConfig, weigher: PoleWeigher, recovery: Recovery, fixes: FixWeights,
        odometry: OdometryTrust, twins: TwinPoles, lines: LineEvidence, counts: Counter[str],
    ) -> None:  # fmt: skip
        self._config, self._counts = config, counts
        self._weigher, self._recovery, self._fixes = weigher, recovery, fixes
        self._odometry, self._twins, self._lines = odometry, twins, lines
        self._detector = DetectorTrust(config, counts)
        self.corners = CornerTrust(counts)
        self._point_kinds = sorted(int(kind) for kind in POINT_KINDS & config.chosen_kinds)
        self.persistent = PersistentErrors(config.poles.position_floor_m)
        # what the odometry's calibration learns by: without what is only suspected
        self.learned_spread: Floats = np.eye(3)
        # of the particles alone
        self.particle_spread: Floats = np.eye(3)
        self._matched_m = np.inf  # way since a pole was

    def add_course(self, odometry: OdometrySample, travelled_m: float) -> None:
        """Take in which way the car goes in the eyes of its detector; see `DetectorCourse`."""
        self._detector.check.course.add_step(odometry, travelled_m)

    def believed_part(
        self, scan: Detections, landmarks: Landmarks, particles: ParticleSet, share: float
    ) -> tuple[Detections, Landmarks]:
        """What of a scan and of the landmarks around may move the particles."""
        pose, spread = particles.moments
        floor_m, stated = self._config.poles.position_floor_m, self.persistent.covariance
        if self.corners.believed(scan, landmarks, pose, spread, stated, share, floor_m):
            return scan, landmarks
        return without_corners(scan), landmarks.take(landmarks.kind != LandmarkKind.CORNER)

    def estimate(
        self, done: Weighed, history: OdometryHistory, correction: OdometryCorrection
    ) -> PfEstimate:
        """The pose after a scan, its covariance and its health."""
        scan, particles = done.scan, done.particles
        pose, spread, modes, major, minor = self._pose(particles)
        self.particle_spread = spread
        fit = self._weigher.match(pose, scan, done.landmarks)
        spread, stated_m, lines = self._stated(done, fit, pose, spread, major)
        self._recovery.lost.add_match(
            scan.stamp_s,
            fit.poles.matched,
            len(fit.poles.assignment),
            fit.poles.expected,
            float(np.sqrt(major * minor)),
            self._fixes.distance_sd(pose, spread),
            held=self._recovery.held(scan.stamp_s),
        )
        narrow = len(modes) == 1 and major <= PROVEN_SD_M
        unmatched, held = self._judge_place(done, fit, pose, major, narrow=narrow)
        self._check_detector(done, pose, history, narrow=narrow, held=held)
        hint_m, hint_rad = self._detector.check.calibration_sd
        self.learned_spread = spread
        self._matched_m = 0.0 if fit.matched else self._matched_m + done.step.moved_m
        if hint_m > 0.0 and self._config.covariance != "particles":
            # stated, but nothing that is learned from the pose
            spread = spread + self._hinted(hint_m, hint_rad, pose)
        opinion = self._odometry.opinion(particles, fit.matched, done.step.elapsed_s)
        if opinion == "contradicted" and held:
            self._detector.odometry_contradicts()
        elif not self._recovery.strange.contradict and self._recovery.proof.proven:
            self._detector.place_proven(pose, done.step)
        limit_m = self._config.health.sd_max_m
        self._judge_lines(done, lines, minor, major, len(modes))
        self._judge_corners(done, fit, narrow=narrow)
        settled = self._recovery.proof.proven and len(modes) == 1
        found = major <= limit_m and self.corners.found
        known = found or (self._lines.hold and minor <= PROVEN_SD_M)
        usable = settled and known and self._recovery.lost.fits and not unmatched
        usable = usable and not (self._lines.trust.doubted or self.corners.doubted)
        healthy = usable and found
        healthy = healthy and not self._odometry.doubted and opinion != "contradicted"
        healthy &= self._detector.believed and not self._recovery.far_from_fixes
        healthy &= bool(np.hypot(stated_m, hint_m) <= limit_m)
        health = HealthRecord(
            stamp_s=scan.stamp_s,
            matched=fit.matched,
            seen=len(scan) + done.left_out,
            in_view=fit.in_view,
            n_eff=effective_count(particles.weights),
            position_sd_major_m=major,
            position_sd_minor_m=minor,
            exploration_ratio=self._recovery.explored_share,
            lag_s=scan.arrival_s - scan.stamp_s,
            particles=len(particles),
            match_share=self._recovery.lost.match_share,
            modes=len(modes),
            mode_share=modes[0].share if modes else 0.0,
            evidence_share=done.share,
            yaw_rate_offset_radps=correction.yaw_rate_offset_radps,
            speed_scale=correction.speed_scale,
            lines=lines,
            by_kind=self._by_kind(done, fit, pose, lines),
        )
        return PfEstimate(
            scan.stamp_s, scan.arrival_s, pose, spread, healthy, len(modes), health, done.event,
            usable, opinion, self._detector.reason,
        )  # fmt: skip

    def _hinted(self, hint_m: float, hint_rad: float, pose: Floats) -> Floats:
        """Covariance `(3, 3)` of what a detector that may be wrong moves the pose by."""
        if self._lines.hold and self._matched_m > _LINES_ALONE_M:
            # a turned camera turns lines about the car, and does not put them aside
            along = hint_m * np.array([np.cos(pose[2]), np.sin(pose[2]), 0.0])
            return np.outer(along, along) + np.diag([0.0, 0.0, hint_rad**2])
        return np.diag([hint_m**2, hint_m**2, hint_rad**2])

    def _pose(self, particles: ParticleSet) -> tuple[Floats, Floats, list[Mode], float, float]:
        """Pose, covariance, modes, and the larger and smaller deviation of position."""
        rear, weights = particles.rear, particles.weights
        mean, covariance = particles.moments
        major, minor = position_sd(covariance)
        find = ridge_modes if self._lines.in_use else modes_of
        modes = find(rear, weights, mean, covariance)
        pose, spread = mean, covariance
        particles_alone = self._config.covariance == "particles"
        if self._config.estimate == "best_mode" and modes:
            pose, spread = best_pose(mean, covariance, modes)
        twins = self._twins.offset_at(pose[:2])
        if twins.any() and not particles_alone:
            # of two places as far apart as the map's two surveys nobody knows which
            spread = spread.copy()
            spread[:2, :2] += np.outer(twins, twins)
            major = float(np.hypot(major, np.hypot(*twins)))
        if self._recovery.proof.proven and not particles_alone:
            spread = spread.copy()
            spread[:2, :2] += self._recovery.strange.map_sd_m**2 * np.eye(2)
        return pose, spread, modes, major, minor

    def _stated(
        self, done: Weighed, fit: Match, pose: Floats, spread: Floats, major: float
    ) -> tuple[Floats, float, LineHealth | None]:
        """Covariance that is nowhere below what errors that stay with the landmarks leave, the
        larger deviation of position, and what the lines matched."""
        if self._config.covariance == "particles":
            return spread, major, self._lines.assess(pose, None)
        if done.event == "initialized":
            self.persistent.start(done.before)
        self.persistent.add_fixes(done.before, self._fixes.information_per_m2)
        self.persistent.add_scan(
            done.before, done.scan, done.landmarks, pose, fit.assignment, done.share
        )
        lines = self._lines.assess(pose, self.persistent)
        if done.event == "reinitialized":
            self.persistent.start(spread)
        stated = at_least(spread, self.persistent.covariance)
        if stated is spread:
            return spread, major, lines
        return stated, max(major, position_sd(stated)[0]), lines

    def _judge_lines(
        self, done: Weighed, lines: LineHealth | None, minor: float, major: float, modes: int
    ) -> None:
        """What lines say of the place, and poles of the lines."""
        if lines is None:
            return
        if done.restarted:
            self._lines.trust.forget()
        elif self._recovery.held_anew(done.scan.stamp_s):
            self._lines.trust.confirm()
        one = modes == 1 and minor <= PROVEN_SD_M and major <= _RIDGE_MAX_M
        if not self._lines.trust.doubted:
            self._recovery.proof.add_lines(
                one_place=one, seen=lines.seen, matched=lines.matched, moved_m=done.step.moved_m
            )

    def _judge_corners(self, done: Weighed, fit: Match, *, narrow: bool) -> None:
        """What corners say of the place, and poles of the corners."""
        if fit.without_corners is None and not self.corners.suspended:
            return
        if done.restarted:
            self.corners.forget()
            return
        rows = fit.assignment[fit.assignment >= 0]
        ids, kinds = done.landmarks.ids[rows], done.landmarks.kind[rows]
        corner = kinds == LandmarkKind.CORNER
        self.corners.add_matched(
            done.scan.stamp_s,
            ids[~corner],
            ids[corner],
            independent_share(done.step.moved_m, done.step.elapsed_s, self._config.poles),
            contradicted=self._recovery.strange.contradict,
        )
        if not (self.corners.suspended or self.corners.doubted):
            self._recovery.proof.add_corners(
                narrow=narrow,
                seen=int(np.count_nonzero(done.scan.kind == LandmarkKind.CORNER)),
                matched=int(np.count_nonzero(corner)),
                moved_m=done.step.moved_m,
            )

    def _by_kind(
        self, done: Weighed, fit: Match, pose: Floats, lines: LineHealth | None
    ) -> tuple[KindHealth, ...]:
        """What the scan has shown of every kind."""
        scan, landmarks = done.scan, done.landmarks
        mine = np.flatnonzero(fit.assignment >= 0)
        seen_m = transform_points(pose, scan.points_vehicle_m.reshape(-1, 2)[mine])
        offset = seen_m - landmarks.points_m[fit.assignment[mine]]
        squared_m2 = (offset**2).sum(axis=1)
        out = []
        for kind in self._point_kinds:
            rows, here = scan.kind[mine] == kind, scan.kind == kind
            suspended = kind == LandmarkKind.CORNER and self.corners.suspended
            seen = int(here.sum()) + (done.left_out if kind == LandmarkKind.CORNER else 0)
            # a scan holds no kind that the whole map lacks
            if seen or suspended or kind == LandmarkKind.POLE or (landmarks.kind == kind).any():
                out.append(
                    KindHealth(
                        kind, seen, int(rows.sum()), suspended, float(squared_m2[rows].sum())
                    )
                )
        return (*out, *(lines.by_kind if lines is not None else ()))

    def _judge_place(
        self, done: Weighed, fit: Match, pose: Floats, major: float, *, narrow: bool
    ) -> tuple[bool, bool]:
        """Whether poles contradict the place, and whether poles have held the pose lately."""
        scan, step, recovery = done.scan, done.step, self._recovery
        # corners that do not fit accuse their map (`CornerTrust`), and a few that do prove nothing
        poles, seen = fit.poles, len(fit.poles.assignment)
        if done.restarted:
            recovery.proof.begin()
        else:
            recovery.prove(scan.stamp_s, poles, pose, step, narrow=narrow)
        possible = max(min(float(seen), poles.expected), float(poles.matched))
        unmatched = recovery.unmatched.contradict(scan.stamp_s, poles.matched, possible)
        # where no pole has held the pose lately, one that fails says nothing of the detector
        held = recovery.held_anew(scan.stamp_s)
        independent = independent_share(step.moved_m, step.elapsed_s, self._config.poles)
        strange = recovery.strange
        if done.event is None:
            before = strange.contradict
            corners = 0 if self.corners.doubted else fit.matched - poles.matched
            recovery.add_held(scan.stamp_s, poles.matched, independent, major, corners=corners)
            strange.add_scan(
                poles.matched, seen, poles.misfit, independent, mapped=poles.in_view > 0
            )
            if strange.contradict and not before:
                self._counts["poles_contradict"] += 1
                recovery.proof.doubt()
                if held:
                    self._detector.poles_contradict(
                        done.last_pose, done.last_odometry_pose, step.travelled_m
                    )
        return unmatched or strange.contradict, held

    def _check_detector(
        self, done: Weighed, pose: Floats, history: OdometryHistory, *, narrow: bool, held: bool
    ) -> None:
        if self._odometry.doubted or done.restarted:
            self._detector.forget(accused=done.event == "reinitialized" and held)
        elif (proven := self._recovery.proof.proven) or narrow:
            self._detector.add_scan(
                done.scan, done.landmarks, pose, done.step, history, proven=proven
            )
