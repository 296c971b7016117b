"""The particles: where they stand, how each guesses the car's slip, what each weighs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from polemap.localize.config import LocalizeConfig
from polemap.localize.odometry_history import Arc
from polemap.localize.odometry_watch import Held
from polemap.localize.particle_filter.estimate import mean_and_covariance
from polemap.localize.particle_filter.free_motion import FreeMotion
from polemap.localize.particle_filter.motion_model import sample_motion
from polemap.localize.particle_filter.odometry_faults import OdometryFaults
from polemap.vehicle.pose import move_reference_point, rotate, wrap_angle

Floats = NDArray[np.float64]

# share of effective particles below which they are drawn anew (S16, section IV)
_RESAMPLE_BELOW = 0.5
# log-weight of a particle that followed an odometry that took it back
_DROPPED = -5.0
# where hardly any particle should be faulty, a few are no evidence
_LEAST_EXPECTED = 0.02
# what odometry may be wrong by, along and in yaw, over a way on which no pole was found
_ASTRAY_M, _ASTRAY_SHARE, _ASTRAY_RADPM, _ASTRAY_MAX_RAD = 0.3, 0.08, 0.015, 0.25
# kernel that parts survivors of one particle, as a share of the spread (Liu and West 2001)
_KERNEL = 0.1


class ParticleSet:
    """Front-axle poses `(n, 3)`, slips `(n,)` and log-weights `(n,)`; empty until `place_all`.

    Attributes:
        motion: of those that do not follow the odometry, None while all do.
        faults: which of them hold the odometry for wrong.
    """

    def __init__(
        self, config: LocalizeConfig, wheelbase_m: float, rng: np.random.Generator
    ) -> None:
        self._config = config
        self._wheelbase_m = wheelbase_m
        self._rng = rng
        self._kept: dict[str, Floats] = {}
        self._moments: tuple[Floats, Floats] | None = None
        self.poses = np.empty((0, 3))
        self.log_weights = np.empty(0)
        self._slips = np.empty(0)
        self.motion: FreeMotion | None = None
        # draws of its own, so that a sound drive's other draws do not depend on it
        self._fault_rng = rng.spawn(1)[0]
        self.faults = OdometryFaults(0, self._fault_rng)

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def poses(self) -> Floats:
        """Front-axle poses `(n, 3)`, read-only: what follows from them is kept."""
        return self._poses

    @poses.setter
    def poses(self, poses: Floats) -> None:
        self._poses = _read_only(poses)
        for name in ("rear", "sine", "cosine"):
            self._kept.pop(name, None)
        self._moments = None

    @property
    def log_weights(self) -> Floats:
        """`(n,)`, read-only."""
        return self._log_weights

    @log_weights.setter
    def log_weights(self, log_weights: Floats) -> None:
        self._log_weights = _read_only(log_weights)
        self._kept.pop("weights", None)
        self._moments = None

    @property
    def weights(self) -> Floats:
        """`(n,)`, their sum is one; read-only."""
        if "weights" not in self._kept:
            self._kept["weights"] = _read_only(normalized(self._log_weights)[0])
        return self._kept["weights"]

    @property
    def rear(self) -> Floats:
        """Rear-axle poses `(n, 3)`, read-only."""
        if "rear" not in self._kept:
            rear = move_reference_point(self._poses, -self._wheelbase_m)
            self._kept["rear"] = _read_only(rear)
        return self._kept["rear"]

    @property
    def _direction(self) -> tuple[Floats, Floats]:
        """Sine and cosine of the yaws `(n,)`."""
        if "sine" not in self._kept:
            yaw = self.rear[:, 2]
            self._kept["sine"], self._kept["cosine"] = np.sin(yaw), np.cos(yaw)
        return self._kept["sine"], self._kept["cosine"]

    @property
    def moments(self) -> tuple[Floats, Floats]:
        """Mean `(3,)` and covariance `(3, 3)` of the rear-axle poses, read-only."""
        if self._moments is None:
            mean, covariance = mean_and_covariance(self.rear, self.weights, self._direction)
            self._moments = _read_only(mean), _read_only(covariance)
        return self._moments

    @property
    def slip_rad_per_mps2(self) -> float:
        """Outward slip of the rear axle per lateral acceleration, in the mean."""
        return float(self._slips @ self.weights)

    def place_all(self, rear: Floats, log_weights: Floats, slips: Floats | None = None) -> None:
        """Put all particles at rear-axle poses `(n, 3)`, with slips of any car if not told."""
        poses = move_reference_point(rear, self._wheelbase_m)
        poses[:, 2] = wrap_angle(poses[:, 2])
        self.poses = poses
        self.log_weights = log_weights
        if len(self.faults.faulty) != len(rear):
            self.faults = OdometryFaults(len(rear), self._fault_rng)
        self._slips = self._drawn_slips(len(rear)) if slips is None else slips

    def move_along(self, arcs: Iterable[Arc], factors: Floats) -> None:
        """Move by the odometry's arcs, each particle with its own noise."""
        moved = sample_motion(
            self.poses, arcs, self._wheelbase_m, self._config, self._rng, self._slips, factors,
            self.motion, self.faults, self.rear,
        )  # fmt: skip
        moved[:, 2] = wrap_angle(moved[:, 2])
        self.poses = moved

    def release(self, held: Held, share: float, *, sure: bool) -> None:
        """Let a share of the particles move by rates of their own; see `FreeMotion`."""
        self.motion = FreeMotion(len(self), held, share, self._rng, sure=sure)

    def drop_followers(self) -> None:
        """What the odometry said is known to be wrong: those that followed it count for little."""
        if self.motion is None or not self.motion.free.any():
            return
        # who followed for a while only has still been led off, unless all have
        left = ~self.motion.followed if not self.motion.followed.all() else self.motion.free
        self.log_weights = self.log_weights + np.where(left, 0.0, _DROPPED)

    @property
    def following_share(self) -> float:
        """Weight of the particles that follow the odometry."""
        return 1.0 if self.motion is None else float(self.weights[~self.motion.free].sum())

    @property
    def faulty_share(self) -> float:
        """Weight of the particles that hold the odometry for wrong."""
        return float(self.weights[self.faults.faulty].sum())

    @property
    def fault_evidence(self) -> float:
        """Bayes factor of an odometry that is wrong: odds of the faulty against those of chance."""
        share, expected = self.faulty_share, self.faults.expected
        odds = share / max(1.0 - share, 1e-9)
        return odds * (1.0 - expected) / max(expected, _LEAST_EXPECTED)

    def scatter(self, share: float, way_m: float) -> None:
        """Put a share of them where odometry that was wrong over so long a way may have led to."""
        noise = self._fault_rng.standard_normal((2, len(self)))
        chosen = self._fault_rng.random(len(self)) < share
        along = np.where(chosen, (_ASTRAY_M + _ASTRAY_SHARE * way_m) * noise[0], 0.0)
        turn = np.where(chosen, min(_ASTRAY_RADPM * way_m, _ASTRAY_MAX_RAD) * noise[1], 0.0)
        rear = self.rear.copy()
        rear[:, :2] += rotate(np.stack([along, 0.5 * way_m * turn], axis=1), rear[:, 2])
        rear[:, 2] += turn
        self.place_all(rear, self.log_weights, self._slips)

    def replace_some(self, rear: Floats, log_weights: Floats) -> None:
        """Let rear-axle poses take the places of as many particles."""
        kept = low_variance_indices(self.weights, len(self) - len(rear), self._rng)
        if self.motion is not None:
            self.motion.take_with_newcomers(kept, len(self))
        self.faults.take(kept)
        self.faults.join(len(self))
        self.place_all(
            np.vstack([self.rear[kept], rear]),
            np.concatenate([np.zeros(len(kept)), log_weights]),
            np.concatenate([self._slips[kept], self._drawn_slips(len(rear))]),
        )

    def resample_by_weight(self, n_eff: float) -> None:
        """Draw anew by weight where too few particles count, or their number is adaptive."""
        if n_eff >= _RESAMPLE_BELOW * len(self) and not self._config.kld.adaptive:
            return
        weights = self.weights
        count = particles_needed(self.poses, weights, self._config)
        chosen = low_variance_indices(weights, count, self._rng)
        self._slips = jittered(self._slips[chosen], self._rng)
        if self.motion is not None:
            self.motion.take(chosen)
        self.faults.take(chosen)
        self.poses = self.poses[chosen]
        self.log_weights = np.zeros(count)

    def _drawn_slips(self, count: int) -> Floats:
        """Slip of newcomers: from what is known of any car, for which none is negative."""
        odometry = self._config.odometry
        mean, sd = odometry.rear_slip_rad_per_mps2, odometry.slip_sd_rad_per_mps2
        return np.abs(mean + sd * self._rng.standard_normal(count))


def _read_only(values: Floats) -> Floats:
    view = values.view()
    view.setflags(write=False)
    return view


def normalized(log_weights: Floats) -> tuple[Floats, float]:
    """Weights `(n,)` that sum to one, and the log of the sum that they had.

    If no particle has any weight left they all get the same.
    """
    top = float(np.max(log_weights))
    if not np.isfinite(top):
        return np.full(len(log_weights), 1.0 / len(log_weights)), -np.inf
    weights = np.exp(log_weights - top)
    total = float(weights.sum())
    return weights / total, top + float(np.log(total))


def log_mean(log_values: Floats, weights: Floats) -> float:
    """Log of the weighted mean of values `(n,)` that are given by their logs."""
    top = float(np.max(log_values))
    if not np.isfinite(top):
        return -np.inf
    return top + float(np.log(weights @ np.exp(log_values - top)))


def effective_count(weights: Floats) -> float:
    """N_eff, the number of equally weighted particles that would be worth as much."""
    return float(1.0 / np.dot(weights, weights))


def low_variance_indices(
    weights: Floats, count: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Indices `(count,)` of the particles that live on, sorted.

    One random number places a comb of `count` equal teeth over the cumulated weights, so a
    particle of weight w survives floor(count w) or ceil(count w) times.

    Source: Thrun, Burgard, Fox (2005), table 4.4.
    """
    cumulated = np.cumsum(weights)
    teeth = (rng.random() + np.arange(count)) / count * cumulated[-1]
    indices = np.searchsorted(cumulated, teeth, side="right")
    return np.asarray(np.minimum(indices, len(weights) - 1), dtype=np.int64)


def jittered(values: Floats, rng: np.random.Generator) -> Floats:
    """A constant that every particle guesses `(n,)`, smoothed after resampling.

    Survivors of one particle guess alike; a kernel parts them again, and drawing all values towards
    their mean as much keeps the variance as it was.

    Source: Liu, West (2001), section 10.3.2, with a kernel of a tenth of the spread.
    """
    mean, sd = float(values.mean()), float(values.std())
    shrink = np.sqrt(1.0 - _KERNEL**2)
    noise = rng.standard_normal(len(values))
    return np.asarray(mean + shrink * (values - mean) + _KERNEL * sd * noise)


def particles_needed(poses: Floats, weights: Floats, config: LocalizeConfig) -> int:
    """The set number of particles, or what KLD sampling asks for where that is chosen."""
    if not config.kld.adaptive:
        return config.particles
    return kld_count(
        poses,
        weights,
        least=config.kld.particles_min,
        most=config.kld.particles_max,
    )


def kld_count(
    poses: Floats,
    weights: Floats,
    *,
    least: int,
    most: int,
    error: float = 0.05,
    quantile: float = 2.33,
    bin_m: float = 0.25,
    bin_rad: float = 0.05,
) -> int:
    """Particles needed so that the sampled density stays within `error` (Kullback-Leibler
    distance) of the true one, from the number of bins of (E, N, yaw) that hold weight.

    Source: Fox (2003), equation (7), with the Wilson-Hilferty quantile; Thrun et al., table 8.4.
    """
    scale = np.array([bin_m, bin_m, bin_rad])
    offset = poses - poses[0]
    offset[:, 2] = wrap_angle(offset[:, 2])
    # weightless particles will not be drawn, so their bins do not count
    alive = weights > 1e-3 / len(weights)
    occupied = len(np.unique(np.floor(offset[alive] / scale).astype(np.int64), axis=0))
    if occupied <= 1:
        return least
    k = occupied - 1.0
    tail = 2.0 / (9.0 * k)
    needed = k / (2.0 * error) * (1.0 - tail + np.sqrt(tail) * quantile) ** 3
    return int(np.clip(np.ceil(needed), least, most))
