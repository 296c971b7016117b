"""The odometry of the last seconds, sorted by stamp: what every use of recent motion stands on."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from math import inf, isfinite

from polemap.drivelog.samples import OdometrySample


class OdometryWindow:
    """Keeps the samples of the last `keep_s` seconds as parallel lists.

    Args:
        keep_s: older samples are forgotten.
        slack: they are only forgotten once the window has grown to `slack` times its length, so
            that a long one is not moved up at every sample.

    Attributes:
        stamps_s, speeds_mps, yaw_rates_radps: one entry a sample, by rising stamp.
    """

    def __init__(self, keep_s: float, *, slack: float = 1.0) -> None:
        self._keep_s, self._slack = keep_s, slack
        self.stamps_s: list[float] = []
        self.speeds_mps: list[float] = []
        self.yaw_rates_radps: list[float] = []

    def __len__(self) -> int:
        return len(self.stamps_s)

    @property
    def newest_s(self) -> float:
        """Stamp of the newest sample, minus infinity before the first."""
        return self.stamps_s[-1] if self.stamps_s else -inf

    def insert(self, sample: OdometrySample) -> bool:
        """Put a sample where its stamp says, in place of one of the same stamp.

        False if a value of it is not finite; it is left out.
        """
        row = (sample.stamp_s, sample.speed_mps, sample.yaw_rate_radps)
        if not all(map(isfinite, row)):
            return False
        if sample.stamp_s > self.newest_s:
            for track, value in zip(self._tracks(), row, strict=True):
                track.append(value)
            return True
        place = bisect_left(self.stamps_s, sample.stamp_s)
        end = bisect_right(self.stamps_s, sample.stamp_s, place)
        for track, value in zip(self._tracks(), row, strict=True):
            track[place:end] = [value]
        return True

    def forget(self) -> int:
        """Drop what has become too old; how many samples went."""
        if not self.stamps_s or self.newest_s - self.stamps_s[0] <= self._slack * self._keep_s:
            return 0
        dropped = bisect_left(self.stamps_s, self.newest_s - self._keep_s)
        for track in self._tracks():
            del track[:dropped]
        return dropped

    def rates_at(self, stamp_s: float) -> tuple[float, float]:
        """Speed and yaw rate at a stamp: linear between samples, held beyond the first and the last
        one; zero without any."""
        stamps, speeds, rates = self._tracks()
        if not stamps:
            return 0.0, 0.0
        i = bisect_right(stamps, stamp_s)
        if i == 0:
            return speeds[0], rates[0]
        if i == len(stamps):
            return speeds[-1], rates[-1]
        share = (stamp_s - stamps[i - 1]) / (stamps[i] - stamps[i - 1])
        return (
            speeds[i - 1] + share * (speeds[i] - speeds[i - 1]),
            rates[i - 1] + share * (rates[i] - rates[i - 1]),
        )

    def _tracks(self) -> tuple[list[float], list[float], list[float]]:
        return self.stamps_s, self.speeds_mps, self.yaw_rates_radps
