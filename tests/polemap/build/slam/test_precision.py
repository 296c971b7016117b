"""What is stated of places that one pass saw alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.build.slam.config import SlamConfig
from polemap.build.slam.fix_noise import FixNoise
from polemap.build.slam.precision import graph_to_state
from polemap.build.slam.problem import seen_once
from tests.polemap.build.slam.loops import beside, block, simulated, solve

pytest.importorskip("gtsam")


def test_a_stretch_seen_once_is_stated_by_the_settings_of_its_fixes() -> None:
    rng = np.random.default_rng(401)
    poses = block(1.3)
    # one lap is 260 m; the first 78 m are driven twice
    sim = simulated(poses, beside(poses[:330], 6.0, rng), rng)
    state = solve(sim.drive)._state
    once = seen_once(state.problem)
    way = np.concatenate(
        [[0.0], np.cumsum(np.hypot(*np.diff(state.solution.poses[:, :2], axis=0).T))]
    )
    assert not once[(way > 15.0) & (way < 50.0)].any()
    assert once[(way > 120.0) & (way < 210.0)].mean() > 0.8

    measured = FixNoise(0.8, 0.4, 10.0)
    bias = state.problem.bias_share
    problem = replace(
        state.problem,
        bias_sd_m=np.full(len(bias), measured.lasting_m),
        bias_share=np.where(bias > 0.0, np.exp(-0.2), 0.0),
    )
    at = np.searchsorted(way, [40.0, 165.0]).astype(np.int64)
    none = np.empty(0, dtype=np.int64)
    sds = []
    for config in (SlamConfig(gnss_sd_m=0.8, gnss_correlation_s=10.0), SlamConfig(gnss_sd_m=4.0)):
        graph = graph_to_state(problem, state.solution, measured, measured, config)
        joint = graph.covariance(at, none)
        sds.append([np.sqrt(np.trace(joint[k : k + 2, k : k + 2]) / 2.0) for k in (0, 3)])
    (shared, alone), (shared_set, alone_set) = sds
    assert alone_set > 1.1 * alone
    assert alone_set / alone > shared_set / shared
