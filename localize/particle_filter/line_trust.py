"""Whether the lines of a kind are believed: a road that was painted anew must not drag the pose.

Before the lines of a frame move the particles they are held against where poles, fixes and the way
have put the car. A kind whose lines lie elsewhere than its map says is left out: of the frame where
they are far off, and until they fit again where they are off time and again.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.localize.particle_filter.line_weigher import SHARED, LineMatch

Floats = NDArray[np.float64]

# of a frame: lines this many deviations off are not used, and after so long a way of such frames
# the kind is not believed: the place gets less sure without lines, so the first ones say the most
_FRAME_SD, _HELD_MAX_M, _FINE_SD = 3.0, 3.0, 2.0
# errors of lines last, so a step of this size, and of so many deviations of what is seen, is paint;
# lines as near as this are no step, whatever came before; what is usual is known after a way
_STEP_M, _STEP_SD, _NEAR_SD, _USUAL_M = 0.25, 3.0, 1.5, 10.0
# cumulative sums of what exceeds one deviation, per independent frame: by chance once in thousands
_SLACK_SD, _LIMIT, _MOST = 1.0, 4.0, 6.0
# a place known worse than this across says nothing of lines that other lanes have too
_JUDGE_SD_M = 0.5
# lines come back where they fit for so many independent frames, the place being known this well
# without them
_FITS_SD, _FITS_FRAMES, _SURE_SD_M = 1.5, 3.0, 0.3
# known no better than this, the place is looked for by the lines again, but not called proven
_LOST_SD_M = 1.0
# a line further off is another one
_FARTHEST_M = 3.5
# pieces that run across the street say nothing of what is aside
_ASIDE = 0.87


@dataclass(frozen=True, slots=True)
class _Offset:
    """How far the lines of a kind lie left of where the map has them, in metres and in deviations,
    the deviation of the place in that direction, and of what is seen."""

    aside_m: float
    distance_sd: float
    place_sd_m: float
    seen_sd_m: float


@dataclass(slots=True)
class _KindTrust:
    """Sums for lines that lie too far right, and left; independent frames that have fitted; way on
    which frames were left out; how far aside lines usually lie, and the way that tells so."""

    def steps(self, off: _Offset, moved_m: float) -> bool:
        """Take in how far aside lines lie; whether that is a step from what was usual."""
        step = abs(off.aside_m - self.usual_m) > max(_STEP_M, _STEP_SD * off.seen_sd_m)
        if step and abs(off.distance_sd) > _NEAR_SD and self.way_m >= _USUAL_M:
            return True
        self.way_m += moved_m
        weight = min(1.0, max(moved_m, 0.05) / min(self.way_m + 0.05, _USUAL_M))
        self.usual_m += weight * (off.aside_m - self.usual_m)
        return False

    sums: Floats = field(default_factory=lambda: np.zeros(2))
    fitting: float = 0.0
    held_m: float = 0.0
    usual_m: float = 0.0
    way_m: float = 0.0
    suspended: bool = False


class LineTrust:
    """Judges each kind of lines for itself.

    Args:
        counts: suspensions are counted here, by kind.

    Attributes:
        doubted: lines that were not believed hold the pose, as nothing else did; whether they are
            right, poles must say (`confirm`).

    Source: Page (1954), "Continuous inspection schemes", Biometrika 41.
    """

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._kinds: dict[int, _KindTrust] = {}
        self.doubted = False

    def confirm(self) -> None:
        """Poles hold the pose."""
        self.doubted = False

    @property
    def suspended(self) -> tuple[str, ...]:
        """Names of the kinds that are not believed."""
        return tuple(
            LandmarkKind(kind).name.lower()
            for kind, trust in sorted(self._kinds.items())
            if trust.suspended
        )

    def is_suspended(self, kind: int) -> bool:
        """Whether a kind is not believed."""
        return kind in self._kinds and self._kinds[kind].suspended

    def forget(self) -> None:
        """A new place: what lines said at another one says nothing here."""
        self._kinds.clear()

    def believed(
        self, match: LineMatch, kinds: list[int], pose: Floats, covariance: Floats, share: float,
        moved_m: float,
    ) -> list[int]:  # fmt: skip
        """Kinds whose lines may move the particles.

        Args:
            match: nearest lines of all pieces from `pose`.
            kinds: of the frame's pieces.
            pose, covariance: `(3,)`, `(3, 3)` of the particles before the lines.
            share: of the frame that is independent of the last one.
            moved_m: since the last scan.
        """
        return [
            kind for kind in kinds if self._believe(kind, match, pose, covariance, share, moved_m)
        ]

    def _believe(
        self, kind: int, match: LineMatch, pose: Floats, covariance: Floats, share: float,
        moved_m: float,
    ) -> bool:  # fmt: skip
        trust = self._kinds.setdefault(kind, _KindTrust())
        off = _aside(match, kind, pose, covariance)
        if off is None:
            return not trust.suspended
        distance_sd, place_sd_m = off.distance_sd, off.place_sd_m
        if place_sd_m > _JUDGE_SD_M:
            if trust.suspended and place_sd_m > _LOST_SD_M:
                self._kinds[kind] = _KindTrust()
                self.doubted = True
            return not self._kinds[kind].suspended
        # a stray piece lies anywhere: one frame must not say more than its lines can
        bounded_sd = float(np.clip(distance_sd, -_FRAME_SD, _FRAME_SD))
        over = np.array([bounded_sd, -bounded_sd]) - _SLACK_SD
        trust.sums = np.clip(trust.sums + share * over, 0.0, _MOST)
        step = not trust.suspended and trust.steps(off, moved_m)
        far = abs(distance_sd) > _FRAME_SD or step
        trust.held_m += moved_m if far else 0.0
        trust.held_m *= far or abs(distance_sd) > _FINE_SD
        out = trust.sums.max() >= _LIMIT or trust.held_m >= _HELD_MAX_M
        if not trust.suspended and out:
            trust.suspended, trust.fitting, trust.held_m = True, 0.0, 0.0
            self._counts[f"lines_suspended_{LandmarkKind(kind).name.lower()}"] += 1
        elif trust.suspended:
            fits = abs(distance_sd) <= _FITS_SD
            sure = place_sd_m <= _SURE_SD_M
            trust.fitting = trust.fitting + share * sure if fits else 0.0
            if trust.fitting >= _FITS_FRAMES:
                trust = self._kinds[kind] = _KindTrust()
        if far:
            self._counts["line_frames_held"] += 1
            return False
        return not trust.suspended


def _aside(match: LineMatch, kind: int, pose: Floats, covariance: Floats) -> _Offset | None:
    """Where the lines of a kind lie; None where none runs along."""
    left = np.array([-np.sin(pose[2]), np.cos(pose[2])])
    sense = match.normal @ left
    mine = (match.kind == kind) & (np.abs(match.across_m) <= _FARTHEST_M)
    rows = np.flatnonzero(mine & (np.abs(sense) >= _ASIDE))
    if not len(rows):
        return None
    sign = np.sign(sense[rows])
    weight = 1.0 / (match.seen_m2[rows] + match.mapped_m2[rows])
    weight /= weight.sum()
    aside = sign * match.across_m[rows]
    # one stray piece among many must not speak for all
    middle = float(np.median(aside)) if len(rows) > 2 else float(weight @ aside)
    jacobian = weight @ (sign[:, None] * match.jacobian[rows])
    place = float(jacobian @ covariance @ jacobian)
    seen, lines = match.seen_m2[rows], np.unique(match.ids[rows])
    own = SHARED * float(weight @ seen) + (1.0 - SHARED) * float(weight**2 @ seen)
    seen_sd = float(np.sqrt(own))
    own += float(weight @ match.mapped_m2[rows]) / len(lines)
    return _Offset(middle, middle / float(np.sqrt(place + own)), float(np.sqrt(place)), seen_sd)
