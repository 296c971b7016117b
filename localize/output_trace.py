"""What a localizer said, tick by tick and update by update, as trajectories."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from polemap.localize.output_filter.limiter import OutputPose
from polemap.localize.pose_queue import PoseUpdate
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]
_ROW = 7


class OutputTrace:
    """Answers at rising stamps, kept as flat numbers: 17 doubles a tick."""

    def __init__(self) -> None:
        self._stamps = array("d")
        self._rows = array("d")
        self._covariance = array("d")
        self._flags: list[str] = []
        self._distrust: list[str] = []

    def append(self, stamp_s: float, answer: OutputPose) -> None:
        """Keep the answer for a tick."""
        self._stamps.append(stamp_s)
        self._rows.extend(
            (
                *answer.pose,
                answer.speed_mps,
                answer.yaw_rate_radps,
                answer.jump_m,
                answer.pose_age_s,
            )
        )
        self._covariance.extend(answer.covariance.ravel().tolist())
        self._flags.append(answer.flag)
        self._distrust.append(answer.distrust)

    def result(self) -> tuple[Trajectory, Floats, tuple[str, ...], tuple[str, ...]]:
        """Trajectory; speed, yaw rate, jump and pose age `(n, 4)`; flags; reasons of distrust."""
        rows = np.array(self._rows).reshape(-1, _ROW)
        covariance = np.array(self._covariance).reshape(-1, 3, 3)
        kf = Trajectory(np.array(self._stamps), rows[:, :3], covariance)
        return kf, rows[:, 3:], tuple(self._flags), tuple(self._distrust)


def particle_trajectory(updates: Sequence[PoseUpdate]) -> Trajectory:
    """The particle filter's poses, sorted by stamp: they become known in the order of arrival."""
    pf = Trajectory(
        np.array([u.estimate.stamp_s for u in updates]),
        np.array([u.estimate.pose for u in updates]).reshape(-1, 3),
        np.array([u.estimate.covariance for u in updates]).reshape(-1, 3, 3),
    )
    return pf.rows(np.argsort(pf.stamp_s, kind="stable"))
