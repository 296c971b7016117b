"""The vision front end: an image to heading and lateral offset in the lane, with covariance.

image -> bird's-eye view -> Laplacian of Gaussian -> ridge points -> RANSAC line -> measurement
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.road_plane import BirdsEye, Grey, RoadCamera, RoadGrid

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LaneSettings:
    """How markings are found; lengths on the road."""

    marking_width_m: float = 0.15
    response_sds: float = 3.0
    least_response: float = 1.5
    tolerance_m: float = 0.12
    scatter_limit_m: float = 0.07  # chance points fill the tolerance evenly: 0.1 m
    trials: int = 150
    least_points: int = 30
    least_span_m: float = 6.0
    heading_limit_rad: float = 0.25
    curvature_limit_per_m: float = 0.01
    gate_offset_m: float = 0.5
    gate_heading_rad: float = 0.05
    gate_frames: int = 5
    systematic_heading_rad: float = 0.002
    systematic_offset_m: float = 0.01


@dataclass(frozen=True, slots=True)
class Marking:
    """A line of markings on the road: `y = a + b x + c x^2`, camera frame, and its points."""

    offset_m: float
    slope: float
    curvature_half_per_m: float
    covariance: Floats
    points_m: Floats

    def at(self, x_m: Floats | float) -> Floats:
        """y at x."""
        x = np.asarray(x_m, dtype=np.float64)
        return np.asarray(self.offset_m + self.slope * x + self.curvature_half_per_m * x * x)


@dataclass(frozen=True, slots=True)
class LaneObservation:
    """Car in the lane, measured at `stamp_s`: what the `camera` kind of the estimators takes.

    Attributes:
        stamp_s: when the image was taken; arrival_s: when this was ready.
        heading_rad: of the car against the marking at the preview distance, left positive.
        lateral_offset_m: of the car at the preview point from the marking, left positive.
        covariance: `(2, 2)` of the two.
        marking: the line it rests on.
        side: "left" or "right" marking of the car's own lane.
    """

    stamp_s: float
    arrival_s: float
    heading_rad: float
    lateral_offset_m: float
    covariance: Floats
    marking: Marking
    side: str


class LaneFinder:
    """Finds the nearest marking left or right of the car and keeps to it from frame to frame.

    A curve is fitted where a line leaves more than it should; heading is then that of its
    tangent at the preview distance. A frame whose line jumps out of the continuity gate gives
    nothing; after `gate_frames` of them in a row the search starts afresh.

    Source: W12 III (mapping, LoG, RANSAC) with errata.md, Road mapping.
    """

    def __init__(
        self,
        camera: RoadCamera,
        *,
        preview_m: float = 8.0,
        grid: RoadGrid | None = None,
        settings: LaneSettings | None = None,
        rng: np.random.Generator,
    ) -> None:
        self.settings = settings or LaneSettings()
        self.birds_eye = BirdsEye(camera, grid or RoadGrid())
        self.preview_m = preview_m
        self._rng = rng
        self._last: dict[str, Marking] = {}
        self._misses = 0
        across = self.birds_eye.grid.across_m
        # sigma is half the marking's width, so the filter peaks at its centre
        sigma = 0.5 * self.settings.marking_width_m / across
        self._kernel = _ridge_kernel(sigma)
        radius = len(self._kernel) // 2 + 1
        self._valid = cv2.erode(
            self.birds_eye.seen.astype(np.uint8), np.ones((1, 2 * radius + 1), np.uint8)
        ).astype(bool)

    def find(self, image: Grey, stamp_s: float, arrival_s: float) -> LaneObservation | None:
        """The lane in one image `(height, width)` grey, or None where no line can be trusted."""
        points, weights = self.ridge_points(image)
        found = {}
        for side in ("left", "right"):
            marking = self._search(points, weights, side)
            if marking is not None:
                found[side] = marking
        if not found:
            self._misses += 1
            if self._misses >= self.settings.gate_frames:
                self._last.clear()
            return None
        self._misses = 0
        self._last = found
        side = min(found, key=lambda s: abs(float(found[s].covariance[0, 0])))
        return self._observation(found[side], side, stamp_s, arrival_s)

    def ridge_points(self, image: Grey) -> tuple[Floats, Floats]:
        """Centres of bright stripes on the road `(n, 2)` and how strong each is `(n,)`.

        In each row of the bird's-eye view: local maxima of the Laplacian of Gaussian across the
        road that stand out from that picture's own noise.
        """
        grid = self.birds_eye.grid
        view = self.birds_eye.warp(image)
        flat = cv2.blur(view, (1, max(1, round(0.5 / grid.along_m))))
        response = cv2.filter2D(flat, cv2.CV_32F, self._kernel[None, :])
        response[~self._valid] = 0.0
        # the median absolute deviation does not see the few rows of markings
        noise = 1.4826 * float(np.median(np.abs(response[self._valid][::7])))
        limit = max(self.settings.response_sds * noise, self.settings.least_response)
        middle = response[:, 1:-1]
        peak = (middle > limit) & (middle >= response[:, :-2]) & (middle > response[:, 2:])
        rows, columns = np.nonzero(peak)
        strength = middle[rows, columns].astype(np.float64)
        left, right = response[rows, columns], response[rows, columns + 2]
        bend = left - 2.0 * strength + right
        shift = np.where(bend < 0.0, 0.5 * (left - right) / np.where(bend < 0.0, bend, -1.0), 0.0)
        points = grid.to_road(rows.astype(np.float64), columns + 1.0 + shift)
        return points, strength

    def _search(self, points: Floats, weights: Floats, side: str) -> Marking | None:
        s, x, y = self.settings, points[:, 0], points[:, 1]
        last = self._last.get(side)
        if last is not None:
            near = np.abs(y - last.at(x)) < s.gate_offset_m
        else:
            # the car's own lane: its markings pass between 0.4 and 3.2 m beside the car
            beside = y if side == "left" else -y
            near = (beside > 0.2) & (beside < 3.6)
        candidates, strength = points[near], weights[near]
        if len(candidates) < s.least_points:
            return None
        inliers = self._ransac(candidates, strength)
        if inliers is None:
            return None
        marking = self._fit(candidates[inliers])
        return marking if marking is not None and self._continuous(marking, last, side) else None

    def _ransac(self, points: Floats, weights: Floats) -> NDArray[np.bool_] | None:
        """The line `y = a + b x` that most of the strength agrees with; all trials at once."""
        s, n = self.settings, len(points)
        pairs = self._rng.integers(0, n, size=(s.trials, 2))
        x, y = points[:, 0], points[:, 1]
        first, second = pairs[:, 0], pairs[:, 1]
        run = x[second] - x[first]
        good = np.abs(run) > 0.25 * s.least_span_m
        slope = np.where(good, (y[second] - y[first]) / np.where(good, run, 1.0), 9.0)
        good &= np.abs(slope) < s.heading_limit_rad
        if not good.any():
            return None
        slope, first = slope[good], first[good]
        offset = y[first] - slope * x[first]
        beside = np.abs(y - offset[:, None] - slope[:, None] * x) < 1.5 * s.tolerance_m
        capped = np.minimum(weights, 3.0 * np.median(weights))
        best = int(np.argmax(beside @ capped))
        return np.asarray(beside[best])

    def _fit(self, points: Floats) -> Marking | None:
        """Least squares on the inliers, a parabola only where it explains clearly more."""
        s = self.settings
        x, y = points[:, 0], points[:, 1]
        if len(points) < s.least_points or np.ptp(x) < s.least_span_m:
            return None
        # neighbouring rows see the same paint: only every half metre counts as independent
        independent = max(4.0, len(np.unique(np.round(x / 0.5))))
        line, line_rms, line_cov = _least_squares(x, y, 1)
        curve, curve_rms, curve_cov = _least_squares(x, y, 2)
        bent = curve_rms < 0.8 * line_rms and abs(2.0 * curve[2]) < s.curvature_limit_per_m
        chosen, covariance = (curve, curve_cov) if bent else (line, line_cov)
        wide = np.zeros((3, 3))
        size = len(chosen)
        wide[:size, :size] = covariance * len(x) / independent
        if (curve_rms if bent else line_rms) > s.scatter_limit_m:
            return None
        quadratic = float(chosen[2]) if bent else 0.0
        return Marking(float(chosen[0]), float(chosen[1]), quadratic, wide, points)

    def _continuous(self, marking: Marking, last: Marking | None, side: str) -> bool:
        s, x = self.settings, self.preview_m
        place = float(marking.at(x))
        if last is None:
            # a car is not wider than a lane: nothing nearer than half a metre is its marking
            beside = place if side == "left" else -place
            return 0.4 < beside < 3.2
        slope_change = abs(_tangent(marking, x) - _tangent(last, x))
        moved = abs(place - float(last.at(x)))
        return moved < s.gate_offset_m and slope_change < s.gate_heading_rad

    def _observation(
        self, marking: Marking, side: str, stamp_s: float, arrival_s: float
    ) -> LaneObservation:
        """The car's heading and offset are the marking's with the other sign."""
        s, x = self.settings, self.preview_m
        slope = _tangent(marking, x)
        c = 1.0 / sqrt(1.0 + slope * slope)
        jacobian = np.array([[0.0, -c * c, -2.0 * x * c * c], [-c, -c * x, -c * x * x]])
        covariance = jacobian @ marking.covariance @ jacobian.T
        covariance += np.diag([s.systematic_heading_rad**2, s.systematic_offset_m**2])
        offset = -float(marking.at(x)) * c
        return LaneObservation(stamp_s, arrival_s, -atan(slope), offset, covariance, marking, side)


def _tangent(marking: Marking, x_m: float) -> float:
    return marking.slope + 2.0 * marking.curvature_half_per_m * x_m


def _least_squares(x: Floats, y: Floats, degree: int) -> tuple[Floats, float, Floats]:
    """Coefficients from the constant up, RMS of the residual and their covariance."""
    design = np.vander(x, degree + 1, increasing=True)
    solution = np.linalg.lstsq(design, y, rcond=None)[0]
    residual = y - design @ solution
    variance = float(residual @ residual) / max(1, len(x) - degree - 1)
    covariance = variance * np.linalg.inv(design.T @ design)
    return np.asarray(solution), sqrt(variance), np.asarray(covariance)


def _ridge_kernel(sigma_px: float) -> NDArray[np.float32]:
    """Minus the second derivative of a Gaussian, zero mean, unit response to a unit ridge."""
    radius = max(2, int(3.5 * sigma_px + 0.5))
    u = np.arange(-radius, radius + 1) / sigma_px
    kernel = (1.0 - u * u) * np.exp(-0.5 * u * u)
    kernel -= kernel.mean()
    stripe = np.abs(u) <= 1.0
    return np.asarray(kernel / kernel[stripe].sum(), dtype=np.float32)
