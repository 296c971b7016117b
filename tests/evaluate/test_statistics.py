"""Bootstrap, error summaries, trajectories and table text."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.evaluation.bootstrap import Blocks, error_blocks, paired_difference
from polemap.evaluation.errors import errors_against, summary
from polemap.evaluation.meanpath import MeanPath
from polemap.tools.report.tables import (
    Table,
    csv_text,
    escape_latex,
    latex_text,
    number,
    with_spread,
)
from polemap.vehicle.trajectory import Trajectory


def blocks(rng: np.random.Generator, sd: float, runs: int, shared: np.ndarray) -> Blocks:
    noise = rng.normal(0.0, sd, (runs, *shared.shape)) + shared
    return Blocks((noise**2).sum(axis=2), np.full((runs, len(shared)), shared.shape[1]))


def test_bootstrap_interval_covers_the_true_difference() -> None:
    """Paired runs with a shared part: 95 % of 200 intervals, within three standard errors."""
    inside = []
    true = np.hypot(0.10, 0.08) - np.hypot(0.06, 0.08)
    for seed in range(200):
        rng = np.random.default_rng(seed)
        shared = rng.normal(0.0, 0.08, (40, 25))
        a, b = blocks(rng, 0.10, 4, shared), blocks(rng, 0.06, 4, shared)
        found = paired_difference(a, b, rng, draws=400)
        assert found is not None
        inside.append(found.low <= true <= found.high)
    assert np.mean(inside) >= 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / 200) - 0.02


def test_bootstrap_of_equal_systems_is_not_clear() -> None:
    clear = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        shared = rng.normal(0.0, 0.05, (40, 25))
        found = paired_difference(
            blocks(rng, 0.1, 3, shared), blocks(rng, 0.1, 1, shared), rng, 400
        )
        assert found is not None
        clear += found.clear
    assert clear <= 12


def test_too_few_blocks_have_no_interval() -> None:
    rng = np.random.default_rng(0)
    one = blocks(rng, 0.1, 2, np.zeros((3, 5)))
    assert paired_difference(one, one, rng) is None


def test_errors_in_the_direction_of_travel() -> None:
    stamps = np.arange(50) / 10.0
    yaw = np.full(50, 2.0)
    truth = Trajectory(
        stamps, np.column_stack([8.0 * stamps * np.cos(2.0), 8.0 * stamps * np.sin(2.0), yaw])
    )
    poses = truth.poses.copy()
    poses[:, 0] += 0.3 * np.cos(2.0) - 0.2 * np.sin(2.0)
    poses[:, 1] += 0.3 * np.sin(2.0) + 0.2 * np.cos(2.0)
    poses[:, 2] -= 2.0 * np.pi - 0.01
    errors = errors_against(Trajectory(stamps, poses), truth)
    assert np.allclose(errors.longitudinal_m, 0.3)
    assert np.allclose(errors.lateral_m, 0.2)
    assert np.allclose(errors.yaw_rad, 0.01)
    found = summary(errors)
    assert found["position_rmse_m"] == pytest.approx(np.hypot(0.3, 0.2))
    sums = error_blocks([errors], "lateral_m", 0.0, 4.9, 1.0)
    assert sums.squares.sum() == pytest.approx(50 * 0.04)
    assert sums.root_mean() == pytest.approx(0.2)


def test_interpolation_keeps_out_of_gaps_and_wraps() -> None:
    track = Trajectory(
        np.array([0.0, 1.0, 5.0]), np.array([[0.0, 0, 3.1], [1.0, 0, -3.1], [2, 0, 0]])
    )
    poses = track.at(np.array([-0.1, 0.5, 3.0, 6.0]), max_gap_s=2.0)
    assert np.isnan(poses[[0, 2, 3]]).all()
    assert abs(abs(poses[1, 2]) - np.pi) < 1e-9


def test_projection_on_a_circle() -> None:
    angle = np.linspace(0.0, 3.0, 400)
    path = MeanPath.through(20.0 * np.column_stack([np.cos(angle), np.sin(angle)]))
    assert path.length_m == pytest.approx(60.0, abs=0.01)
    probe = np.array([0.5, 1.5, 2.5])
    points = 21.5 * np.column_stack([np.cos(probe), np.sin(probe)])
    station, deviation = path.project(points, 20.0 * probe + 3.0)
    assert np.allclose(station, 20.0 * probe, atol=5e-3)
    assert np.allclose(deviation, -1.5, atol=2e-3)
    far = path.project(np.array([[300.0, 300.0]]), np.array([10.0]))
    assert np.isnan(far).all()


def test_cells() -> None:
    assert number(float("nan")) == "–"
    assert number(None) == "–"
    assert with_spread(0.1234, float("nan")) == "0.123"
    assert with_spread(0.1234, 0.01) == "0.123 ± 0.010"
    assert escape_latex(r"50 % & \alpha_1 {x}") == r"50 \% \& \textbackslash{}alpha\_1 \{x\}"
    table = Table("t", "A & B", ("a", "b"), (("=1+1", "-0.5"), ("@x", "-x")))
    assert csv_text(table).splitlines()[1:] == ["'=1+1,-0.5", "'@x,'-x"]
    assert r"A \& B" in latex_text([table])
    with pytest.raises(ValueError, match="has not 2 cells"):
        Table("t", "T", ("a", "b"), (("1",),))
