"""How likely a scan of poles is at a pose: position and width of each pole, clutter, misses.

`pair_gains` states the formula in plain numpy; the C++ kernel computes the same for all particles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.localize.config import LocalizeConfig
from polemap.localize.particle_filter import assignment
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.vehicle.pose import inverse_transform_points, rotate_covariance, transform_points

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class PoleModel:
    """How seen poles relate to map poles.

    Attributes:
        beta_p: weight of the position term against the width term.
        width_sd_m: expected deviation of a seen width from the mapped one.
        clutter_per_m2: intensity of the Poisson process of false poles, on the ground.
        clutter_width_span_m: false poles are as likely at any width within this span.
        position_floor_m: standard deviation added to every scan position; what the detector's
            own covariance does not know (calibration, a trunk that is no line).
        existence: whether a seen pole counts by the probability that it is one.
    """

    beta_p: float
    width_sd_m: float
    clutter_per_m2: float
    position_floor_m: float
    clutter_width_span_m: float = 1.0
    existence: bool = True

    @classmethod
    def of(cls, config: LocalizeConfig) -> PoleModel:
        """As the settings have it."""
        return cls(
            beta_p=config.beta_p,
            width_sd_m=config.poles.width_sd_m,
            clutter_per_m2=config.clutter_per_m2,
            position_floor_m=config.poles.position_floor_m,
            existence=config.poles.existence,
        )

    @property
    def log_width_gain(self) -> float:
        """Log ratio of the width densities of a right pair at zero error and of clutter."""
        return float(np.log(self.clutter_width_span_m / (np.sqrt(2 * np.pi) * self.width_sd_m)))


@dataclass(frozen=True, slots=True)
class PoseLikelihoods:
    """What a scan says about each of n poses.

    Attributes:
        log_likelihood: `(n,)`, relative to a scan that is all clutter in a world without poles.
        log_fit: `(n,)` sum of `-d / 2` over the matched pairs, with d of equation (7); at most 0.
        expected: `(n,)` detections of map poles to be hoped for in the view.
        matched: `(n,)` pairs of the optimal assignment.
        assignment: `(n, z)` landmark of every seen pole, -1 for clutter; `(0, z)` if not asked for.
    """

    log_likelihood: Floats
    log_fit: Floats
    expected: Floats
    matched: Ints
    assignment: Ints


def pole_log_likelihood(
    poses: Floats,
    scan: Detections,
    landmarks: Landmarks,
    model: PoleModel,
    *,
    view: VisibleRegion | None = None,
    want_assignment: bool = False,
    backend: assignment.Backend = "auto",
    threads: int = 1,
) -> PoseLikelihoods:
    """Log-likelihood of a scan for each of many poses under the optimal one-to-one assignment.

    A pair of pole z and landmark l is worth `log(p_D N(z; l, S / beta_p) N(width) / kappa)`, with
    `S = S_z + S_l`, less the price `log(1 - p_D)` of a miss that it saves when l is in view; the
    assignment of the highest sum counts, and pairs that are worth less than none are left out.
    Misses are counted for landmarks inside `view` only, and count less towards the limit R of its
    range, which is no wall: by the factor `1 - (r / R)^2`.

    Args:
        poses: `(n, 3)` of the vehicle (rear axle) in the map.
        view: where the sensor could have seen a pole; None charges no misses.

    Raises:
        ValueError: a pose, position or covariance is not finite.

    Source: Spangenberg (2016), equations (7) and (8).
    """
    covariance, log_gain = _prepared(scan, model)
    if assignment.use_kernel(backend):
        sector = np.zeros(5)
        free_range = np.empty(0)
        if view is not None:
            sector[:2] = view.origin_vehicle_m
            sector[2:] = (view.bearing_min_rad, view.bearing_max_rad, view.range_min_m)
            free_range = view.free_range_m
        return PoseLikelihoods(
            *assignment.assignment_kernel.pole_log_likelihood(
                poses,
                scan.points_vehicle_m.reshape(-1, 2),
                covariance,
                scan.width_m,
                log_gain,
                landmarks.points_m,
                landmarks.covariance_m2,
                landmarks.width_m,
                landmarks.detection,
                sector,
                free_range,
                model.beta_p,
                model.width_sd_m,
                model.log_width_gain,
                want_assignment,
                threads,
            )
        )
    return _likelihood_scipy(np.asarray(poses), scan, landmarks, model, view, want_assignment)


def joint_likelihoods(parts: Sequence[PoseLikelihoods]) -> PoseLikelihoods:
    """Of observations that say independent things of the same poses; without assignments."""
    return PoseLikelihoods(
        np.sum([part.log_likelihood for part in parts], axis=0),
        np.sum([part.log_fit for part in parts], axis=0),
        np.sum([part.expected for part in parts], axis=0),
        np.sum([part.matched for part in parts], axis=0, dtype=np.int32),
        parts[0].assignment[:0],
    )


def _prepared(scan: Detections, model: PoleModel) -> tuple[Floats, Floats]:
    """Covariances `(z, 3)` with the floor, and the log factor of each pole against clutter."""
    full = scan.covariance_m2.reshape(-1, 2, 2)
    floor = model.position_floor_m**2
    covariance = np.empty((len(full), 3))
    covariance[:, 0], covariance[:, 1] = full[:, 0, 0] + floor, full[:, 1, 1] + floor
    covariance[:, 2] = full[:, 0, 1]
    existence = np.ones(len(full))
    if model.existence:
        existence = np.minimum(np.maximum(scan.probability, 1e-3), 1.0)
    return covariance, np.asarray(np.log(existence / model.clutter_per_m2))


def pair_gains(
    pose: Floats,
    scan: Detections,
    landmarks: Landmarks,
    model: PoleModel,
    view: VisibleRegion | None,
) -> tuple[Floats, Floats, Floats]:
    """Worth and fit `(z, m)` of every pair for one pose, and how far `(m,)` are in view, 0 to 1."""
    covariance, log_gain = _prepared(scan, model)
    seen = transform_points(pose, scan.points_vehicle_m.reshape(-1, 2))
    own = np.empty((len(seen), 2, 2))
    own[:, 0, 0], own[:, 1, 1] = covariance[:, 0], covariance[:, 1]
    own[:, 0, 1] = own[:, 1, 0] = covariance[:, 2]
    mapped = np.empty((len(landmarks), 2, 2))
    mapped[:, 0, 0], mapped[:, 1, 1] = landmarks.covariance_m2[:, 0], landmarks.covariance_m2[:, 1]
    mapped[:, 0, 1] = mapped[:, 1, 0] = landmarks.covariance_m2[:, 2]
    total = rotate_covariance(own, pose[2])[:, np.newaxis] + mapped[np.newaxis]
    offset = landmarks.points_m[np.newaxis] - seen[:, np.newaxis]
    mahalanobis2 = np.einsum("zmi,zmij,zmj->zm", offset, np.linalg.inv(total), offset)
    log_hit, log_miss = np.log(landmarks.detection), np.log1p(-landmarks.detection)
    width_error = (scan.width_m[:, np.newaxis] - landmarks.width_m) / model.width_sd_m
    known = ~np.isnan(width_error)
    fit = -0.5 * model.beta_p * mahalanobis2 - 0.5 * np.where(known, width_error, 0.0) ** 2
    fade = np.zeros(len(landmarks))
    if view is not None and len(landmarks):
        local = inverse_transform_points(pose, landmarks.points_m)
        distance = np.hypot(*(local - view.origin_vehicle_m).T)
        fade = np.where(view.contains(local), 1 - (distance / view.free_range_m.max()) ** 2, 0.0)
    gain = (
        log_gain[:, np.newaxis]
        + log_hit
        + np.log(model.beta_p / (2 * np.pi))
        - 0.5 * np.log(np.linalg.det(total))
        + np.where(known, model.log_width_gain, 0.0)
        + fit
        - fade * log_miss
    )
    return gain, fit, fade


def _likelihood_scipy(
    poses: Floats,
    scan: Detections,
    landmarks: Landmarks,
    model: PoleModel,
    view: VisibleRegion | None,
    want_assignment: bool,
) -> PoseLikelihoods:
    for name, values in (("poses", poses), ("points", scan.points_vehicle_m)):
        if not np.isfinite(values).all():
            raise ValueError(f"{name} holds a value that is not finite")
    count = len(poses)
    log_likelihood, log_fit = np.empty(count), np.empty(count)
    matches = np.full((count, len(scan)), -1, dtype=np.int32)
    expected = np.empty(count)
    log_miss = np.log1p(-landmarks.detection)
    for i, pose in enumerate(poses):
        gain, fit, fade = pair_gains(pose, scan, landmarks, model, view)
        total, matches[i] = assignment.assign(-gain, 0.0, backend="scipy")
        matched_row = np.flatnonzero(matches[i] >= 0)
        log_likelihood[i] = fade @ log_miss - float(total)
        log_fit[i] = fit[matched_row, matches[i, matched_row]].sum()
        expected[i] = fade @ landmarks.detection
    # a pair of gain 0 ties with none; the kernel leaves it out, and so does the count
    matched = (matches >= 0).sum(axis=1).astype(np.int32)
    kept = matches if want_assignment else matches[:0]
    return PoseLikelihoods(log_likelihood, log_fit, expected, matched, kept)
