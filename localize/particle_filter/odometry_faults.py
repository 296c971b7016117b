"""What odometry can do unseen: particles for which it is wrong, by errors of their own.

Tyres that transmit much force slip, and a yaw rate from steering or wheels errs where the car turns
hard. Within a second that shows in no odometry, and where no pole is found in nothing at all. So
some particles turn faulty, the more often the harder the car accelerates, brakes or turns, and
sound again after a while. Where poles are seen they decide between the two; where none is, the
spread grows by what cannot be ruled out.

Source: jump Markov systems in particles (McGinnity and Irwin 2000), as `free_motion`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.localize.odometry_history import OdometryHistory

Floats = NDArray[np.float64]

# how often odometry turns faulty at an acceleration of so much and above, where tyres on a wet road
# begin to slip; below it falls with the square, down to never in the easiest driving
_TURNS_FAULTY_1PS, _HARD_MPS2, _EASY_MPS2 = 0.2, 1.5, 0.7
# how often it turns sound again: slipping lasts for some seconds
_TURNS_SOUND_1PS = 0.3
# errors while it is faulty, sd: of the speed as a share, of the yaw rate with a share of the turn
_SPEED_SHARE, _RATE_RADPS, _TURN_SHARE = 0.15, 0.03, 0.4
# an odometry that poles or fixes have contradicted lately is not trusted unseen: it turns faulty as
# often as this in any case, and as wrong as a yaw rate of the other sign
_SUSPECT_1PS, _SUSPECT_SPEED_SHARE, _SUSPECT_TURN_SHARE = 0.5, 0.3, 1.2
# an acceleration is a change over this time; turns are remembered for so many of them
_CHANGE_S, _REMEMBERED = 1.0, 2


def demand(history: OdometryHistory, stamp_s: float) -> tuple[float, float]:
    """What the car asks of its tyres at a stamp.

    Returns:
        The largest acceleration of the last two seconds, along or aside, in m/s^2; the largest yaw
        rate of that time, in rad/s. Both as the odometry tells them.
    """
    half_s = 0.5 * _CHANGE_S
    rows = [history.rates_at(stamp_s - k * half_s) for k in range(2 * _REMEMBERED + 1)]
    along = max(abs(a[0] - b[0]) for a, b in zip(rows[2:], rows[:-2], strict=True)) / _CHANGE_S
    aside = max(abs(speed * rate) for speed, rate in rows)
    return max(along, aside), max(abs(rate) for _, rate in rows)


class OdometryFaults:
    """Which particles hold the odometry for wrong, and by how much, `(n,)` each.

    Attributes:
        faulty: those for which it is wrong.
        speed_share, rate_radps: the error of its speed, as a share of it, and of its yaw rate;
            zero for the others.
        expected: share of the faulty if nothing but chance decides.
    """

    def __init__(self, count: int, rng: np.random.Generator) -> None:
        self._rng = rng
        self.expected = 0.0
        self.faulty = np.zeros(count, dtype=np.bool_)
        self.speed_share, self.rate_radps = np.zeros(count), np.zeros(count)

    def step(
        self, dt_s: float, demand_mps2: float, turn_radps: float, *, suspect: bool = False
    ) -> None:
        """Some turn faulty, some sound.

        Args:
            demand_mps2, turn_radps: see `demand`.
            suspect: whether poles or fixes have contradicted the odometry lately.
        """
        hard = (demand_mps2 - _EASY_MPS2) / (_HARD_MPS2 - _EASY_MPS2)
        often = _TURNS_FAULTY_1PS * min(1.0, max(0.0, hard)) ** 2
        speed_sd, turn_share = _SPEED_SHARE, _TURN_SHARE
        if suspect:
            often = max(often, _SUSPECT_1PS)
            speed_sd, turn_share = _SUSPECT_SPEED_SHARE, _SUSPECT_TURN_SHARE
        self.expected += dt_s * (often * (1.0 - self.expected) - _TURNS_SOUND_1PS * self.expected)
        self.expected = min(max(self.expected, 0.0), 1.0)
        chance = self._rng.random(len(self.faulty))
        noise = self._rng.standard_normal((2, len(self.faulty)))
        begin = ~self.faulty & (chance < -np.expm1(-often * dt_s))
        if not (begin.any() or self.faulty.any()):
            return
        end = self.faulty & (chance < -np.expm1(-_TURNS_SOUND_1PS * dt_s))
        rate_sd = _RATE_RADPS + turn_share * turn_radps
        self.speed_share = np.where(begin, speed_sd * noise[0], self.speed_share)
        self.rate_radps = np.where(begin, rate_sd * noise[1], self.rate_radps)
        self.faulty = (self.faulty | begin) & ~end
        self.speed_share = np.where(self.faulty, self.speed_share, 0.0)
        self.rate_radps = np.where(self.faulty, self.rate_radps, 0.0)

    def take(self, rows: NDArray[np.int64]) -> None:
        """Keep the particles of these rows, in this order."""
        self.faulty, self.speed_share = self.faulty[rows], self.speed_share[rows]
        self.rate_radps = self.rate_radps[rows]

    def join(self, count: int) -> None:
        """Newcomers come last, up to `count` particles; they hold the odometry for sound."""
        more = count - len(self.faulty)
        self.faulty = np.concatenate([self.faulty, np.zeros(more, dtype=np.bool_)])
        self.speed_share = np.concatenate([self.speed_share, np.zeros(more)])
        self.rate_radps = np.concatenate([self.rate_radps, np.zeros(more)])
