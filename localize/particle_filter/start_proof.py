"""When a place may be believed: a single pole fits in many."""

from __future__ import annotations

from polemap.localize.config import RecoveryConfig
from polemap.localize.particle_filter.relocation import Verdict

PROVEN_SD_M, PROVEN_AFTER_M = 0.5, 25.0
"""A narrow particle set that finds poles where it expects them for so many
metres is where it says: none of 636 simulated starts claimed a wrong pose."""
_HOPE = 0.5  # where fewer matches could be hoped for, none says nothing


class StartProof:
    """Collects what speaks for and against the place that the cloud has chosen after a start.

    It is proven by a constellation that fits here and nowhere else near; or, where poles are too
    rare for that, by a narrow cloud that goes on to find the poles where it expects them. It is
    in doubt again where hardly any of the poles that are seen fits.
    """

    def __init__(self, config: RecoveryConfig) -> None:
        self._config = config
        self._upheld_m = 0.0
        self._fitting = 1.0
        self.proven = False
        self.contradicted = False

    def begin(self) -> None:
        """A new start: nothing is known."""
        self._upheld_m = 0.0
        self._fitting = 1.0
        self.proven = self.contradicted = False

    def believe(self) -> None:
        """Somebody who should know has said where the car is."""
        self._fitting = 1.0
        self.proven, self.contradicted = True, False

    @property
    def in_doubt(self) -> bool:
        """Whether of the poles that were lately seen so few fit that others should be tried."""
        return self._fitting < self._config.lost_match_share

    def see(self, matched: int, seen: int, elapsed_s: float) -> None:
        """Take in how many of the poles of a scan fit; unlike being lost, this asks the map for
        nothing: where it has no poles at all, the car may be elsewhere."""
        if seen:
            gain = min(1.0, elapsed_s / (0.5 * self._config.lost_after_s))
            self._fitting += gain * (matched / seen - self._fitting)

    def add(
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
            narrow: the cloud has one mode, narrower than `PROVEN_SD_M`.
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
