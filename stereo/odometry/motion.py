"""The motion of the camera that moves known points to where they are seen now.

A point has a sight `q = (u, v, u')` with covariance `C` in the pair before, and is seen as `z` with
noise `V` in this one. Under the motion `T` it would be seen at `g(q) = h(T h^-1(q))`. Motion and
sights minimise together

    sum rho( min_q (q - q0)' C^-1 (q - q0) + (z - g(q))' V^-1 (z - g(q)) )

by Gauss-Newton steps that are linearised at the sights as both pairs tell them, not as the pair
before did: with `A = dg/dq` and `M = dg/dT` there,

    r = z - g(q) + A (q - q0),  S = A C A' + V,  dT = argmin sum w (r - M dT)' S^-1 (r - M dT)
    q <- q0 + w C A' S^-1 (r - M dT)

Linearised at `q0`, noise in the disparities would draw the step towards zero, by more than a
percent (errors in variables). `rho` is the function of Geman and McClure with weights `w`, whose
width begins wide and narrows (graduated non-convexity): points on what moves by itself lose their
weight.

Source: Black, Rangarajan, IJCV 1996 (graduated non-convexity); Maimone, Cheng, Matthies, J. Field
Robotics 2007 (maximum likelihood stereo odometry).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from polemap.stereo.odometry.sights import (
    Bools,
    Floats,
    by_motion,
    by_point,
    by_sight,
    in_front,
    points_of,
    project,
)
from polemap.stereo.rig import StereoRig

# chi-square of three degrees of freedom that one point in a thousand exceeds
GATE = 16.27
# fewer than these of the points agreeing leaves room for another motion
AGREEMENT = 0.8
# corners beside each other err alike (texture, slanted ground), and points keep their errors from
# frame to frame: three times the variance that independent corners would leave, as measured
_CORRELATED = 3.0
_STEPS = 10
# the square of a step in deviations of independent corners
_SETTLED = 0.03
_PNP_REPROJECTION_PX = 1.5
_PNP_TRIES = 200


@dataclass(frozen=True, slots=True)
class MotionFit:
    """A motion and what speaks for it.

    Attributes:
        current_from_previous: `(4, 4)` rigid motion of points in camera axes.
        covariance: `(6, 6)` of translation (m) and rotation vector (rad), both in the axes of the
            current camera: `X_now = exp(rotation) X + translation` after the motion.
        inliers: `(n,)` points that the motion explains.
        moved_px: `(n, 3)` where the motion would have the points seen.
        carried: `(n, 3, 3)`: derivative of these by the sights before.
        inverse: `(n, 3, 3)`: `S^-1`.
        by_motion: `(n, 3, 6)`: derivative of the sights by the motion.
        residual: `(n, 3)`: `r`.
    """

    current_from_previous: Floats
    covariance: Floats
    inliers: Bools
    moved_px: Floats
    carried: Floats
    inverse: Floats
    by_motion: Floats
    residual: Floats


def vehicle_step(rig: StereoRig, current_from_previous: Floats) -> Floats:
    """`(4, 4)` pose of the vehicle frame in the one before, from the motion of camera points."""
    mount = rig.vehicle_from_camera
    from_camera = np.eye(4)
    from_camera[:3, :3] = mount.rotation()
    from_camera[:3, 3] = mount.x_m, mount.y_m, mount.z_m
    return np.asarray(
        from_camera @ np.linalg.inv(current_from_previous) @ np.linalg.inv(from_camera)
    )


def fit_motion(
    rig: StereoRig,
    before_px: Floats,
    covariances_px2: Floats,
    seen_px: Floats,
    noise_px2: Floats,
    guess: Floats,
) -> MotionFit:
    """The motion of sights `(n, 3)` with covariances `(n, 3, 3)`, seen now as `(n, 3)`; n >= 4.

    `noise_px2` is that of all sights now, `(3, 3)`, or of each, `(n, 3, 3)`.

    Where many points do not agree, the guess is tried with what fits it closely, and the best of a
    minimal-sample search over triples; what explains most points stands.
    """
    data = rig, before_px, covariances_px2, seen_px, noise_px2
    best = _refine(*data, guess)
    if best.inliers.mean() >= AGREEMENT:
        return best
    for start in (guess, _by_triples(rig, before_px, seen_px)):
        if start is not None:
            fit = _refine(*data, start, wide=False)
            best = max(best, fit, key=lambda one: int(one.inliers.sum()))
    return best


def _by_triples(rig: StereoRig, before_px: Floats, seen_px: Floats) -> Floats | None:
    camera = np.array(
        [[rig.focal_px, 0.0, rig.cx_px], [0.0, rig.focal_px, rig.cy_px], [0.0, 0.0, 1.0]]
    )
    cv2.setRNGSeed(0)
    found, turn, shift, _ = cv2.solvePnPRansac(
        points_of(rig, before_px),
        np.ascontiguousarray(seen_px[:, :2]),
        camera,
        None,
        reprojectionError=_PNP_REPROJECTION_PX,
        iterationsCount=_PNP_TRIES,
        flags=cv2.SOLVEPNP_P3P,
    )
    if not found:
        return None
    transform = _rigid(np.concatenate([np.asarray(shift).ravel(), np.asarray(turn).ravel()]))
    return transform if np.isfinite(transform).all() else None


def _rigid(motion: Floats) -> Floats:
    """`(4, 4)` of a translation and a rotation vector `(6,)`."""
    transform = np.eye(4)
    transform[:3, :3] = cv2.Rodrigues(motion[3:])[0]
    transform[:3, 3] = motion[:3]
    return transform


def _refine(
    rig: StereoRig,
    before_px: Floats,
    covariances_px2: Floats,
    seen_px: Floats,
    noise_px2: Floats,
    guess: Floats,
    *,
    wide: bool = True,
) -> MotionFit:
    transform, sights, width = guess.copy(), before_px, 1.0
    for step in range(_STEPS):
        points = points_of(rig, sights)
        now = in_front(transform, points)
        moved = project(rig, now)
        carried = by_point(rig, now) @ transform[:3, :3] @ by_sight(rig, points)
        residual = seen_px - moved + _times(carried, sights - before_px)
        across = covariances_px2 @ np.swapaxes(carried, 1, 2)
        inverse = inverse_symmetric(carried @ across + noise_px2)
        of_motion = by_motion(rig, now)
        weighted = _times(inverse, residual)
        distance = np.einsum("ni,ni->n", residual, weighted)
        # a bad guess makes all residuals large: begin as wide as half of them are
        width = max(1.0, float(np.median(distance)) / 2.4 if wide and step == 0 else 0.5 * width)
        limit = 9.0 * width
        weight = (limit / (limit + distance)) ** 2
        rows = (weight[:, None, None] * inverse @ of_motion).reshape(-1, 6)
        information = of_motion.reshape(-1, 6).T @ rows
        gradient = residual.ravel() @ rows
        change = _solved(information, gradient)
        transform = _rigid(change) @ transform
        if width == 1.0 and change @ gradient < _SETTLED:
            break
        left = weighted - _times(inverse, of_motion @ change)
        sights = before_px + weight[:, None] * _times(across, left)
    inliers = np.asarray(distance < GATE)
    covariance = _CORRELATED * np.asarray(np.linalg.pinv(information, hermitian=True))
    # weights that understate what the residuals show would make the covariance too small
    if inliers.sum() > 4:
        covariance = covariance * max(1.0, float(distance[inliers].mean()) / 3.0)
    expected = seen_px - residual
    return MotionFit(
        transform, covariance, inliers, expected, carried, inverse, of_motion, residual
    )


def _solved(information: Floats, gradient: Floats) -> Floats:
    try:
        return np.asarray(np.linalg.solve(information, gradient))
    except np.linalg.LinAlgError:
        # corners that leave a direction open: no step along it
        return np.asarray(np.linalg.lstsq(information, gradient, rcond=1e-12)[0])


def inverse_symmetric(matrices: Floats) -> Floats:
    """Inverses of positive definite matrices `(n, 3, 3)`, by cofactors."""
    (a, b, c), (_, d, e), (_, _, f) = np.moveaxis(matrices, 0, 2)
    cofactors = np.array(
        [
            [d * f - e * e, c * e - b * f, b * e - c * d],
            [c * e - b * f, a * f - c * c, b * c - a * e],
            [b * e - c * d, b * c - a * e, a * d - b * b],
        ]
    )
    determinant = a * cofactors[0, 0] + b * cofactors[0, 1] + c * cofactors[0, 2]
    # Hadamard: at most a d f; what is lost to rounding must not become a division by zero
    determinant = np.maximum(determinant, 1e-15 * a * d * f)
    return np.ascontiguousarray(np.moveaxis(cofactors / determinant, 2, 0))


def _times(matrices: Floats, vectors: Floats) -> Floats:
    """Matrices `(n, 3, 3)` times vectors `(n, 3)`."""
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])
