"""The sensor model applied to all particles: the map poles in reach, and the share of a scan that
counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.localize.config import LocalizeConfig, PolesConfig
from polemap.localize.particle_filter.corner_sides import are_corners, by_turn, corner_model
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.localize.particle_filter.particles import effective_count, normalized
from polemap.localize.particle_filter.sensor_model import (
    PoleModel,
    PoseLikelihoods,
    joint_likelihoods,
    pole_log_likelihood,
)
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import inverse_transform_points

Floats = NDArray[np.float64]

_CELL_M = 20.0


def default_view(config: PolesConfig) -> VisibleRegion:
    """The sector that is taken for a sensor that does not say where it looked."""
    return VisibleRegion(
        origin_vehicle_m=np.zeros(2),
        bearing_min_rad=-config.view_half_angle_rad,
        bearing_max_rad=config.view_half_angle_rad,
        range_min_m=0.0,
        free_range_m=np.array([config.view_range_m]),
    )


def reach_of(scan: Detections, view: VisibleRegion) -> float:
    """Distance from the rear axle beyond which no map pole can matter to the scan."""
    reach = float(np.hypot(*view.origin_vehicle_m)) + float(np.max(view.free_range_m))
    if len(scan):
        reach = max(reach, float(np.hypot(*scan.points_vehicle_m.T).max()))
    return reach + 3.0


@dataclass(frozen=True, slots=True)
class Match:
    """What one pose makes of a scan.

    Attributes:
        matched, in_view: poles that match, and map poles in view.
        expected: detections to be hoped for.
        misfit: sum of the squared distances of equation (7) over those that match.
        assignment: `(z,)` landmark of every seen pole, -1 for clutter.
        without_corners: the same without corners; None where there are none.
    """

    matched: int
    in_view: int
    expected: float
    misfit: float = 0.0
    assignment: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    without_corners: Match | None = None

    @property
    def poles(self) -> Match:
        """What it makes of the poles."""
        return self if self.without_corners is None else self.without_corners


class PoleWeigher:
    """Holds scans against a map: the map's arrays, the settings, and nothing else."""

    def __init__(self, pole_map: PoleMap, config: LocalizeConfig) -> None:
        self._map = pole_map
        self._p_detection, self._poles = config.p_detection, config.poles
        self._model = PoleModel.of(config)
        self._view = default_view(config.poles)
        self._threads = config.threads
        # the last rows of the map that were in reach, and what stands there
        self._near: tuple[bytes, Landmarks] | None = None

    def use_map(self, pole_map: PoleMap) -> None:
        """Go on with other poles, of the same frame."""
        self._map, self._near = pole_map, None

    def near(self, rear_poses: Floats, scan: Detections) -> Landmarks:
        """Map poles within reach of any of the poses `(n, 3)`; scattered ones ask by cells."""
        reach = reach_of(scan, self._view_of(scan))
        east, north = rear_poses[:, 0], rear_poses[:, 1]
        low, high = np.array([east.min(), north.min()]), np.array([east.max(), north.max()])
        half = float(np.hypot(*(high - low))) / 2
        if half <= _CELL_M:
            return self._landmarks(self._map.within((low + high) / 2, reach + half))
        cells = np.unique(np.floor(rear_poses[:, :2] / _CELL_M).astype(np.int64), axis=0)
        centres = (cells + 0.5) * _CELL_M
        found = [self._map.within(centre, reach + 0.75 * _CELL_M) for centre in centres]
        return self._landmarks(np.unique(np.concatenate(found)))

    def _landmarks(self, rows: NDArray[np.int64]) -> Landmarks:
        key = rows.tobytes()
        if self._near is None or self._near[0] != key:
            found = Landmarks.of(
                self._map,
                self._p_detection,
                rows,
                uncertain=self._poles.map_covariance,
                doubtful=self._poles.existence,
            )
            self._near = key, found
        return self._near[1]

    def weigh(
        self, rear_poses: Floats, scan: Detections, landmarks: Landmarks | None = None
    ) -> PoseLikelihoods:
        """Likelihood of the scan for every rear-axle pose `(n, 3)`.

        Landmarks of different kinds are never matched, so each kind is a problem of its own.

        Source: Spangenberg (2016), equations (7) and (8).
        """
        landmarks = self.near(rear_poses, scan) if landmarks is None else landmarks
        kinds = _kinds_of(scan, landmarks)
        if len(kinds) < 2:
            return self._weigh_kind(rear_poses, scan, landmarks)
        parts = [
            self._weigh_kind(
                rear_poses, scan.of_kinds(kind), landmarks.take(landmarks.kind == kind)
            )
            for kind in kinds
        ]
        return joint_likelihoods(parts)

    def _weigh_kind(
        self,
        rear_poses: Floats,
        scan: Detections,
        landmarks: Landmarks,
        *,
        want_assignment: bool = False,
    ) -> PoseLikelihoods:
        corners = are_corners(scan, landmarks)
        model = corner_model(self._model) if corners else self._model

        def weigh(poses: Floats, seen: Detections, mapped: Landmarks) -> PoseLikelihoods:
            return pole_log_likelihood(
                poses,
                seen,
                mapped,
                model,
                view=self._view_of(scan),
                want_assignment=want_assignment,
                threads=self._threads,
            )

        if corners:
            return by_turn(weigh, rear_poses, scan, landmarks)
        return weigh(rear_poses, scan, landmarks)

    def match(self, pose: Floats, scan: Detections, landmarks: Landmarks) -> Match:
        """Match a scan from a single rear-axle pose `(3,)`."""
        assignment = np.full(len(scan), -1, dtype=np.int32)
        parts: list[PoseLikelihoods] = []
        found_kinds = kinds = _kinds_of(scan, landmarks)
        if len(kinds) == 1:
            alone = self._weigh_kind(pose[np.newaxis], scan, landmarks, want_assignment=True)
            assignment[:] = alone.assignment[0]
            parts.append(alone)
            kinds = []
        # a scan of no pole in a map of none misses nothing, and is a part all the same
        elif not kinds:
            kinds = [int(LandmarkKind.POLE)]
        for kind in kinds:
            mine, theirs = scan.kind == kind, np.flatnonzero(landmarks.kind == kind)
            part = self._weigh_kind(
                pose[np.newaxis],
                scan.of_kinds(kind),
                landmarks.take(landmarks.kind == kind),
                want_assignment=True,
            )
            found = part.assignment[0]
            assignment[mine] = np.where(found >= 0, theirs[found] if len(theirs) else -1, -1)
            parts.append(part)
        local = inverse_transform_points(pose, landmarks.points_m)
        inside = self._view_of(scan).contains(local)
        poles: Match | None = None
        if LandmarkKind.CORNER in found_kinds:
            rest = [
                part
                for part, kind in zip(parts, found_kinds, strict=True)
                if kind != LandmarkKind.CORNER
            ]
            in_view = int(inside[landmarks.kind != LandmarkKind.CORNER].sum())
            poles = _joint_match(rest, in_view, assignment[scan.kind != LandmarkKind.CORNER])
        return replace(_joint_match(parts, int(inside.sum()), assignment), without_corners=poles)

    def _view_of(self, scan: Detections) -> VisibleRegion:
        return scan.view if scan.view is not None else self._view


def _joint_match(
    parts: list[PoseLikelihoods], in_view: int, assignment: NDArray[np.int32]
) -> Match:
    """What parts of a scan make of one pose together."""
    if not parts:
        return Match(0, in_view, 0.0, 0.0, assignment)
    result = parts[0] if len(parts) == 1 else joint_likelihoods(parts)
    return Match(
        int(result.matched[0]),
        in_view,
        float(result.expected[0]),
        -2.0 * float(result.log_fit[0]),
        assignment,
    )


def _kinds_of(scan: Detections, landmarks: Landmarks) -> list[int]:
    """Kinds of which either has any, sorted; most often one, and asked for at every update."""
    return sorted({*scan.kind.tolist(), *landmarks.kind.tolist()})


def counted_share(moved_m: float, elapsed_s: float, config: PolesConfig) -> float:
    """How much of a scan's likelihood counts, 0 to 1, as the settings have it."""
    if config.scan_errors == "independent":
        return 1.0
    return independent_share(moved_m, elapsed_s, config)


def independent_share(moved_m: float, elapsed_s: float, config: PolesConfig) -> float:
    """How much of a scan is independent of the last one, 0 to 1.

    Errors of tracked stereo poles, and of the map, stay the same from one scan to the next, so n
    scans are not n measurements. For errors whose correlation falls exponentially with the way (or
    the time), a long row of scans is worth one independent scan for every two correlation
    lengths; the likelihood of each is raised to that power, whatever the frame rate.
    """
    share = moved_m / (2.0 * config.correlation_m) + elapsed_s / (2.0 * config.correlation_s)
    return float(min(1.0, share))


def tempered(
    log_weights: Floats, log_likelihood: Floats, share: float, min_effective: float
) -> tuple[Floats, float]:
    """Log-weights after `share` of the evidence, and what was used: less where that would leave
    fewer than `min_effective` effective particles (wide-spread ones under a sharp measurement).
    """

    def after(part: float) -> Floats:
        return np.asarray(log_weights + part * log_likelihood)

    def enough(part: float) -> bool:
        return effective_count(normalized(after(part))[0]) >= min_effective

    if enough(share) or not enough(0.0):
        return after(share), share
    return after(used := _largest(enough, share)), used


def _largest(good: Callable[[float], bool], upper: float) -> float:
    low, high = 0.0, upper
    for _ in range(8):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if good(middle) else (low, middle)
    return low
