"""Is the particle filter well? The record of every update, and the detector of being lost."""

from __future__ import annotations

from dataclasses import dataclass

from localize.config import LocalizeConfig


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
    """Lost when the cloud is wider than `lost_sd_m`, or when for a while hardly a pole fits."""

    def __init__(self, config: LocalizeConfig) -> None:
        self._config = config
        self._share = 1.0
        self._bad_since_s: float | None = None
        self._last_s: float | None = None

    @property
    def match_share(self) -> float:
        """Smoothed share of the poles that could match and do, 0 to 1."""
        return self._share

    def update(
        self, stamp_s: float, matched: int, seen: int, in_view: int, geometric_sd_m: float
    ) -> bool:
        """Take in one update; True if the filter must be initialized anew."""
        config = self._config
        possible = min(seen, in_view)
        elapsed = 0.0 if self._last_s is None else stamp_s - self._last_s
        self._last_s = stamp_s
        if possible >= 2:
            gain = min(1.0, elapsed / (0.5 * config.lost_after_s))
            self._share += gain * (min(matched / possible, 1.0) - self._share)
        if self._share >= config.lost_match_share:
            self._bad_since_s = None
        elif self._bad_since_s is None:
            self._bad_since_s = stamp_s
        misfit = (
            self._bad_since_s is not None and stamp_s - self._bad_since_s >= config.lost_after_s
        )
        return geometric_sd_m > config.lost_sd_m or misfit

    def reset(self) -> None:
        """After an initialization: the benefit of the doubt."""
        self._share = 1.0
        self._bad_since_s = None
