"""The factor graph in GTSAM: factors from the tables, solving, covariances.

Poses `X` are Pose2, landmarks `L` and GNSS biases `B` Point2, calibrations `C` vectors of six.
Two kinds of factors are ours (`factors`): a motion, whose prediction is linear in the calibration
about that of its preintegration,

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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.factors import FIX_CAUCHY, OwnFactors
from polemap.build.slam.problem import Problem, Solution
from polemap.extras import need
from polemap.vehicle.pose import rotation, transform_points

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

# residuals, in standard deviations, from which a factor loses weight
_SEEN_HUBER, LINK_SCALE = 2.0, 3.0
_STEPS = 40
_SIZE = 6  # of a calibration
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
        self._own = OwnFactors(problem)
        self._insert()
        self._calibration(*sds)
        self._starts()
        self._detections()
        self._biases()
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

    def _starts(self) -> None:
        g, p = self._gtsam, self._problem
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

    def _biases(self) -> None:
        g, p, graph = self._gtsam, self._problem, self._graph
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
        noise = {
            sd: g.noiseModel.Robust.Create(kernel, g.noiseModel.Isotropic.Sigma(2, sd))
            for sd in np.unique(p.link_sd_m).tolist()
        }
        for (first, second), sd in zip(p.link.tolist(), p.link_sd_m.tolist(), strict=True):
            keys = self._key("l", first), self._key("l", second)
            self._graph.add(g.BetweenFactorPoint2(*keys, np.zeros(2), noise[sd]))

    def _known_poles(self) -> None:
        g, p = self._gtsam, self._problem
        rows = zip(p.known.tolist(), p.known_m, p.known_covariance_m2, strict=True)
        for row, point, covariance in rows:
            noise = g.noiseModel.Gaussian.Covariance(covariance)
            self._graph.add(g.PriorFactorPoint2(self._key("l", row), point, noise))

    def solve(self, steps: int = _STEPS) -> Solution:
        """Gauss-Newton, reweighted by the kernels, with a step that is halved where it worsens."""
        self._known = None
        cost = self._cost(self._values)
        ordering = None
        for _ in range(steps):
            linear = self._linear()
            if ordering is None:
                ordering = self._gtsam.Ordering.ColamdGaussianFactorGraph(linear)
            step = linear.optimize(ordering)
            share, moved, after = 1.0, self._values, np.inf
            while share > 0.05:
                moved = self._values.retract(step if share == 1.0 else step.scale(share))
                after = self._cost(moved)
                if after <= cost:
                    break
                share *= 0.5
            if after > cost:
                break
            self._values, gain, cost = moved, cost - after, after
            if gain < _CONVERGED * cost:
                break
        return self._solution(float(cost))

    def _cost(self, values: Any) -> float:
        poses, _, calibration, bias = self._arrays(values)
        return float(self._graph.error(values)) + self._own.loss(poses, calibration, bias)

    def _linear(self) -> Any:
        linear = self._graph.linearize(self._values)
        poses, _, calibration, bias = self._arrays(self._values)
        self._own.add_to(linear, self._gtsam, poses, calibration, bias)
        return linear

    def _arrays(self, values: Any) -> tuple[Floats, Floats, Floats, Floats]:
        """Poses `(n, 3)`, landmarks `(m, 2)`, calibrations `(k, 6)` and biases `(d, 2)`."""
        take, p = self._gtsam.utilities, self._problem
        # in the order of the keys, "b" before "l"; rows that GTSAM keeps for vectors come last
        points = np.asarray(take.extractPoint2(values)).reshape(-1, 2)
        points = points[: len(p.bias_sd_m) + len(p.points_m)]
        biases = len(p.bias_sd_m)
        calibration = np.asarray(take.extractVectors(values, "c")).reshape(-1, _SIZE)
        return np.asarray(take.extractPose2(values)), points[biases:], calibration, points[:biases]

    def _solution(self, cost: float) -> Solution:
        p = self._problem
        poses, points, calibration, bias = self._arrays(self._values)
        off = points[p.link[:, 0]] - points[p.link[:, 1]] if len(p.link) else np.empty((0, 2))
        scaled2 = np.sum(off**2, axis=1) / p.link_sd_m**2
        link_weight = 1.0 / (1.0 + scaled2 / LINK_SCALE**2) ** 2
        residual = transform_points(poses[p.fix_from], p.fix_antenna_m) - p.fix_m
        fix2 = np.sum((residual + bias[p.fix_bias]) ** 2, axis=1) / p.fix_sd_m**2
        fix_weight = 1.0 / (1.0 + fix2 / FIX_CAUCHY**2)
        off = np.hypot(residual[:, 0], residual[:, 1])
        return Solution(poses, points, calibration, bias, cost, link_weight, fix_weight, off)

    def forget_marginals(self) -> None:
        """Free what covariances are computed from, which is most of a large graph's memory."""
        self._known = None

    def _marginals(self) -> Any:
        if self._known is None:
            self._known = self._gtsam.Marginals(self._linear(), self._values)
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
