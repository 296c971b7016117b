"""May the pose be trusted: is the filter lost, and is the place that it has chosen proven?"""

from __future__ import annotations

from typing import Literal

from polemap.localize.config import RecoveryConfig
from polemap.localize.particle_filter.estimate import PfEstimate

Verdict = Literal["confirmed", "contradicted", "open"]
RestartCause = Literal["spread", "poles", "fixes", "place"]
"""Why the filter starts anew: its particles spread too wide, hardly a pole fits, every fix lies far
away, or the poles of the last metres fit clearly better at another place."""

# a single pole that fits, or does not, says little
_LEAST_POSSIBLE = 1.5
# two outliers before and after an outage are no proof
_LEAST_FAR_FIXES = 3
# a fix lies far away from this on, in standard deviations of both
_FAR_SD = 5.0
PROVEN_SD_M, PROVEN_AFTER_M = 0.5, 25.0
"""A narrow particle set that finds poles where it expects them for so many metres is where it says:
none of 636 simulated starts claimed a wrong pose."""
LINES_PROVEN_AFTER_M = 100.0
"""A single ridge of particles whose lines fit for so many metres is in the lane where it says."""
CORNERS_PROVEN_AFTER_M = 100.0
"""Houses of a row look alike: corners alone must be found where they are expected for longer."""
# least share of the poles that could match and do: a third, where p_detection lets two thirds hope
_FIT_SHARE_MIN = 0.34
_HOPE = 0.5  # where fewer matches could be hoped for, none says nothing
# a pose of particles that spread further along one axis is not offered to the output filter
_OFFER_SD_MAX_M = 5.0


class LostDetector:
    """Lost when the particles spread wider than `lost_sd_m`, when for a while hardly a pole fits,
    or when for a while every fix lies far away."""

    def __init__(self, config: RecoveryConfig) -> None:
        self._config = config
        self._share = 1.0
        self._geometric_sd_m = 0.0
        self._bad_s = 0.0
        self._far_fixes_s: list[float] = []
        self._last_s: float | None = None

    @property
    def match_share(self) -> float:
        """Smoothed share of the poles that could match and do, 0 to 1."""
        return self._share

    @property
    def fits(self) -> bool:
        """Whether enough of the poles match."""
        return self._share >= _FIT_SHARE_MIN

    @property
    def scattered(self) -> bool:
        """Whether the particles spread too wide to find back by itself."""
        return self._geometric_sd_m > self._config.lost_sd_m

    @property
    def lost(self) -> bool:
        """Whether the filter should start anew.

        Source: Spangenberg (2016), section V-D, for the spread; the matches are ours.
        """
        limit_s = self._config.lost_after_s
        return self.scattered or self._bad_s >= limit_s or self.astray

    @property
    def cause(self) -> RestartCause:
        """Of being lost: the widest of its reasons."""
        return "spread" if self.scattered else "fixes" if self.astray else "poles"

    @property
    def far(self) -> bool:
        """Whether the newest fix lies far away, and no poles have held the pose against it."""
        return bool(self._far_fixes_s)

    @property
    def astray(self) -> bool:
        """Whether GNSS has long said that the car is somewhere else."""
        fixes = self._far_fixes_s
        if len(fixes) < _LEAST_FAR_FIXES:
            return False
        return fixes[-1] - fixes[0] >= self._config.lost_after_s

    def add_match(
        self,
        stamp_s: float,
        matched: int,
        seen: int,
        expected: float,
        geometric_sd_m: float,
        gnss_distance_sd: float | None,
        *,
        held: bool = False,
    ) -> None:
        """Take in what the estimate makes of a scan.

        Args:
            expected: detections of map poles to be hoped for.
            gnss_distance_sd: from the newest fix, in standard deviations; None without one.
            held: whether so many poles have held the pose that a far fix is wrong.
        """
        config = self._config
        elapsed = 0.0 if self._last_s is None else stamp_s - self._last_s
        self._last_s = stamp_s
        self._geometric_sd_m = geometric_sd_m
        if gnss_distance_sd is not None:
            far = gnss_distance_sd > _FAR_SD and not held
            self._far_fixes_s = [*self._far_fixes_s, stamp_s] if far else []
        possible = max(min(seen, expected), matched)
        if possible < _LEAST_POSSIBLE:
            return
        gain = min(1.0, elapsed / (0.5 * config.lost_after_s))
        self._share += gain * (min(matched / possible, 1.0) - self._share)
        self._bad_s = 0.0 if self.fits else self._bad_s + elapsed

    def reset(self) -> None:
        """After an initialization: the benefit of the doubt."""
        self._share = 1.0
        self._bad_s = self._geometric_sd_m = 0.0
        self._far_fixes_s = []


class StartProof:
    """Collects what speaks for and against the place that the particles have chosen after a start.

    It is proven by a constellation that fits here and nowhere else near; or, where poles are too
    rare for that, by narrow particles that go on to find the poles where they expect them. It is
    in doubt again where hardly any of the poles that are seen fits.
    """

    def __init__(self, config: RecoveryConfig) -> None:
        self._config = config
        self._upheld_m = self._lines_m = self._corners_m = 0.0
        self._fitting = 1.0
        self.proven = self.was_proven = False
        self.contradicted = False

    def begin(self) -> None:
        """A new start: nothing is known."""
        self._upheld_m = self._lines_m = self._corners_m = 0.0
        self._fitting = 1.0
        self.proven = self.was_proven = self.contradicted = False

    def doubt(self) -> None:
        """Poles contradict the place: it must be proven again."""
        self._upheld_m = self._lines_m = self._corners_m = 0.0
        self.proven = False

    def believe(self) -> None:
        """Somebody who should know has said where the car is."""
        self._fitting = 1.0
        self.proven, self.was_proven, self.contradicted = True, True, False

    @property
    def in_doubt(self) -> bool:
        """Whether of the poles that were lately seen so few fit that others should be tried."""
        return self._fitting < _FIT_SHARE_MIN

    def add_fit(self, matched: int, seen: int, elapsed_s: float) -> None:
        """Take in how many of the poles of a scan fit; unlike being lost, this asks the map for
        nothing: where it has no poles at all, the car may be elsewhere."""
        if seen:
            gain = min(1.0, elapsed_s / (0.5 * self._config.lost_after_s))
            self._fitting += gain * (matched / seen - self._fitting)

    def add_verdict(
        self,
        verdict: Verdict,
        *,
        narrow: bool,
        matched: int,
        possible: float,
        moved_m: float,
    ) -> None:
        """Take in a scan.

        Args:
            verdict: on the constellation; "open" where it was not asked for.
            narrow: the particles have one mode, narrower than `PROVEN_SD_M`.
            matched: poles of the scan that fit.
            possible: matches that could be hoped for.
            moved_m: since the last scan.
        """
        self.contradicted = verdict == "contradicted"
        if not narrow:
            self._upheld_m = 0.0
            return
        if matched:
            self._upheld_m += moved_m
        elif possible > _HOPE:
            self._upheld_m = max(0.0, self._upheld_m - moved_m)
        self.proven |= verdict == "confirmed" or self._upheld_m >= PROVEN_AFTER_M
        self.was_proven |= self.proven

    def add_corners(self, *, narrow: bool, seen: int, matched: int, moved_m: float) -> None:
        """Take in the corners of a scan that are believed.

        Args:
            narrow: the particles have one mode, narrower than `PROVEN_SD_M`.
        """
        if not narrow:
            self._corners_m = 0.0
        elif matched:
            self._corners_m += moved_m
        elif seen:
            self._corners_m = max(0.0, self._corners_m - moved_m)
        self.proven |= self._corners_m >= CORNERS_PROVEN_AFTER_M
        self.was_proven |= self.proven

    def add_lines(self, *, one_place: bool, seen: int, matched: int, moved_m: float) -> None:
        """Take in the lines of a scan: where no pole says where the car is, a single ridge of
        particles whose lines have fitted for long enough is aside of the street where it says.

        Args:
            one_place: particles lie on one ridge, narrow across.
            seen, matched: pieces of lines.
        """
        if not one_place or 2 * matched < seen:
            self._lines_m = 0.0
        elif matched:
            self._lines_m += moved_m
        self.proven |= self._lines_m >= LINES_PROVEN_AFTER_M
        self.was_proven |= self.proven


def not_offered(estimate: PfEstimate) -> str | None:
    """Why the particle filter's own health keeps a pose from the output filter, or None."""
    if not (estimate.healthy or estimate.usable):
        return "unhealthy"
    if estimate.modes > 1:
        return "modes"
    if estimate.health.position_sd_major_m > _OFFER_SD_MAX_M:
        return "spread"
    return None
