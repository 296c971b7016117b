"""The cloud of particles: where they stand, how each guesses the car's slip, what each weighs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from polemap.localize.config import LocalizeConfig
from polemap.localize.odometry_history import Arc
from polemap.localize.particle_filter.motion_model import sample_motion
from polemap.localize.particle_filter.particles import normalized
from polemap.localize.particle_filter.resampling import (
    jittered,
    low_variance_indices,
    particles_needed,
)
from polemap.vehicle.pose import move_reference_point, wrap_angle

Floats = NDArray[np.float64]


# share of effective particles below which they are drawn anew (S16, section IV)
_RESAMPLE_BELOW = 0.5
# how the slip differs from car to car: those of vehicle/cars lie within 1.1 of it
_SLIP_SD_RAD_PER_MPS2 = 0.0015


class Cloud:
    """Front-axle poses `(n, 3)`, slips `(n,)` and log-weights `(n,)`; empty until `place`."""

    def __init__(
        self, config: LocalizeConfig, wheelbase_m: float, rng: np.random.Generator
    ) -> None:
        self._config = config
        self._wheelbase_m = wheelbase_m
        self._rng = rng
        self.poses = np.empty((0, 3))
        self.log_weights = np.empty(0)
        self._slips = np.empty(0)

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def weights(self) -> Floats:
        """`(n,)`, their sum is one."""
        return normalized(self.log_weights)[0]

    @property
    def rear(self) -> Floats:
        """Rear-axle poses `(n, 3)`."""
        return move_reference_point(self.poses, -self._wheelbase_m)

    @property
    def slip_rad_per_mps2(self) -> float:
        """Outward slip of the rear axle per lateral acceleration, in the mean."""
        return float(self._slips @ self.weights)

    def place(self, rear: Floats, log_weights: Floats, slips: Floats | None = None) -> None:
        """Put all particles at rear-axle poses `(n, 3)`, with slips of any car if not told."""
        self.poses = move_reference_point(rear, self._wheelbase_m)
        self.poses[:, 2] = wrap_angle(self.poses[:, 2])
        self.log_weights = log_weights
        self._slips = self._drawn_slips(len(rear)) if slips is None else slips

    def move(self, arcs: Iterable[Arc], factors: Floats) -> None:
        """Move by the odometry's arcs, each particle with its own noise."""
        moved = sample_motion(
            self.poses, arcs, self._wheelbase_m, self._config, self._rng, self._slips, factors
        )
        moved[:, 2] = wrap_angle(moved[:, 2])
        self.poses = moved

    def mix_in(self, rear: Floats, log_weights: Floats) -> None:
        """Let rear-axle poses take the places of as many particles."""
        kept = low_variance_indices(self.weights, len(self) - len(rear), self._rng)
        self.place(
            np.vstack([self.rear[kept], rear]),
            np.concatenate([np.zeros(len(kept)), log_weights]),
            np.concatenate([self._slips[kept], self._drawn_slips(len(rear))]),
        )

    def resample(self, n_eff: float) -> None:
        """Draw anew by weight where too few particles count, or their number is adaptive."""
        if n_eff >= _RESAMPLE_BELOW * len(self) and not self._config.kld.adaptive:
            return
        weights = self.weights
        count = particles_needed(self.poses, weights, self._config)
        chosen = low_variance_indices(weights, count, self._rng)
        self._slips = jittered(self._slips[chosen], self._rng)
        self.poses = self.poses[chosen]
        self.log_weights = np.zeros(count)

    def _drawn_slips(self, count: int) -> Floats:
        """Slip of newcomers: from what is known of any car, for which none is negative."""
        mean, sd = self._config.odometry.slip_rad_per_mps2, _SLIP_SD_RAD_PER_MPS2
        return np.abs(mean + sd * self._rng.standard_normal(count))
