"""Stereo visual odometry on one screen: corners -> tracks -> right view -> motion -> points.

Every corner that is followed keeps its place relative to the camera with a covariance, which each
further sight of it sharpens: the motion of a frame is measured against points that many frames
made, not against one noisy pair.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.errors import StereoError
from polemap.stereo.odometry.corners import (
    Grey,
    bits_of,
    eight_bit,
    find_corners,
    follow,
    grey_shares,
    same_exposure,
    thinned,
)
from polemap.stereo.odometry.disparity_error import TERMS, DisparityError
from polemap.stereo.odometry.motion import (
    AGREEMENT,
    MotionFit,
    fit_motion,
    inverse_symmetric,
    vehicle_step,
)
from polemap.stereo.odometry.sights import Bools, Floats, move, points_of, project
from polemap.stereo.rig import StereoRig

# points are held against a motion that has errors of its own, so they are forgotten a little
_FORGET = 1.1
# fewer points that agree than these are no measurement of six numbers
_INLIERS_MIN = 12
_INLIER_SHARE_MIN = 0.35
# what no car does between two pictures
_ACCELERATION_MAX_MPS2 = 10.0
_TURN_ACCELERATION_MAX_RADPS2 = 8.0
_STILL_CHANGE_M, _STILL_CHANGE_RAD = 0.06, 0.02
# rows of a rectified pair agree to this, about their common offset
_ROW_TOLERANCE_PX = 1.0
_DISPARITY_MIN_PX = 0.5
_FIRST_DISPARITY_PX = 10.0
_LEVELS, _LEVELS_UNSURE = 2, 4
_NEAREST_M = 1.5


@dataclass(frozen=True, slots=True)
class CameraMotion:
    """What the camera did from the pair before to this one.

    Attributes:
        current_from_previous: `(4, 4)`: points in the axes of the left camera before to those of
            the camera now; the identity where `known` is False.
        covariance: `(6, 6)` of translation (m) and rotation vector (rad) in the current axes.
        tracked, inliers: points that were found again, and those that the motion explains.
        known: whether this is a measurement.
        why: what stands against it, empty if nothing does.
        kind: the same without figures, to be counted.
    """

    current_from_previous: Floats
    covariance: Floats
    tracked: int
    inliers: int
    known: bool
    why: str = ""
    kind: str = ""


class CameraOdometry:
    """Follows corners through the rectified grey pairs of one stereo camera.

    Args:
        rig: the camera.

    Attributes:
        disparity_error: learned error of the disparities, subtracted from them.
    """

    def __init__(self, rig: StereoRig) -> None:
        self._rig, self._bits = rig, 8
        self._before: Grey | None = None
        self._shares: Floats = np.empty(0)
        self._stamp_s = 0.0
        self._step_s = 0.0
        self._last = np.eye(4)
        self._sure = False
        self._row_offset_px = 0.0
        self.disparity_error = DisparityError(rig)
        # where points are seen, where all that was seen of them says they are, and how well
        self._seen: Floats = np.empty((0, 3))
        self._sights: Floats = np.empty((0, 3))
        self._spreads: Floats = np.empty((0, 3, 3))
        # derivative of the sights by the error of the disparities
        self._by_error: Floats = np.empty((0, 3, TERMS))

    def advance(
        self,
        stamp_s: float,
        left: NDArray[np.uint8] | NDArray[np.uint16],
        right: NDArray[np.uint8] | NDArray[np.uint16],
    ) -> CameraMotion:
        """The motion since the pair before; unknown for the first one.

        Raises:
            StereoError: pictures of another size than the camera's, or a stamp that does not
                follow the one before.
        """
        views = self._checked(stamp_s, left, right)
        step_s = stamp_s - self._stamp_s
        fit, best = None, -1.0
        for levels in (_LEVELS, _LEVELS_UNSURE) if self._sure else (_LEVELS_UNSURE,):
            rows, places, guess = self._track(views[0], step_s, levels)
            corners = np.concatenate([places, find_corners(views[0], places)])
            seen, good = self._match_right(views, corners, guess)
            old = len(places)
            tracked = rows[good[:old]], self.disparity_error.removed(seen[:old][good[:old]])
            agreed = self._fit(*tracked, step_s)
            share = -1.0 if agreed is None else float(agreed.inliers.mean())
            if share > best or fit is None:
                fit, best, chosen = agreed, share, (tracked, seen[old:][good[old:]])
            if best >= AGREEMENT:
                break
        (rows, sights), fresh = chosen
        motion = self._measure(rows, sights, fit, step_s)
        fresh = self.disparity_error.removed(fresh)
        by_fresh = np.zeros((len(fresh), 3, TERMS))
        by_fresh[:, 2] = self.disparity_error.terms(fresh)
        self._seen = np.concatenate([self._seen, fresh])
        self._sights = np.concatenate([self._sights, fresh])
        self._spreads = np.concatenate([self._spreads, self.disparity_error.noise_px2(fresh)])
        self._by_error = np.concatenate([self._by_error, by_fresh])
        self._before, self._stamp_s, self._step_s = views[0], stamp_s, step_s
        return motion

    def _checked(self, stamp_s: float, left: NDArray, right: NDArray) -> tuple[Grey, Grey]:  # type: ignore[type-arg]
        size = (self._rig.height_px, self._rig.width_px)
        for name, picture in (("left", left), ("right", right)):
            if picture.shape != size:
                raise StereoError(
                    f"the {name} picture at {stamp_s:.6f} s is {picture.shape[1]}x"
                    f"{picture.shape[0]}, the camera's are {size[1]}x{size[0]}"
                )
        if self._before is not None and not stamp_s > self._stamp_s:
            raise StereoError(f"stamp {stamp_s:.6f} s does not follow {self._stamp_s:.6f} s")
        self._bits = max(self._bits, bits_of(left), bits_of(right))
        views = eight_bit(left, self._bits), eight_bit(right, self._bits)
        shares, right_shares = (grey_shares(view) for view in views)
        if self._before is not None:
            self._before = same_exposure(self._before, self._shares, shares)
        self._shares = shares
        return views[0], same_exposure(views[1], right_shares, shares)

    def _track(
        self, view: Grey, step_s: float, levels: int
    ) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Rows of the points that were found again, their places, and their disparity guessed."""
        if self._before is None or not len(self._sights):
            return np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty(0)
        expected = move(self._predicted(step_s), points_of(self._rig, self._sights))
        front = expected[:, 2] > _NEAREST_M
        expected[~front] = (0.0, 0.0, 10.0)
        guess = project(self._rig, expected)
        places, found = follow(self._before, view, self._seen[:, :2], guess[:, :2], levels)
        rows = np.flatnonzero(found & front)
        # corners of the distance crowd together, and say the same
        rows = rows[thinned(places[rows], self._spreads[rows, 2, 2])]
        return rows, places[rows], (guess[:, 0] - guess[:, 2])[rows]

    def _predicted(self, step_s: float) -> Floats:
        """The last motion, for as long as this step; none after a gap."""
        if not self._sure or not 0.5 < step_s / self._step_s < 2.0:
            return np.eye(4)
        return self._last

    def _match_right(
        self, views: tuple[Grey, Grey], corners: Floats, guess: Floats
    ) -> tuple[Floats, Bools]:
        """`(u, v, u')` of corners as they stand in the pictures, and which are believed."""
        disparity = np.full(len(corners), _FIRST_DISPARITY_PX)
        known = len(guess)
        disparity[:known] = guess
        if known > 20 and len(corners) > known:
            # the scene is smooth: a new corner is about as far as the nearest known one
            near = corners[:known]
            apart = (near**2).sum(axis=1) - 2.0 * corners[known:] @ near.T
            disparity[known:] = guess[apart.argmin(axis=1)]
        start = corners - np.column_stack([disparity, np.full(len(corners), -self._row_offset_px)])
        error = self.disparity_error.at(corners)
        start[:, 0] -= error
        levels = _LEVELS if self._sure else _LEVELS_UNSURE
        found, good = follow(views[0], views[1], corners, start, max(levels, 3))
        rows_px = found[:, 1] - corners[:, 1]
        apart_px = corners[:, 0] - found[:, 0] - error
        good &= apart_px > _DISPARITY_MIN_PX
        if self._before is None and good.sum() > 20:
            self._row_offset_px = float(np.median(rows_px[good]))
        good &= np.abs(rows_px - self._row_offset_px) < _ROW_TOLERANCE_PX
        if good.sum() > 20:
            self._row_offset_px += 0.1 * float(np.median(rows_px[good]) - self._row_offset_px)
        return np.column_stack([corners, found[:, 0]]), good

    def _fit(self, rows: NDArray[np.int64], seen: Floats, step_s: float) -> MotionFit | None:
        """The motion of the points `rows` that are `seen` now, None for too few."""
        if len(rows) < _INLIERS_MIN:
            return None
        before = self._sights[rows], self._spreads[rows]
        noise = self.disparity_error.noise_px2(seen)
        return fit_motion(self._rig, *before, seen, noise, self._predicted(step_s))

    def _measure(
        self, rows: NDArray[np.int64], seen: Floats, fit: MotionFit | None, step_s: float
    ) -> CameraMotion:
        """The motion, and the points moved by it and sharpened; without one they are forgotten."""
        if self._before is None:
            return self._unknown(0, 0, "first pair", "this is the first pair")
        if fit is None:
            self._lose()
            return self._unknown(
                len(rows), 0, "too few corners", f"{len(rows)} corners were found again"
            )
        inliers = int(fit.inliers.sum())
        doubt = self._doubt(fit, step_s)
        if doubt is not None:
            self._lose()
            return self._unknown(len(rows), inliers, *doubt)
        self._last, self._sure = fit.current_from_previous, True
        self._sharpen(fit, rows, seen)
        return CameraMotion(
            fit.current_from_previous, fit.covariance, len(rows), inliers, known=True
        )

    def _doubt(self, fit: MotionFit, step_s: float) -> tuple[str, str] | None:
        """What stands against a motion: its kind, and the same with figures."""
        inliers = int(fit.inliers.sum())
        if inliers < _INLIERS_MIN or inliers < _INLIER_SHARE_MIN * len(fit.inliers):
            return "no common motion", f"{inliers} of {len(fit.inliers)} corners agree on a motion"
        if not np.isfinite(fit.covariance).all():
            return "undetermined", "the corners do not determine a motion"
        if not self._sure or step_s > 1.0:
            return None
        # of the rear axle: a car that pitches swings its camera
        now, before = (vehicle_step(self._rig, t) for t in (fit.current_from_previous, self._last))
        change = float(np.linalg.norm((now - before * (step_s / self._step_s))[:2, 3]))
        if change > _STILL_CHANGE_M + _ACCELERATION_MAX_MPS2 * step_s**2:
            return "no car's motion", f"the step changes by {change:.2f} m from pair to pair"
        turn = float(np.arctan2(now[1, 0], now[0, 0]) - np.arctan2(before[1, 0], before[0, 0]))
        if abs(turn) > _STILL_CHANGE_RAD + _TURN_ACCELERATION_MAX_RADPS2 * step_s**2:
            return "no car's motion", f"the turn changes by {turn:.3f} rad from pair to pair"
        return None

    def _sharpen(self, fit: MotionFit, rows: NDArray[np.int64], seen: Floats) -> None:
        """Kalman steps of all points that agree: moved by the motion, then measured."""
        keep = fit.inliers
        carried, expected = fit.carried[keep], fit.moved_px[keep]
        change, by_error = self.disparity_error.learn(fit, self._by_error[rows[keep]], seen[keep])
        spread = _FORGET * (carried @ self._spreads[rows[keep]] @ np.swapaxes(carried, 1, 2))
        noise = self.disparity_error.noise_px2(seen[keep])
        gain = spread @ inverse_symmetric(spread + noise)
        left = np.eye(3) - gain
        # Joseph's form: a corner seen for a hundred frames keeps a positive covariance
        self._spreads = left @ spread @ np.swapaxes(left, 1, 2)
        self._spreads += gain @ noise @ np.swapaxes(gain, 1, 2)
        self._seen = seen[keep]
        terms = self.disparity_error.terms(self._seen)
        self._by_error = left @ by_error + gain[:, :, 2:] * terms[:, None, :]
        measured = expected + (gain @ (self._seen - expected)[:, :, None])[:, :, 0]
        # points known so far go where they are with the error as it is known now
        self._sights = measured + self._by_error @ change

    def _lose(self) -> None:
        self._sure, self._last = False, np.eye(4)
        self._forget_points()

    def _forget_points(self) -> None:
        self._seen = np.empty((0, 3))
        self._sights = np.empty((0, 3))
        self._spreads = np.empty((0, 3, 3))
        self._by_error = np.empty((0, 3, TERMS))

    def _unknown(self, tracked: int, inliers: int, kind: str, why: str) -> CameraMotion:
        nothing = np.full((6, 6), np.inf)
        return CameraMotion(np.eye(4), nothing, tracked, inliers, known=False, why=why, kind=kind)
