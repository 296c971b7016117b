"""What the particle filter hands on after a scan: the pose of its particles, and how it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]
Opinion = Literal["contradicted", "confirmed"]
Event = Literal["initialized", "reinitialized", "explored"]

# poses within these of each other are one hypothesis: closer than two poles of a street stand; one
# that holds less than a tenth of the weight is none
_RADIUS_M, _RADIUS_RAD, _SHARE_MIN = 1.5, 0.35, 0.1


@dataclass(frozen=True, slots=True)
class Mode:
    """One cluster of particles: its share of the weight, mean `(3,)` and covariance `(3, 3)`."""

    share: float
    mean: Floats
    covariance: Floats


@dataclass(frozen=True, slots=True)
class KindHealth:
    """What a scan has shown of one kind of landmarks.

    Attributes:
        kind: a `LandmarkKind`.
        seen, matched: landmarks, or pieces of lines.
        suspended: whether the kind is not believed.
        squared_m2: sum of the squared distances of those that match, from their place in the map;
            of lines across them.
    """

    kind: int
    seen: int
    matched: int
    suspended: bool
    squared_m2: float


@dataclass(frozen=True, slots=True)
class LineHealth:
    """Pieces of mapped kinds, those that match a line, and kinds that are not believed."""

    seen: int = 0
    matched: int = 0
    suspended: tuple[str, ...] = ()
    by_kind: tuple[KindHealth, ...] = ()


@dataclass(frozen=True, slots=True)
class HealthRecord:
    """One row of health.csv, without what the output filter adds.

    Attributes:
        matched: seen poles that the optimal assignment at the estimate gives a map pole.
        seen: poles of the scan.
        in_view: map poles that should have been seen from the estimate.
        n_eff: effective particles after weighing, before resampling.
        position_sd_major_m, position_sd_minor_m: of all particles, not of their best mode.
        exploration_ratio: share of the particles that were drawn anew.
        lag_s: arrival less stamp of the scan.
        match_share: smoothed share of the poles that could match and do.
        modes: clusters of particles above the least share.
        mode_share: weight of the best one.
        evidence_share: power that the scan's likelihood was raised to.
        lines: the same of lines; None where the map holds none that count.
        by_kind: the same of every kind that the map holds.
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
    lines: LineHealth | None = None
    by_kind: tuple[KindHealth, ...] = ()


@dataclass(frozen=True, slots=True)
class PfEstimate:
    """What the filter says after a scan.

    Attributes:
        stamp_s, arrival_s: of the scan.
        pose: `(3,)` east, north, yaw of the rear axle in the map's frame.
        covariance: `(3, 3)`.
        healthy: whether the pose may be trusted within three times its stated deviation: one mode,
            narrow, poles that fit or are absent, and an odometry that nothing contradicts.
        modes: clusters of particles; above 1 the pose is one of several possible ones.
        health: the row of health.csv.
        event: "initialized", "reinitialized", "explored" or None.
        usable: whether poles hold the pose, even if odometry is silent or in doubt.
        odometry: what the poles say of the odometry, None where they do not know.
        detector: what of the detector's calibration the way of the car contradicts: "turned",
            "ranges", "stamps"; "unproven" where its looks must speak for it first; or "".
    """

    stamp_s: float
    arrival_s: float
    pose: Floats
    covariance: Floats
    healthy: bool
    modes: int
    health: HealthRecord
    event: Event | None
    usable: bool = True
    odometry: Opinion | None = None
    detector: str = ""


def mean_and_covariance(
    poses: Floats, weights: Floats, direction: tuple[Floats, Floats] | None = None
) -> tuple[Floats, Floats]:
    """Weighted mean `(3,)`, with the circular mean of the yaw, and covariance `(3, 3)`.

    `direction` are sine and cosine of the yaws `(n,)`, where they are known.
    """
    sine, cosine = direction or (np.sin(poses[:, 2]), np.cos(poses[:, 2]))
    centre = np.empty(3)
    # about the first pose, so that 1e6 m of northing cost no digits
    centre[:2] = poses[0, :2] + weights @ (poses[:, :2] - poses[0, :2])
    centre[2] = np.arctan2(weights @ sine, weights @ cosine)
    deviation = poses - centre
    deviation[:, 2] = wrap_angle(deviation[:, 2])
    return centre, (deviation * weights[:, np.newaxis]).T @ deviation


def best_pose(mean: Floats, covariance: Floats, modes: list[Mode]) -> tuple[Floats, Floats]:
    """Pose and covariance of the best mode, also where the others are too light to count: they
    would still pull the mean. What is too light to be a mode counts for what is not known."""
    pose, spread = modes[0].mean, modes[0].covariance
    if len(modes) == 1:
        away = pose - mean
        away[2] = wrap_angle(away[2])
        spread = covariance + np.outer(away, away)
    return pose, spread


def position_sd(covariance: Floats) -> tuple[float, float]:
    """Standard deviations in metres along the major and the minor axis of the position ellipse."""
    half_trace = 0.5 * (covariance[0, 0] + covariance[1, 1])
    root = np.hypot(0.5 * (covariance[0, 0] - covariance[1, 1]), covariance[0, 1])
    return float(np.sqrt(half_trace + root)), float(np.sqrt(max(half_trace - root, 0.0)))


def find_modes(
    poses: Floats,
    weights: Floats,
    *,
    radius_m: float,
    radius_rad: float,
    share_min: float,
    most: int = 6,
) -> list[Mode]:
    """Clusters of particles, heaviest first; those below `share_min` are left out.

    Space is cut into cells of the radius; the heaviest cell starts a cluster, which then moves
    to the mean of all poses within the radius until it rests (mean shift with a flat kernel).
    What it holds is taken away and the search goes on.
    """
    left = np.ones(len(poses), dtype=np.bool_)
    modes: list[Mode] = []
    for _ in range(most):
        if float(weights[left].sum()) < share_min:
            break
        members = _cluster(poses, np.where(left, weights, 0.0), radius_m, radius_rad) & left
        share = float(weights[members].sum())
        if share <= 0.0:
            break
        left &= ~members
        if share >= share_min:
            mean, covariance = mean_and_covariance(poses[members], weights[members] / share)
            modes.append(Mode(share, mean, covariance))
    return sorted(modes, key=lambda mode: -mode.share)


def modes_of(rear: Floats, weights: Floats, mean: Floats, covariance: Floats) -> list[Mode]:
    """The modes of particles with known mean and covariance; narrow ones need no search."""
    major, _ = position_sd(covariance)
    narrow_m, narrow_rad = 0.4 * _RADIUS_M, 0.4 * _RADIUS_RAD
    if major < narrow_m and covariance[2, 2] < narrow_rad**2:
        return [Mode(1.0, mean, covariance)]
    return find_modes(
        rear,
        weights,
        radius_m=_RADIUS_M,
        radius_rad=_RADIUS_RAD,
        share_min=_SHARE_MIN,
    )


def _cluster(
    poses: Floats, weights: Floats, radius_m: float, radius_rad: float
) -> NDArray[np.bool_]:
    scale = np.array([radius_m, radius_m, radius_rad])
    cells = np.floor((poses - poses[0]) / scale).astype(np.int64)
    _, label = np.unique(cells, axis=0, return_inverse=True)
    heaviest = np.argmax(np.bincount(label.ravel(), weights=weights))
    members = label.ravel() == heaviest
    for _ in range(10):
        inside = np.where(members, weights, 0.0)
        mean, _ = mean_and_covariance(poses, inside / inside.sum())
        offset = poses - mean
        offset[:, 2] = wrap_angle(offset[:, 2])
        grown = np.sum((offset / scale) ** 2, axis=1) <= 1.0
        if not (grown & (weights > 0)).any() or np.array_equal(grown, members):
            break
        members = grown
    return np.asarray(members)
