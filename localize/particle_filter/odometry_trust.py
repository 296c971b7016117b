"""What the particle filter makes of an odometry that is silent, in doubt or contradicted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import OdometrySample
from polemap.localize.config import OdometryConfig
from polemap.localize.contradictions import OdometryAgreement, PoleInnovations
from polemap.localize.odometry_history import Arc
from polemap.localize.odometry_watch import Held
from polemap.localize.particle_filter.estimate import Opinion
from polemap.localize.particle_filter.particles import ParticleSet

Floats = NDArray[np.float64]

# of the particles, those that leave the odometry when it comes into doubt
_FREE_SHARE = 0.5
# how long odometry that was contradicted is not trusted unseen
_FORGIVEN_S = 120.0
# weight of the particles that hold it for wrong, the Bayes factor, and how long, until it is
_FAULTY_SHARE, _EVIDENCE, _FAULTY_S = 0.8, 5.0, 0.3


class OdometryTrust:
    """Whether the particles follow the odometry, and what the poles say of it.

    Attributes:
        doubted: whether odometry was silent or in doubt on the way to the last scan.
    """

    def __init__(self, config: OdometryConfig) -> None:
        self._doubts = config.doubts
        self.doubted = False
        self._held: Held | None = None
        self._silent = False
        self._refuted = False
        self._sample: OdometrySample | None = None
        self._taken_back = self._confirmed = False
        self._innovations = PoleInnovations()
        self._agreement = OdometryAgreement()
        self._refuted_s = -inf
        self._faults = OdometryAgreement(share=_FAULTY_SHARE, lasts_s=_FAULTY_S)

    def believed(self, sample: OdometrySample, held: Held | None) -> OdometrySample:
        """What to move by: the sample, or the speed that held before it stepped.

        Args:
            sample: the newest odometry.
            held: the rates that were believed last, where it is in doubt, or None.
        """
        before, self._held = self._held, held
        self._sample = sample
        if held is not None and not held.step_mps:
            self._refuted_s = sample.stamp_s
        if held is None:
            # a step that was taken back was none: who followed it went wrong
            if before is not None and before.step_mps and not self._confirmed:
                self._taken_back = True
            self._confirmed = False
            return sample
        if not held.step_mps:
            return sample
        return replace(sample, speed_mps=held.speed_mps)

    def release(
        self, particles: ParticleSet, arcs: Sequence[Arc], before: Held, after: Held
    ) -> bool:
        """Let particles go their own way where they must; whether trust has changed.

        Args:
            particles: before they move.
            arcs: that they are to move along.
            before, after: rates of the odometry at the begin and the end of the arcs.
        """
        if not self._doubts:
            return False
        silent = any(arc.blind_s > 0.0 for arc in arcs)
        if silent and not self._silent:
            particles.motion = None
            particles.release(before, 1.0, sure=True)
        elif silent:
            pass
        elif self._held is None:
            if self._taken_back:
                particles.drop_followers()
            particles.motion = None
        elif particles.motion is None or self._silent:
            particles.motion = None
            particles.release(self._held, _FREE_SHARE, sure=not self._held.turn_doubted)
        else:
            elapsed_s = sum(arc.dt_s for arc in arcs)
            particles.motion.switch(elapsed_s, after.speed_mps, after.yaw_rate_radps)
        self._taken_back = False
        if particles.motion is not None and self._sample is not None:
            particles.motion.followed_mps = self._sample.speed_mps
        self._silent = silent
        was, self.doubted = self.doubted, silent or self._held is not None
        if was != self.doubted:
            self._innovations.forget()
            self._agreement.forget()
            self._faults.forget()
        return was != self.doubted

    def suspect(self, stamp_s: float) -> bool:
        """Whether poles, fixes or turns that no car takes have contradicted it lately."""
        return stamp_s - self._refuted_s < _FORGIVEN_S

    def add_correction(
        self,
        stamp_s: float,
        before: tuple[Floats, Floats],
        after: tuple[Floats, Floats],
        *,
        trusted: bool,
    ) -> None:
        """Take in what a scan corrected, mean `(3,)` and covariance `(3, 3)` before and after."""
        if not self._doubts:
            return
        steady = trusted and not self.doubted
        self._refuted = self._innovations.contradict(stamp_s, before, after, steady=steady)

    def opinion(self, particles: ParticleSet, matched: int, elapsed_s: float) -> Opinion | None:
        """What poles say of the odometry after a scan; None where they do not know."""
        if not self._doubts:
            return None
        if not self.doubted:
            share = particles.faulty_share if particles.fault_evidence > _EVIDENCE else 0.0
            faulty = self._faults.confirm(share, matched, elapsed_s)
            return "contradicted" if self._refuted or faulty else None
        if self._silent:
            return None
        following = particles.following_share
        confirmed = self._agreement.confirm(following, matched, elapsed_s)
        self._confirmed |= confirmed
        return "confirmed" if confirmed else None
