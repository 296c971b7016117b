"""The vision front end: an image to heading, offset and curvature in the lane, with covariance.

image -> bird's-eye view -> Laplacian of Gaussian -> ridge points -> RANSAC -> fit of both markings
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.lane_fit import CURVATURE_SD_PER_M, LaneFit, Learned, fit_lane
from polemap.stereo.lane_ransac import agree_on_parabola
from polemap.stereo.lane_ridges import Response, RidgeFilter
from polemap.stereo.road_plane import BirdsEye, Grey, RoadGrid, RoadView

Floats = NDArray[np.float64]
SIDES = ("left", "right")
SURPRISE_SDS = 3.0


@dataclass(frozen=True, slots=True)
class LaneSettings:
    """How markings are found; lengths on the road."""

    marking_width_m: float = 0.15
    response: Response = "isotropic"
    tolerance_m: float = 0.15
    rms_limit: float = 3.0
    least_points: int = 30
    least_span_m: float = 6.0
    slope_limit: float = 0.3
    curvature_limit_per_m: float = 0.016
    lane_width_m: float = 3.5
    lane_width_sd_m: float = 0.35
    width_limits_m: tuple[float, float] = (2.3, 5.0)
    pitch_sd_rad: float = 0.01
    bounce_sd_rad: float = 0.003
    # what may change from picture to picture, and in a second beside it: a car moves sideways by
    # a metre a second, turns by 0.15 rad/s, and enters a bend of 120 m within 10 m at 15 m/s
    gate_offset_m: tuple[float, float] = (0.2, 1.0)
    gate_heading_rad: tuple[float, float] = (0.025, 0.15)
    gate_curvature_per_m: tuple[float, float] = (0.0005, 0.008)
    gate_frames: int = 5
    confirm_frames: int = 3
    start_curvature_per_m: float = 0.012
    # what a road that is not flat and a body that rolls leave beside the fit's own deviation
    systematic_heading_rad: float = 0.0035
    systematic_offset_m: float = 0.022
    systematic_curvature_per_m: float = 0.0008
    systematic_curvature_share: float = 0.2


@dataclass(frozen=True, slots=True)
class LaneObservation:
    """Car in the lane, measured at `stamp_s`: what the `camera` kind of the estimators takes.

    Attributes:
        stamp_s: when the image was taken; arrival_s: when this was ready.
        heading_rad: of the car against the lane at the preview distance, left positive.
        lateral_offset_m: of the car's axis from the lane's middle at the preview, left positive.
        curvature_per_m: of the lane there, positive where it bends to the left.
        covariance: `(3, 3)` of the three.
        width_m: of the lane.
        fit: what it rests on.
        points_m: the paint of each side that was found `(n, 2)`.
    """

    stamp_s: float
    arrival_s: float
    heading_rad: float
    lateral_offset_m: float
    curvature_per_m: float
    covariance: Floats
    width_m: float
    fit: LaneFit
    points_m: dict[str, Floats]


class LaneFinder:
    """Finds the markings left and right of the car and keeps to them from picture to picture.

    Both give one lane: common slope and curvature, its width learned while both are seen, and the
    error of the camera's pitch by which they would diverge. With one marking the other stands a
    lane's width beside it. A picture whose lane jumps out of the continuity gate gives nothing;
    after `gate_frames` of them in a row the search starts afresh. A lane is told from the third
    picture on that agrees.

    Source: W12 III (mapping, LoG, RANSAC) with errata.md, Road mapping; curvature, the common fit
    and the learned width and pitch are not the paper's.
    """

    def __init__(
        self,
        camera: RoadView,
        *,
        preview_m: float = 8.0,
        grid: RoadGrid | None = None,
        settings: LaneSettings | None = None,
        rng: np.random.Generator,
    ) -> None:
        self.settings = s = settings or LaneSettings()
        self.birds_eye = BirdsEye(camera, grid or RoadGrid())
        self.preview_m, self._camera_x_m = preview_m, camera.ahead_m
        self._ridges = RidgeFilter(self.birds_eye, s.marking_width_m, s.response)
        self._rng = rng
        self._width = Learned(s.lane_width_m, s.lane_width_sd_m**2, 0.03**2, 0.02**2)
        # per radian of pitch the markings diverge by one over the height, some 1.5 m
        self._divergence = Learned(
            0.0, (s.pitch_sd_rad / 1.5) ** 2, (s.bounce_sd_rad / 1.5) ** 2, 1e-5**2
        )
        self._last: LaneFit | None = None
        self._last_s, self._elapsed_s = 0.0, 0.0
        self._misses = self._agreed = 0
        self._driven: float | None = None
        self.trials = 0

    def find(
        self, image: Grey, stamp_s: float, arrival_s: float, driven_per_m: float | None = None
    ) -> LaneObservation | None:
        """The lane in one image `(height, width)` grey, or None where none can be trusted.

        `driven_per_m` is the curvature that the car drives now (yaw rate over speed), which the
        lane shares within reason; in bends too narrow for this method nothing is looked for.
        """
        self._driven = driven_per_m
        if driven_per_m is not None and abs(driven_per_m) > self.settings.curvature_limit_per_m:
            self._last, self._agreed = None, 0
            return None
        points, weights = self._ridges.points(image)
        self._elapsed_s = min(max(stamp_s - self._last_s, 0.0), 1.0)
        sides: dict[str, Floats] = {}
        for side in SIDES:
            found = self._search(points, weights, side)
            if found is not None:
                sides[side] = found
        fit = self._fit(sides)
        if fit is None:
            self._misses += 1
            # a lane that is not confirmed yet is given up at once
            if self._misses >= self.settings.gate_frames or self._unconfirmed:
                self._last, self._agreed = None, 0
            return None
        self._misses, self._last, self._last_s = 0, fit, stamp_s
        self._agreed += 1
        seen = self._observation(fit, sides, stamp_s, arrival_s)
        return None if self._unconfirmed else seen

    @property
    def _unconfirmed(self) -> bool:
        return self._agreed < self.settings.confirm_frames

    def _gate(self, gate: tuple[float, float]) -> float:
        return gate[0] + gate[1] * self._elapsed_s

    def _search(self, points: Floats, weights: Floats, side: str) -> Floats | None:
        """Paint of one side `(n, 2)`."""
        s, x, y, last = self.settings, points[:, 0], points[:, 1], self._last
        slopes = (-s.slope_limit, s.slope_limit)
        driven = self._driven or 0.0
        curvatures = (driven - s.start_curvature_per_m, driven + s.start_curvature_per_m)
        if last is not None:
            curvature, free = 2.0 * float(last.state[3]), self._gate(s.gate_curvature_per_m)
            curvatures = (curvature - 2.0 * free, curvature + 2.0 * free)
            off = np.abs(y - self.line(last, side, x))
            turned = self._gate(s.gate_heading_rad) * np.abs(x - self.preview_m)
            near = off < self._gate(s.gate_offset_m) + turned
        else:
            # the car's own lane: its markings pass up to 3.6 m beside the car
            beside = y if side == "left" else -y
            near = (beside > 0.2) & (beside < 3.6)
        candidates = points[near]
        if len(candidates) < s.least_points:
            return None
        agreed = agree_on_parabola(
            candidates, weights[near], tolerance_m=s.tolerance_m, slope=slopes,
            curvature_per_m=curvatures, rng=self._rng,
        )  # fmt: skip
        if agreed is None:
            return None
        self.trials += agreed.trials
        chosen = candidates[agreed.inliers]
        if len(chosen) < s.least_points or np.ptp(chosen[:, 0]) < s.least_span_m:
            return None
        return chosen

    def _fit(self, sides: dict[str, Floats]) -> LaneFit | None:
        """The lane through both sides, or through the one that is in keeping with the rest."""
        if len(sides) == 2:
            fit = self._one_fit(sides)
            if fit is not None:
                return fit
        fits = {side: self._one_fit({side: found}) for side, found in sides.items()}
        good = {side: fit for side, fit in fits.items() if fit is not None}
        if not good:
            return None
        best = min(good, key=lambda side: float(np.trace(good[side].covariance[:3, :3])))
        for side in [one for one in sides if one != best]:
            del sides[side]
        return good[best]

    def _one_fit(self, sides: dict[str, Floats]) -> LaneFit | None:
        s = self.settings
        last = self._last
        believed = (self._driven or 0.0, CURVATURE_SD_PER_M)
        if last is not None:
            believed = (2.0 * float(last.state[3]), self._gate(s.gate_curvature_per_m))
        fit = fit_lane(
            sides, self.preview_m, self._camera_x_m, self._width, self._divergence, believed
        )
        left, right, slope, half, _ = fit.state.tolist()
        low, high = s.width_limits_m
        # a car is not wider than its lane: nothing nearer than half a metre is its marking
        inside = low < left - right < high and left > 0.4 and right < -0.4
        if fit.rms > s.rms_limit or not inside or abs(2.0 * half) > s.curvature_limit_per_m:
            return None
        # paint that is no marking of this lane shows by a width or curvature that nobody expected
        surprise = (
            (left - right - self._width.mean) / self._width.spread**0.5,
            (2.0 * half - believed[0]) / believed[1],
        )
        if max(map(abs, surprise)) > SURPRISE_SDS:
            return None
        if self._driven is not None and abs(2.0 * half - self._driven) > s.start_curvature_per_m:
            return None
        if last is not None:
            before = last.state
            moved = abs(0.5 * (left + right - before[0] - before[1]))
            if moved > self._gate(s.gate_offset_m):
                return None
            if abs(slope - before[2]) > self._gate(s.gate_heading_rad):
                return None
        return fit

    def line(self, fit: LaneFit, side: str, x_m: Floats) -> Floats:
        """y of a marking at x, as the camera sees it: with the divergence of its pitch."""
        u = x_m - self.preview_m
        offset = fit.state[0 if side == "left" else 1]
        spread = 1.0 + fit.state[4] * (x_m - self._camera_x_m)
        return np.asarray(offset * spread + fit.state[2] * u + fit.state[3] * u * u)

    def _observation(
        self, fit: LaneFit, sides: dict[str, Floats], stamp_s: float, arrival_s: float
    ) -> LaneObservation:
        s = self.settings
        if len(sides) == 2:
            cov, across = fit.covariance, np.array([1.0, -1.0])
            self._width.learn(float(across @ fit.state[:2]), float(across @ cov[:2, :2] @ across))
            self._divergence.learn(float(fit.state[4]), float(cov[4, 4]))
        value, covariance = fit.measurement()
        bent = hypot(s.systematic_curvature_per_m, s.systematic_curvature_share * float(value[2]))
        systematic = (s.systematic_heading_rad, s.systematic_offset_m, bent)
        covariance = covariance + np.diag(np.square(systematic))
        heading, offset, curvature = value.tolist()
        width = float(fit.state[0] - fit.state[1]) / hypot(1.0, float(fit.state[2]))
        return LaneObservation(
            stamp_s, arrival_s, heading, offset, curvature, covariance, width, fit, sides
        )
