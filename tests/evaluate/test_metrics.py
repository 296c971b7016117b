import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.drivelog.streams import ReferenceStream
from polemap.evaluation.errors import accuracy, nees, pose_errors
from polemap.evaluation.run_metrics import smoothness, spread, timing_summary
from polemap.vehicle.trajectory import Trajectory


def reference(stamps, poses, sd=math.nan):
    return ReferenceStream(np.asarray(stamps), np.asarray(poses), np.full(len(stamps), sd))


@given(st.floats(-3.1, 3.1), st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
def test_errors_are_along_and_across_the_true_heading(yaw, along, across):
    true = np.array([[5.0, 6.0, yaw]])
    c, s = math.cos(yaw), math.sin(yaw)
    estimated = true + np.array([[c * along - s * across, s * along + c * across, 0.1]])
    assert pose_errors(estimated, true)[0] == pytest.approx([along, across, 0.1], abs=1e-9)


def test_yaw_errors_go_the_short_way():
    error = pose_errors(np.array([[0.0, 0.0, math.pi - 0.01]]), np.array([[0, 0, -math.pi + 0.01]]))
    assert error[0, 2] == pytest.approx(-0.02)


def test_nees_of_true_covariances_averages_the_degrees_of_freedom():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(3, 3)) * 0.1
    covariance = root @ root.T + 0.001 * np.eye(3)
    n = 4000
    true = np.zeros((n, 3))
    estimated = rng.multivariate_normal(np.zeros(3), covariance, n)
    values = nees(estimated, true, np.tile(covariance, (n, 1, 1)))
    assert abs(values.mean() - 3.0) < 4 * math.sqrt(2 * 3 / n)


def test_nees_of_an_unusable_covariance_is_nan():
    covariance = np.stack([np.eye(3), -np.eye(3), np.full((3, 3), np.nan)])
    values = nees(np.ones((3, 3)), np.zeros((3, 3)), covariance)
    assert values[0] == pytest.approx(3.0)
    assert np.isnan(values[1:]).all()


def test_accuracy_gives_every_figure():
    stamps = np.arange(0.0, 10.0, 0.1)
    true = np.column_stack([stamps, np.zeros(100), np.zeros(100)])
    estimated = true + np.array([0.3, -0.4, 0.02])
    figures = accuracy(
        Trajectory(stamps, estimated, np.tile(np.eye(3), (100, 1, 1))),
        reference(stamps, true, 0.05),
    )
    assert figures["longitudinal_rmse_m"] == pytest.approx(0.3)
    assert figures["lateral_rmse_m"] == pytest.approx(0.4)
    for name in ("position_rmse_m", "position_median_m", "position_p95_m", "position_max_m"):
        assert figures[name] == pytest.approx(0.5)
    assert figures["yaw_rmse_rad"] == pytest.approx(0.02)
    assert figures["nees_mean"] == pytest.approx((0.25 + 0.0004) / 3)
    assert figures["reference_sd_m"] == pytest.approx(0.05)


def test_poses_outside_the_reference_are_counted_and_not_scored():
    stamps = np.arange(0.0, 4.0, 0.5)
    true = np.zeros((4, 3))
    figures = accuracy(Trajectory(stamps, np.zeros((8, 3))), reference(stamps[:4], true))
    assert figures["poses"] == 4
    assert figures["poses_without_reference"] == 4
    assert "nees_mean" not in figures
    assert accuracy(Trajectory(stamps + 100, np.zeros((8, 3))), reference(stamps[:4], true)) == {
        "poses": 0.0,
        "poses_without_reference": 8.0,
    }


def test_a_smooth_path_is_smoother_than_a_noisy_one_by_the_noises_third_difference():
    stamps = np.arange(0.0, 20.0, 0.01)
    path = np.column_stack([10 * stamps, np.sin(0.1 * stamps), 0.1 * np.cos(0.1 * stamps)])
    noisy = path.copy()
    noisy[:, 1] += np.random.default_rng(0).normal(0.0, 0.01, len(stamps))
    assert smoothness(stamps, path)["lateral_third_difference_m"] < 1e-6
    # the third difference of white noise has variance 1 + 9 + 9 + 1 times the noise's
    expected = 0.01 * math.sqrt(20.0)
    found = smoothness(stamps, noisy)
    assert found["lateral_third_difference_m"] == pytest.approx(expected, rel=0.1)
    assert found["lateral_jerk_rms_mps3"] == pytest.approx(expected / 0.01**3, rel=0.1)
    assert smoothness(stamps[:3], path[:3]) == {}


def test_gaps_do_not_count_as_roughness():
    stamps = np.concatenate([np.arange(0.0, 5.0, 0.01), np.arange(50.0, 55.0, 0.01)])
    path = np.column_stack([10 * stamps, np.zeros(len(stamps)), np.zeros(len(stamps))])
    assert smoothness(stamps, path)["longitudinal_third_difference_m"] < 1e-9


def test_timings_are_in_milliseconds():
    summary = timing_summary({"tick": [0.001] * 99 + [0.1], "none": []})
    assert summary["tick"]["median"] == pytest.approx(1.0)
    assert summary["tick"]["calls"] == 100
    assert summary["tick"]["p99"] > 1.0
    assert "none" not in summary


def test_spread_is_over_every_shared_number():
    runs = [
        {"kf": {"rmse": 1.0}, "count": 2, "name": "x", "nan": math.nan},
        {"kf": {"rmse": 3.0}, "count": 4, "name": "x", "nan": 5.0},
    ]
    result = spread(runs)
    assert result["kf"]["rmse"] == {
        "mean": 2.0,
        "sd": pytest.approx(math.sqrt(2.0)),
        "min": 1.0,
        "max": 3.0,
        "runs": 2,
    }
    assert result["count"]["mean"] == 3.0
    assert result["nan"]["runs"] == 1
    assert "name" not in result
    assert spread([]) == {}
