"""Particles that do not follow the odometry: each has a speed and a turn of its own.

While odometry is silent all of them are free, while it is in doubt some are, and the poles decide
between the two: a switching state-space model whose regimes follow one another at random.

Source: the interacting regimes of Blom and Bar-Shalom (1988), here in the particles (McGinnity and
Irwin 2000, "Multiple model bootstrap filter for maneuvering target tracking").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.localize.odometry_watch import Held

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

# what a car does: densities of its accelerations along and about, as those of the output filter
_ALONG_M2PS3, _ABOUT_RAD2PS3 = 2.25, 0.15
# how often a particle changes the regime
_SWITCH_1PS = 0.5
# rates that were believed until now; and those that have been wrong for nobody knows how long
_HELD_SD_MPS, _HELD_SD_RADPS = 0.3, 0.02
_DOUBTED_SHARE, _DOUBTED_SD_MPS, _DOUBTED_SD_RADPS = 0.3, 0.5, 0.1
# error of a yaw rate of which only the speed is in doubt: it may come from the same wheels
_TURN_SD_RADPS = 0.02


class FreeMotion:
    """Regime, speed and yaw rate of every particle, `(n,)` each.

    Args:
        count: particles.
        held: the rates that were believed last.
        share: of the particles that are free from the start.
        rng: all randomness.
        sure: whether these rates were right until now; else nobody knows for how long.

    Attributes:
        free: which particles do not follow the odometry.
        followed: which have followed it at any time since it came into doubt.
        speed_mps: of the free.
        followed_mps: speed of the others, as the odometry that is in doubt has it.
        own_turn: whether the free have a yaw rate of their own; else they follow the odometry's,
            each with an error that stays.
    """

    def __init__(
        self, count: int, held: Held, share: float, rng: np.random.Generator, *, sure: bool
    ) -> None:
        self._rng = rng
        self.free: Flags = rng.random(count) < share
        self.followed: Flags = ~self.free
        self.own_turn = held.turn_doubted
        self.followed_mps = held.speed_mps
        noise = rng.standard_normal((3, count))
        speed_sd, rate_sd = _HELD_SD_MPS, _HELD_SD_RADPS
        if not sure:
            speed_sd = _DOUBTED_SD_MPS + _DOUBTED_SHARE * abs(held.speed_mps)
            rate_sd = _DOUBTED_SD_RADPS + _DOUBTED_SHARE * abs(held.yaw_rate_radps)
        self.speed_mps: Floats = held.speed_mps + speed_sd * noise[0]
        self._rate_radps: Floats = held.yaw_rate_radps + rate_sd * noise[1]
        self._turn_error: Floats = noise[2]

    def step(self, dt_s: float) -> None:
        """The free accelerate and turn as cars do."""
        noise = self._rng.standard_normal((2, len(self.free)))
        self.speed_mps = self.speed_mps + np.sqrt(_ALONG_M2PS3 * dt_s) * noise[0]
        self._rate_radps = self._rate_radps + np.sqrt(_ABOUT_RAD2PS3 * dt_s) * noise[1]

    def yaw_rates(self, odometry_radps: float) -> Floats:
        """Yaw rates `(n,)` of the free, where the odometry says `odometry_radps`."""
        if self.own_turn:
            return self._rate_radps
        sd = _TURN_SD_RADPS + _DOUBTED_SHARE * abs(odometry_radps)
        rates: Floats = odometry_radps + sd * self._turn_error
        return rates

    def switch(self, dt_s: float, speed_mps: float, yaw_rate_radps: float) -> None:
        """Some try the other regime; who leaves the odometry does so from about its rates."""
        swap = self._rng.random(len(self.free)) < -np.expm1(-_SWITCH_1PS * dt_s)
        leave = swap & ~self.free
        noise = self._rng.standard_normal((2, int(leave.sum())))
        speed_sd = _DOUBTED_SD_MPS + _DOUBTED_SHARE * abs(speed_mps)
        rate_sd = _DOUBTED_SD_RADPS + _DOUBTED_SHARE * abs(yaw_rate_radps)
        self.speed_mps[leave] = speed_mps + speed_sd * noise[0]
        self._rate_radps[leave] = yaw_rate_radps + rate_sd * noise[1]
        self.free = self.free ^ swap
        self.followed = self.followed | ~self.free

    def take(self, rows: NDArray[np.int64]) -> None:
        """Keep the particles of these rows, in this order."""
        self.free, self.speed_mps = self.free[rows], self.speed_mps[rows]
        self.followed = self.followed[rows]
        self._rate_radps, self._turn_error = self._rate_radps[rows], self._turn_error[rows]

    def take_with_newcomers(self, rows: NDArray[np.int64], count: int) -> None:
        """Keep these rows, and give newcomers the rates of some of them, up to `count` in all."""
        if not len(rows):
            rows = np.arange(len(self.free))
            self.take(self._rng.choice(rows, count))
            return
        more = self._rng.integers(0, len(rows), count - len(rows))
        self.take(np.concatenate([rows, rows[more]]))
