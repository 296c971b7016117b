"""The factor graph in GTSAM: factors from the tables, solving, covariances.

Poses `X` are Pose2, landmarks `L` and GNSS biases `B` Point2, calibrations `C` vectors of six.
Two kinds of factors are ours: a motion, whose prediction is linear in the calibration about that
of its preintegration,

    e = (A^-1 B) - (m + J (c - c0)),

and a fix, `e = A p + b - z`, with the antenna p in the frame of the pose and the bias b. The bias
is a first-order Gauss-Markov process; its density is written as differences of neighbours and a
remainder at each, so that plain factors state it exactly.

Source: Dellaert and Kaess, Factor graphs for robot perception, 2017; Forster et al., On-manifold
preintegration for real-time visual-inertial odometry, IEEE TRO 33(1), 2017 (the linear correction
of preintegrated motion); Agarwal et al., Robust map optimization using dynamic covariance scaling,
ICRA 2013.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.problem import Problem, Solution
from polemap.extras import need
from polemap.vehicle.pose import pose_rotation, rotation, transform_points

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

# residuals, in standard deviations, from which a factor loses weight
_MOTION_HUBER, _SEEN_HUBER, _FIX_CAUCHY, LINK_SCALE = 3.0, 2.0, 2.0, 3.0
_STEPS = 40
_CONVERGED = 2e-6
# holds what nothing else does, metres and radians
_LOOSE = np.array([1e3, 1e3, 3.0])
_ORIGIN = np.array([1e-3, 1e-3, 1e-4])


class Graph:
    """A problem as a factor graph, and its solution so far.

    Raises:
        MissingExtraError: gtsam is not installed.
    """

    def __init__(
        self,
        problem: Problem,
        sds: tuple[Floats, float],
        link_scale: float = LINK_SCALE,
        bias_m: Floats | None = None,
    ) -> None:
        """`sds` are those of the calibration `(6,)`, and of its walk in these.

        `link_scale`, in their sd, is where links begin to lose weight: far out at first, so that
        they pull at all (graduated non-convexity). `bias_m` `(d, 2)` are the errors of fixes at
        which it begins, by default zero.
        """
        self._bias_m = np.zeros((len(problem.bias_sd_m), 2)) if bias_m is None else bias_m
        self._link_scale = link_scale
        self._known: Any = None
        self._gtsam = need("gtsam")
        self._problem = problem
        self._graph = self._gtsam.NonlinearFactorGraph()
        self._values = self._gtsam.Values()
        self._insert()
        self._calibration(*sds)
        self._motions()
        self._detections()
        self._fixes()
        self._links()
        self._known_poles()

    def _key(self, kind: str, row: int) -> int:
        return int(self._gtsam.symbol(kind, row))

    def _insert(self) -> None:
        p, values, g = self._problem, self._values, self._gtsam
        for row, pose in enumerate(p.poses.tolist()):
            values.insert(self._key("x", row), g.Pose2(*pose))
        for row, point in enumerate(p.points_m):
            values.insert(self._key("l", row), point)
        for row, vector in enumerate(p.calibration):
            values.insert(self._key("c", row), vector)
        for row in range(len(p.bias_sd_m)):
            values.insert(self._key("b", row), self._bias_m[row])

    def _calibration(self, sd: Floats, walk: float) -> None:
        g, graph, p = self._gtsam, self._graph, self._problem
        prior = g.noiseModel.Diagonal.Sigmas(sd)
        change = g.noiseModel.Diagonal.Sigmas(walk * sd)
        for row, goes_on in enumerate(p.calibration_walk.tolist()):
            key = self._key("c", row)
            if goes_on:
                before = self._key("c", row - 1)
                graph.add(g.BetweenFactorVector(before, key, np.zeros(len(sd)), change))
            else:
                graph.add(g.PriorFactorVector(key, np.zeros(len(sd)), prior))
        for row in np.flatnonzero(p.calibration_information.any(axis=(1, 2))).tolist():
            noise = g.noiseModel.Gaussian.Information(p.calibration_information[row])
            known = p.calibration_known[row]
            graph.add(g.PriorFactorVector(self._key("c", row), known, noise))

    def _motions(self) -> None:
        g, p = self._gtsam, self._problem
        kernel = g.noiseModel.mEstimator.Huber.Create(_MOTION_HUBER)
        for row in range(len(p.motion)):
            noise = g.noiseModel.Gaussian.Covariance(p.motion_covariance[row])
            first, number = int(p.motion_from[row]), int(p.motion_calibration[row])
            keys = [self._key("x", first), self._key("x", first + 1), self._key("c", number)]
            error = _motion_error(
                keys, p.motion[row], p.motion_jacobian[row], p.calibration[number]
            )
            robust = g.noiseModel.Robust.Create(kernel, noise)
            self._graph.add(g.CustomFactor(robust, keys, error))
        loose = g.noiseModel.Diagonal.Sigmas(_LOOSE)
        held = g.noiseModel.Diagonal.Sigmas(_ORIGIN)
        starts = np.setdiff1d(np.arange(len(p.poses)), p.motion_from + 1)
        for row in starts.tolist():
            noise = held if row in p.origin else loose
            pose = g.Pose2(*p.poses[row].tolist())
            self._graph.add(g.PriorFactorPose2(self._key("x", row), pose, noise))

    def _detections(self) -> None:
        g, p = self._gtsam, self._problem
        kernel = g.noiseModel.mEstimator.Huber.Create(_SEEN_HUBER)
        x, y = p.seen_m[:, 0], p.seen_m[:, 1]
        distance, bearing = np.hypot(x, y), np.arctan2(y, x)
        jacobian = np.empty((len(x), 2, 2))
        jacobian[:, 0, 0], jacobian[:, 0, 1] = -y / distance**2, x / distance**2
        jacobian[:, 1, 0], jacobian[:, 1, 1] = x / distance, y / distance
        polar = jacobian @ p.seen_covariance_m2 @ jacobian.transpose(0, 2, 1)
        add, factor = self._graph.add, g.BearingRangeFactor2D
        gaussian, robust = g.noiseModel.Gaussian.Covariance, g.noiseModel.Robust.Create
        rows = zip(
            p.seen_from.tolist(), p.seen.tolist(), bearing.tolist(), distance.tolist(), polar,
            strict=True,
        )  # fmt: skip
        for pose, landmark, angle, length, covariance in rows:
            noise = robust(kernel, gaussian(covariance))
            keys = self._key("x", pose), self._key("l", landmark)
            add(factor(*keys, g.Rot2(angle), length, noise))

    def _fixes(self) -> None:
        g, p, graph = self._gtsam, self._problem, self._graph
        kernel = g.noiseModel.mEstimator.Cauchy.Create(_FIX_CAUCHY)
        for row in range(len(p.fix_from)):
            keys = [self._key("x", int(p.fix_from[row])), self._key("b", int(p.fix_bias[row]))]
            noise = g.noiseModel.Robust.Create(
                kernel, g.noiseModel.Isotropic.Sigma(2, float(p.fix_sd_m[row]))
            )
            error = _fix_error(keys, p.fix_antenna_m[row], p.fix_m[row])
            graph.add(g.CustomFactor(noise, keys, error))
        n = len(p.bias_sd_m)
        for row in range(n):
            sd, share = float(p.bias_sd_m[row]), float(p.bias_share[row])
            after = float(p.bias_share[row + 1]) if row + 1 < n else 0.0
            key = self._key("b", row)
            # (b' - f b)^2 / (1 - f^2) = f (b' - b)^2 / (1 - f^2) + (b'^2 - f b^2) / (1 + f)
            own = 1.0 / (1.0 + share) - after / (1.0 + after)
            prior = g.noiseModel.Isotropic.Sigma(2, sd / np.sqrt(own))
            graph.add(g.PriorFactorPoint2(key, np.zeros(2), prior))
            if share > 0.0:
                tie = g.noiseModel.Isotropic.Sigma(2, sd * np.sqrt((1.0 - share**2) / share))
                graph.add(g.BetweenFactorPoint2(self._key("b", row - 1), key, np.zeros(2), tie))

    def _links(self) -> None:
        g, p = self._gtsam, self._problem
        kernel = g.noiseModel.mEstimator.GemanMcClure.Create(self._link_scale)
        for (first, second), sd in zip(p.link.tolist(), p.link_sd_m.tolist(), strict=True):
            noise = g.noiseModel.Robust.Create(kernel, g.noiseModel.Isotropic.Sigma(2, sd))
            keys = self._key("l", first), self._key("l", second)
            self._graph.add(g.BetweenFactorPoint2(*keys, np.zeros(2), noise))

    def _known_poles(self) -> None:
        g, p = self._gtsam, self._problem
        rows = zip(p.known.tolist(), p.known_m, p.known_covariance_m2, strict=True)
        for row, point, covariance in rows:
            noise = g.noiseModel.Gaussian.Covariance(covariance)
            self._graph.add(g.PriorFactorPoint2(self._key("l", row), point, noise))

    def solve(self, steps: int = _STEPS) -> Solution:
        """Gauss-Newton, reweighted by the kernels, with a step that is halved where it worsens."""
        self._known = None
        cost = self._graph.error(self._values)
        ordering = None
        for _ in range(steps):
            linear = self._graph.linearize(self._values)
            if ordering is None:
                ordering = self._gtsam.Ordering.ColamdGaussianFactorGraph(linear)
            step = linear.optimize(ordering)
            share, moved, after = 1.0, self._values, np.inf
            while share > 0.05:
                moved = self._values.retract(step if share == 1.0 else step.scale(share))
                after = self._graph.error(moved)
                if after <= cost:
                    break
                share *= 0.5
            if after > cost:
                break
            self._values, gain, cost = moved, cost - after, after
            if gain < _CONVERGED * cost:
                break
        return self._solution(float(cost))

    def _solution(self, cost: float) -> Solution:
        p, values = self._problem, self._values
        poses = np.empty((len(p.poses), 3))
        for row in range(len(poses)):
            pose = values.atPose2(self._key("x", row))
            poses[row] = pose.x(), pose.y(), pose.theta()
        points = _points(values, [self._key("l", row) for row in range(len(p.points_m))])
        bias = _points(values, [self._key("b", row) for row in range(len(p.bias_sd_m))])
        calibration = np.array(
            [values.atVector(self._key("c", row)) for row in range(len(p.calibration))]
        ).reshape(-1, p.calibration.shape[1] if p.calibration.ndim == 2 else 6)
        off = points[p.link[:, 0]] - points[p.link[:, 1]] if len(p.link) else np.empty((0, 2))
        scaled2 = np.sum(off**2, axis=1) / p.link_sd_m**2
        link_weight = 1.0 / (1.0 + scaled2 / LINK_SCALE**2) ** 2
        residual = transform_points(poses[p.fix_from], p.fix_antenna_m) - p.fix_m
        fix2 = np.sum((residual + bias[p.fix_bias]) ** 2, axis=1) / p.fix_sd_m**2
        fix_weight = 1.0 / (1.0 + fix2 / _FIX_CAUCHY**2)
        off = np.hypot(residual[:, 0], residual[:, 1])
        return Solution(poses, points, calibration, bias, cost, link_weight, fix_weight, off)

    def _marginals(self) -> Any:
        if self._known is None:
            self._known = self._gtsam.Marginals(self._graph, self._values)
        return self._known

    def landmark_covariance(self, points: Whole) -> Floats:
        """Covariances `(q, 2, 2)` of landmarks by themselves."""
        known = self._marginals()
        own = [known.marginalCovariance(self._key("l", int(row))) for row in points]
        return np.array(own, dtype=np.float64).reshape(-1, 2, 2)

    def covariance(self, poses: Whole, points: Whole, calibrations: Sequence[int] = ()) -> Floats:
        """Joint covariance `(3 p + 2 q + 6 r, ...)` of poses, landmarks and calibrations.

        Those of poses and landmarks are in the map's axes.
        """
        keys = [self._key("x", int(row)) for row in poses]
        keys += [self._key("l", int(row)) for row in points]
        keys += [self._key("c", row) for row in calibrations]
        joint = self._marginals().jointMarginalCovariance(keys)
        result = joint.fullMatrix()
        turn = np.eye(len(result))
        for k, row in enumerate(poses):
            yaw = self._values.atPose2(self._key("x", int(row))).theta()
            turn[3 * k : 3 * k + 2, 3 * k : 3 * k + 2] = rotation(yaw)
        return np.asarray(turn @ result @ turn.T)


def _points(values: Any, keys: list[int]) -> Floats:
    return np.array([values.atPoint2(key) for key in keys], dtype=np.float64).reshape(-1, 2)


def _motion_error(keys: list[int], motion: Floats, jacobian: Floats, about: Floats) -> Any:
    first, second, calibration = keys
    start = motion - jacobian @ about
    toward = -jacobian

    def error(_factor: Any, values: Any, jacobians: Any) -> Floats:
        moved = values.atPose2(first).between(values.atPose2(second))
        x, y, turn = moved.x(), moved.y(), moved.theta()
        predicted = start + jacobian @ values.atVector(calibration)
        if jacobians is not None:
            jacobians[0] = np.array([[-1.0, 0.0, y], [0.0, -1.0, -x], [0.0, 0.0, -1.0]])
            jacobians[1] = pose_rotation(turn)
            jacobians[2] = toward
        off = (turn - predicted[2] + pi) % (2.0 * pi) - pi
        return np.array([x - predicted[0], y - predicted[1], off])

    return error


def _fix_error(keys: list[int], antenna: Floats, fix: Floats) -> Any:
    pose_key, bias_key = keys
    unit = np.eye(2)
    # by a step forward, to the left, and a turn
    moved = np.array([[1.0, 0.0, -antenna[1]], [0.0, 1.0, antenna[0]]])

    def error(_factor: Any, values: Any, jacobians: Any) -> Floats:
        pose, bias = values.atPose2(pose_key), values.atPoint2(bias_key)
        turn = rotation(pose.theta())
        if jacobians is not None:
            jacobians[0] = turn @ moved
            jacobians[1] = unit
        return np.asarray(turn @ antenna + (pose.x(), pose.y()) + bias - fix)

    return error
