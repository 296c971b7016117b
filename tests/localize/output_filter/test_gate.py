"""The gate passes the share of right measurements that it promises, and all when it is off."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from scipy.stats import chi2

from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.gate import fails_gate, gate_limits


def test_right_measurements_fail_as_seldom_as_promised() -> None:
    limits = gate_limits(OutputConfig(pose_gate=0.95))
    nis = (np.random.default_rng(0).standard_normal((20_000, 3)) ** 2).sum(axis=1)
    share = np.mean([not fails_gate(value, limits.pose) for value in nis])
    # five standard deviations of a share of 0.95 over 20,000
    assert share == pytest.approx(0.95, abs=5 * np.sqrt(0.95 * 0.05 / 20_000))
    assert limits.odometry == pytest.approx(chi2.ppf(0.9999, 2))
    assert limits.gnss == pytest.approx(chi2.ppf(0.99, 2))


def test_a_gate_that_is_off_passes_everything() -> None:
    limits = gate_limits(OutputConfig(gate=False))
    assert set(limits) == {inf}
    assert not any(fails_gate(value, limits.pose) for value in (0.0, 1e300, inf))
