"""What rectification leaves of error in the disparities: a smooth field, learned from motion.

Rectified pairs are off by some tenths of a pixel, and differently across the picture: a relative
yaw of the cameras by `1 + x^2`, pitch by `x y`, roll by `y`, the ratio of the focal lengths by
`x`, distortion by more of `x^2` (`x`, `y`: direction of the ray, as tangents). All are a

    o(x, y) = c . (1, x, y, x^2, x y)

that is added to every disparity. It makes a step too long or too short by a share that differs
between near and far points and across the picture, so that points disagree on the motion; from
that `c` is learned by a Kalman filter. What the field cannot say grows with the squares, too, and
is noise of the corners at the sides.

Source: Kreso, Segvic, Improving the egomotion estimation by correcting the calibration bias,
VISAPP 2015 (a field learned from motion).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.odometry.motion import MotionFit
from polemap.stereo.odometry.sights import Floats
from polemap.stereo.rig import StereoRig

# prior deviations in px (per tangent, and per squared one): rotations of 0.02 degrees and focal
# lengths alike to 0.03 %, which are 0.25 and 0.2 px, and as much again of distortion
_PRIOR_SD_PX = np.array([0.3, 0.2, 0.25, 0.5, 0.3])
# noise of a disparity in px per squared tangent; chosen on rendered drives and KITTI 03 from 0 to 8
_SIDE_SD_PX = 5.0
# noise of a corner's columns and row in pixels: Lucas-Kanade on these windows; residuals of
# rendered drives with known motion agree (their NEES stands in docs/camera_odometry.md)
CORNER_SD_PX = 0.3
# neighbours err alike, and points keep their errors from frame to frame
_TRUST = 0.1
# a calibration changes by temperature, slowly
_WALK = 1e-4
TERMS = len(_PRIOR_SD_PX)


class DisparityError:
    """The field as far as it is known.

    Attributes:
        coefficients_px: `(5,)`, zero before anything is learned.
    """

    def __init__(self, rig: StereoRig) -> None:
        self._rig = rig
        self.coefficients_px: Floats = np.zeros(TERMS)
        self._covariance: Floats = np.diag(_PRIOR_SD_PX**2)

    def terms(self, places_px: NDArray[np.float64]) -> Floats:
        """`(n, 5)`: the terms of the field at places `(n, 2)` of the left picture."""
        x = (places_px[:, 0] - self._rig.cx_px) / self._rig.focal_px
        y = (places_px[:, 1] - self._rig.cy_px) / self._rig.focal_px
        return np.column_stack([np.ones(len(x)), x, y, x * x, x * y])

    def at(self, places_px: NDArray[np.float64]) -> Floats:
        """`(n,)` px that the disparities at places `(n, 2)` are too large by."""
        return np.asarray(self.terms(places_px) @ self.coefficients_px)

    def removed(self, seen_px: Floats) -> Floats:
        """Sights `(u, v, u')` `(n, 3)` of the pictures with the error taken out of `u'`."""
        right = seen_px[:, 2] + self.at(seen_px)
        return np.column_stack([seen_px[:, :2], right])

    def noise_px2(self, places_px: Floats) -> Floats:
        """`(n, 3, 3)`: covariances of sights at places `(n, 2)` or more columns."""
        terms = self.terms(places_px)
        noise = np.tile(CORNER_SD_PX**2 * np.eye(3), (len(places_px), 1, 1))
        noise[:, 2, 2] += _SIDE_SD_PX**2 * (terms[:, 1] ** 2 + terms[:, 2] ** 2) ** 2
        return noise

    def learn(self, fit: MotionFit, by_error: Floats, seen_px: Floats) -> tuple[Floats, Floats]:
        """A Kalman step with the residuals of one motion.

        Args:
            by_error: `(k, 3, 5)`: derivative by the field of the sights before, of the points that
                agree on the motion.
            seen_px: `(k, 3)` where these are seen now.

        Returns:
            the change of the field `(5,)`, and the derivative of the moved sights `(k, 3, 5)`.
        """
        keep = fit.inliers
        inverse, by_motion = fit.inverse[keep], fit.by_motion[keep]
        moved = fit.carried[keep] @ by_error
        # residual: the column that is seen, plus o, minus a sight that o made, too
        of_residual = -moved
        of_residual[:, 2] += self.terms(seen_px)
        # another field makes another motion, which moves the sights, too
        theirs = by_motion.reshape(-1, 6)
        rows = (inverse @ by_motion).reshape(-1, 6)
        ours = of_residual.reshape(-1, TERMS)
        motion = np.linalg.lstsq(theirs.T @ rows, rows.T @ ours, rcond=1e-12)[0]
        moved += by_motion @ motion
        across = by_motion @ motion - of_residual
        rows = (inverse @ across).reshape(-1, TERMS)
        information = across.reshape(-1, TERMS).T @ rows
        prior = np.linalg.inv(self._covariance + _WALK**2 * np.diag(_PRIOR_SD_PX**2))
        covariance: Floats = np.asarray(
            np.linalg.inv(prior + _TRUST * information), dtype=np.float64
        )
        change = covariance @ (_TRUST * (fit.residual[keep].ravel() @ rows))
        self._covariance = covariance
        self.coefficients_px = self.coefficients_px + change
        return np.asarray(change), moved
