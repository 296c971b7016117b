"""Lines in the particle filter: which are believed, what they say of the particles, who matched."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.line_detections import LineDetections
from polemap.localize.config import LocalizeConfig
from polemap.localize.particle_filter.estimate import KindHealth, LineHealth
from polemap.localize.particle_filter.line_errors import add_lines
from polemap.localize.particle_filter.line_trust import LineTrust
from polemap.localize.particle_filter.line_weigher import LineMatch, LineWeigher, line_share
from polemap.localize.particle_filter.particles import ParticleSet
from polemap.localize.particle_filter.persistent_errors import PersistentErrors, at_least
from polemap.localize.particle_filter.pole_weigher import tempered
from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

# lines hold the pose aside for so long a way after they were last matched
_HOLD_M = 15.0
# after so long a way without lines they are held against all that may have gone wrong on it
_GAP_M = 5.0


@dataclass(frozen=True, slots=True)
class LineStep:
    """What the lines of a frame have done.

    Attributes:
        lines: pieces that moved the particles.
        share: power that their likelihood was raised to.
        before: `(3, 3)` covariance of the particles before that.
    """

    lines: LineDetections
    share: float
    before: Floats


class LineEvidence:
    """Weighs particles by lines, and remembers whether lines hold the pose.

    Args:
        pole_map: with the lines that count.
        counts: what happened is counted here.
    """

    def __init__(self, pole_map: PoleMap, config: LocalizeConfig, counts: Counter[str]) -> None:
        self._effective_share_min = config.poles.effective_share_min
        self._independent = config.poles.scan_errors == "independent"
        self._weigher = LineWeigher(pole_map.lines)
        self._kinds = self._kinds_of(pole_map)
        self.trust = LineTrust(counts)
        self._step: LineStep | None = None
        self._seen: Rows = np.empty(0, dtype=np.int64)
        self._held_m = np.inf

    def use_map(self, pole_map: PoleMap) -> None:
        """Go on with other lines, of the same frame."""
        self._weigher.use_lines(pole_map.lines)
        self._kinds = self._kinds_of(pole_map)

    def _kinds_of(self, pole_map: PoleMap) -> list[int]:
        lines = pole_map.lines
        return [] if lines is None else np.unique(lines.kind).tolist()

    @property
    def in_use(self) -> bool:
        """Whether the map around holds lines that count."""
        return not self._weigher.empty

    @property
    def hold(self) -> bool:
        """Whether lines have lately matched."""
        return self._held_m <= _HOLD_M

    def weigh(
        self, particles: ParticleSet, scan: Detections, moved_m: float, elapsed_s: float,
        stated: Floats,
    ) -> None:  # fmt: skip
        """Let the lines of a scan weigh the particles, if they are believed.

        Args:
            moved_m, elapsed_s: since the last scan.
            stated: `(3, 3)` covariance of the pose that lasting errors leave.
        """
        self._step, self._seen = None, np.empty(0, dtype=np.int64)
        self._held_m += moved_m
        if scan.lines is None or self._weigher.empty:
            return
        lines = scan.lines.of_kinds(*self._kinds)
        self._seen = lines.kind.astype(np.int64)
        if not len(lines):
            return
        rear = particles.rear
        pose, before = particles.moments
        share = 1.0 if self._independent else line_share(moved_m, elapsed_s)
        kinds = np.unique(lines.kind).tolist()
        nearest = self._weigher.match(pose, lines, nearest=True)
        # what lasts has shown in the lines of the last metres; after a gap it has not yet
        place = before if self._held_m <= _GAP_M else at_least(before, stated)
        believed = self.trust.believed(nearest, kinds, pose, place, share, moved_m)
        lines = lines.of_kinds(*believed)
        if not len(lines):
            return
        particles.log_weights, used = tempered(
            particles.log_weights,
            self._weigher.weigh(rear, lines),
            share,
            self._effective_share_min * len(particles),
        )
        self._step = LineStep(lines, used, before)

    def assess(self, pose: Floats, errors: PersistentErrors | None) -> LineHealth | None:
        """Match the lines that have weighed from the estimate `(3,)`, and state what they leave;
        None where the map holds no lines.

        Args:
            errors: take in what lasts; None where only the particles count.
        """
        if not self.in_use:
            return None
        suspended = self.trust.suspended
        if self._step is None:
            return LineHealth(len(self._seen), 0, suspended, self._by_kind(None))
        match = self._weigher.match(pose, self._step.lines)
        if len(match):
            self._held_m = 0.0
        if errors is not None:
            step, yaw = self._step, float(pose[2])
            add_lines(errors, step.before, match, yaw, len(step.lines), step.share)
        return LineHealth(len(self._seen), len(match), suspended, self._by_kind(match))

    def _by_kind(self, match: LineMatch | None) -> tuple[KindHealth, ...]:
        """Of every kind of lines that the map holds around the car."""
        out = []
        for kind in self._kinds:
            across_m = np.empty(0) if match is None else match.across_m[match.kind == kind]
            out.append(
                KindHealth(
                    kind,
                    int(np.count_nonzero(self._seen == kind)),
                    len(across_m),
                    self.trust.is_suspended(kind),
                    float(across_m @ across_m),
                )
            )
        return tuple(out)
