"""The motion of the camera that moves known points to where they are seen now.

A point is seen as `z = (u, v, u')`: column and row in the left picture, column in the right one.
Its place `X` before has a covariance `P`; the motion `(R, t)` of six degrees of freedom minimises

    sum rho(r' S^-1 r),  r = z - h(R X + t),  S = H R P R' H' + V

where `H` is the Jacobian of the projection `h`, `V` the noise of `z`, and `rho` the function of
Geman and McClure, whose width begins wide and narrows (graduated non-convexity): points on what
moves by itself lose their weight.

Source: Black, Rangarajan, IJCV 1996 (graduated non-convexity); Maimone, Cheng, Matthies, J. Field
Robotics 2007 (maximum likelihood stereo odometry).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# chi-square of three degrees of freedom that one point in a thousand exceeds
GATE = 16.27
# fewer than these of the points agreeing leaves room for another motion
AGREEMENT = 0.8
_NEAREST_M = 0.5
# corners beside each other err alike (texture, slanted ground), and points keep their errors from
# frame to frame: four times the variance that independent corners would leave, as measured
_CORRELATED = 4.0
_STEPS = 10
_SETTLED = 1e-5
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
        offset_px: `(2,)` what this frame says by itself of a constant error of all disparities:
            gradient and information (1 / px2) of the offset that is still to be subtracted.
    """

    current_from_previous: Floats
    covariance: Floats
    inliers: Bools
    offset_px: tuple[float, float]


def project(rig: StereoRig, points_m: Floats) -> Floats:
    """`(n, 3)` camera points to `(u, v, u')`."""
    inverse = 1.0 / points_m[:, 2]
    u = rig.focal_px * points_m[:, 0] * inverse + rig.cx_px
    v = rig.focal_px * points_m[:, 1] * inverse + rig.cy_px
    return np.column_stack([u, v, u - rig.focal_px * rig.baseline_m * inverse])


def project_jacobian(rig: StereoRig, points_m: Floats) -> Floats:
    """`(n, 3, 3)`: derivative of `project` by the points."""
    f, inverse = rig.focal_px, 1.0 / points_m[:, 2]
    jacobian = np.zeros((len(points_m), 3, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = jacobian[:, 2, 0] = f * inverse
    jacobian[:, 0, 2] = -f * points_m[:, 0] * inverse**2
    jacobian[:, 1, 2] = -f * points_m[:, 1] * inverse**2
    jacobian[:, 2, 2] = -f * (points_m[:, 0] - rig.baseline_m) * inverse**2
    return jacobian


def triangulate(rig: StereoRig, seen_px: Floats, noise_px2: Floats) -> tuple[Floats, Floats]:
    """Places `(n, 3)` and covariances `(n, 3, 3)` of points seen as `(u, v, u')`, u > u'."""
    disparity = seen_px[:, 0] - seen_px[:, 2]
    points = rig.camera_points(seen_px[:, 0], seen_px[:, 1], disparity)
    inverse = np.linalg.inv(project_jacobian(rig, points))
    return points, inverse @ noise_px2 @ np.swapaxes(inverse, 1, 2)


def move(transform: Floats, points_m: Floats) -> Floats:
    """Points `(n, 3)` under a rigid motion `(4, 4)`."""
    return np.asarray(points_m @ transform[:3, :3].T + transform[:3, 3])


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
    points_m: Floats,
    covariances_m2: Floats,
    seen_px: Floats,
    noise_px2: Floats,
    guess: Floats,
) -> MotionFit:
    """The motion of points `(n, 3)` with covariances `(n, 3, 3)`, seen now as `(n, 3)`; n >= 4.

    Where many points do not agree, the guess is tried with what fits it closely, and the best of a
    minimal-sample search over triples; what explains most points stands.
    """
    best = _refine(rig, points_m, covariances_m2, seen_px, noise_px2, guess)
    if best.inliers.mean() >= AGREEMENT:
        return best
    for start in (guess, _by_triples(rig, points_m, seen_px)):
        if start is not None:
            fit = _refine(rig, points_m, covariances_m2, seen_px, noise_px2, start, wide=False)
            best = max(best, fit, key=lambda one: int(one.inliers.sum()))
    return best


def _by_triples(rig: StereoRig, points_m: Floats, seen_px: Floats) -> Floats | None:
    camera = np.array(
        [[rig.focal_px, 0.0, rig.cx_px], [0.0, rig.focal_px, rig.cy_px], [0.0, 0.0, 1.0]]
    )
    cv2.setRNGSeed(0)
    found, turn, shift, _ = cv2.solvePnPRansac(
        points_m,
        np.ascontiguousarray(seen_px[:, :2]),
        camera,
        None,
        reprojectionError=_PNP_REPROJECTION_PX,
        iterationsCount=_PNP_TRIES,
        flags=cv2.SOLVEPNP_P3P,
    )
    if not found:
        return None
    transform = np.eye(4)
    transform[:3, :3] = cv2.Rodrigues(turn)[0]
    transform[:3, 3] = np.asarray(shift).ravel()
    return transform if np.isfinite(transform).all() else None


def _refine(
    rig: StereoRig,
    points_m: Floats,
    covariances_m2: Floats,
    seen_px: Floats,
    noise_px2: Floats,
    guess: Floats,
    *,
    wide: bool = True,
) -> MotionFit:
    transform = guess.copy()
    width = 1.0
    information: Floats = np.eye(6)
    for step in range(_STEPS):
        turn = transform[:3, :3]
        now = move(transform, points_m)
        now[:, 2] = np.maximum(now[:, 2], _NEAREST_M)
        jacobian = project_jacobian(rig, now)
        residual = seen_px - project(rig, now)
        spread = jacobian @ (turn @ covariances_m2 @ turn.T) @ np.swapaxes(jacobian, 1, 2)
        inverse = np.asarray(np.linalg.inv(spread + noise_px2), dtype=np.float64)
        distance = np.einsum("ni,nij,nj->n", residual, inverse, residual)
        # a bad guess makes all residuals large: begin as wide as half of them are
        width = max(1.0, float(np.median(distance)) / 2.4 if wide and step == 0 else 0.5 * width)
        limit = 9.0 * width
        weight = (limit / (limit + distance)) ** 2
        by_motion = np.concatenate([jacobian, -jacobian @ _cross(now)], axis=2)
        weighted = np.swapaxes(by_motion, 1, 2) @ (inverse * weight[:, None, None])
        information = (weighted @ by_motion).sum(axis=0)
        gradient = np.einsum("nij,nj->i", weighted, residual)
        change = np.linalg.lstsq(information, gradient, rcond=1e-12)[0]
        update = np.eye(4)
        update[:3, :3] = cv2.Rodrigues(change[3:])[0]
        update[:3, 3] = change[:3]
        transform = update @ transform
        if width == 1.0 and np.abs(change).max() < _SETTLED:
            break
    inliers = distance < GATE
    covariance = _CORRELATED * np.asarray(np.linalg.pinv(information, hermitian=True))
    # weights that understate what the residuals show would make the covariance too small
    if inliers.sum() > 4:
        covariance = covariance * max(1.0, float(distance[inliers].mean()) / 3.0)
    offset = _offset_from(rig, points_m, now, transform, by_motion, inverse, residual, inliers)
    return MotionFit(transform, covariance, np.asarray(inliers), offset)


def _offset_from(
    rig: StereoRig,
    points_m: Floats,
    now: Floats,
    transform: Floats,
    by_motion: Floats,
    inverse: Floats,
    residual: Floats,
    inliers: Bools,
) -> tuple[float, float]:
    """Gradient and information of the disparities' common offset, the motion marginalised out.

    An offset `o` makes a point of disparity `d` nearer by `X o / d`; a step then comes out too
    short by a share that grows with the point's distance, so near and far points disagree on it.
    """
    rows = np.flatnonzero(inliers)
    if len(rows) < 8:
        return 0.0, 0.0
    disparity = rig.focal_px * rig.baseline_m / points_m[rows, 2]
    farther = (points_m[rows] / disparity[:, None]) @ transform[:3, :3].T
    by_offset = np.einsum("nij,nj->ni", project_jacobian(rig, now[rows]), farther)
    by_offset[:, 2] -= 1.0
    weighted = np.einsum("nij,nj->ni", inverse[rows], by_offset)
    cross = np.einsum("nij,ni->j", by_motion[rows], weighted)
    by_six = np.swapaxes(by_motion[rows], 1, 2) @ inverse[rows]
    of_motion = (by_six @ by_motion[rows]).sum(axis=0)
    gradient_motion = np.einsum("nij,nj->i", by_six, residual[rows])
    share = np.linalg.lstsq(of_motion, cross, rcond=1e-12)[0]
    gradient = float(np.sum(weighted * residual[rows]) - share @ gradient_motion)
    return gradient, float(np.sum(weighted * by_offset) - share @ cross)


def _cross(vectors: Floats) -> Floats:
    """`(n, 3, 3)` matrices that multiply as the cross product with `vectors` `(n, 3)` does."""
    matrices = np.zeros((len(vectors), 3, 3))
    matrices[:, 0, 1], matrices[:, 0, 2] = -vectors[:, 2], vectors[:, 1]
    matrices[:, 1, 0], matrices[:, 1, 2] = vectors[:, 2], -vectors[:, 0]
    matrices[:, 2, 0], matrices[:, 2, 1] = -vectors[:, 1], vectors[:, 0]
    return matrices
