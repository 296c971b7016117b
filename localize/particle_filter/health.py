"""Is the particle filter well? The record of every update, and the detector of being lost."""

from __future__ import annotations

from dataclasses import dataclass

from polemap.localize.config import RecoveryConfig

# a single pole that fits, or does not, says little
_LEAST_POSSIBLE = 1.5
# two outliers before and after an outage are no proof
_LEAST_FAR_FIXES = 3
# a fix lies far away from this on, in standard deviations of both
_FAR_SD = 5.0


@dataclass(frozen=True, slots=True)
class HealthRecord:
    """One row of health.csv, without what the output filter adds.

    Attributes:
        matched: seen poles that the optimal assignment at the estimate gives a map pole.
        seen: poles of the scan.
        in_view: map poles that should have been seen from the estimate.
        n_eff: effective particles after weighing, before resampling.
        position_sd_major_m, position_sd_minor_m: of the whole cloud, not of its best mode.
        exploration_ratio: share of the particles that were drawn anew.
        lag_s: arrival less stamp of the scan.
        match_share: smoothed share of the poles that could match and do.
        modes: clusters of the cloud above the least share.
        mode_share: weight of the best one.
        evidence_share: power that the scan's likelihood was raised to.
    """

    stamp_s: float
    matched: int
    seen: int
    in_view: int
    n_eff: float
    position_sd_major_m: float
    position_sd_minor_m: float
    exploration_ratio: float
    lag_s: float
    particles: int
    match_share: float
    modes: int
    mode_share: float
    evidence_share: float
    yaw_rate_offset_radps: float
    speed_scale: float


class LostDetector:
    """Lost when the cloud is wider than `lost_sd_m`, when for a while hardly a pole fits, or when
    for a while every fix lies far away."""

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
        return self._share >= self._config.lost_match_share

    @property
    def scattered(self) -> bool:
        """Whether the cloud is too wide to find back by itself."""
        return self._geometric_sd_m > self._config.lost_sd_m

    @property
    def lost(self) -> bool:
        """Whether the filter should start anew.

        Source: Spangenberg (2016), section V-D, for the spread; the matches are ours.
        """
        limit_s = self._config.lost_after_s
        return self.scattered or self._bad_s >= limit_s or self.astray

    @property
    def astray(self) -> bool:
        """Whether GNSS has long said that the car is somewhere else."""
        fixes = self._far_fixes_s
        if len(fixes) < _LEAST_FAR_FIXES:
            return False
        return fixes[-1] - fixes[0] >= self._config.lost_after_s

    def update(
        self,
        stamp_s: float,
        matched: int,
        seen: int,
        expected: float,
        geometric_sd_m: float,
        gnss_distance_sd: float | None,
    ) -> None:
        """Take in what the estimate makes of a scan.

        Args:
            expected: detections of map poles to be hoped for.
            gnss_distance_sd: from the newest fix, in standard deviations; None without one.
        """
        config = self._config
        elapsed = 0.0 if self._last_s is None else stamp_s - self._last_s
        self._last_s = stamp_s
        self._geometric_sd_m = geometric_sd_m
        if gnss_distance_sd is not None:
            far = gnss_distance_sd > _FAR_SD
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
