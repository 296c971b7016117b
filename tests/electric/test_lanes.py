"""Lanes in signal logs: rows joined, late curvature held from its arrival, a bend in the models."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.lanes import LaneTrack, camera_settings, lane_log, with_lanes
from polemap.electric.signals import SignalLog, arrived, play
from polemap.vehicle.discretize import zero_order_hold
from polemap.vehicle.io import load_car
from polemap.vehicle.single_track import bend_of_lane, combined_vision

Floats = NDArray[np.float64]
CAR = load_car("coms")


def track(stamps: list[float], late_s: float = 0.03, curvature: float = 0.0) -> LaneTrack:
    n = len(stamps)
    value = np.tile([0.01, 0.2, curvature], (n, 1))
    covariance = np.tile(np.diag([0.004, 0.03, 0.001]) ** 2, (n, 1, 1))
    return LaneTrack(
        np.array(stamps), np.array(stamps) + late_s, value, covariance, np.full(n, 3.5),
        np.full(n, 2), np.full(n, 0.01),
    )  # fmt: skip


def log(n: int = 11, step_s: float = 0.1) -> SignalLog:
    stamps = np.arange(n) * step_s
    return SignalLog(stamps, {"yaw_rate_radps": stamps + 1.0, "heading_rad": np.zeros(n)})


def test_pictures_get_rows_of_their_own_or_join_one() -> None:
    joined = with_lanes(log(), track([0.2, 0.25, 0.7000000001, 3.0]))
    assert len(joined) == 12  # only 0.25 is new, 3.0 lies outside
    seen = np.isfinite(joined.columns["heading_rad"])
    assert joined.stamp_s[seen] == pytest.approx([0.2, 0.25, 0.7])
    assert np.isnan(joined.columns["yaw_rate_radps"][joined.stamp_s == 0.25]).all()
    assert np.count_nonzero(np.isfinite(joined.columns["yaw_rate_radps"])) == 11
    assert joined.columns["camera_arrival_s"][seen] == pytest.approx([0.23, 0.28, 0.73])


def test_pictures_beside_the_log_are_told() -> None:
    with pytest.raises(InputError, match="no picture with a lane falls into"):
        with_lanes(log(), track([5.0, 6.0]))


def test_deviations_and_correlations_are_those_of_the_covariance() -> None:
    one = track([0.0, 0.1])
    root = np.random.default_rng(0).standard_normal((3, 3))
    one.covariance[:] = root @ root.T
    columns = lane_log(one).columns
    sd = [columns[n][0] for n in ("heading_sd_rad", "lateral_offset_sd_m")]
    assert columns["corr_heading_offset"][0] * sd[0] * sd[1] == pytest.approx((root @ root.T)[0, 1])


def test_a_log_brings_its_cameras_deviations_rate_and_delay() -> None:
    settings = camera_settings(with_lanes(log(), track([0.1, 0.3, 0.5, 0.7], late_s=0.25)))
    assert settings == pytest.approx(
        {"heading_sd_rad": 0.004, "lateral_offset_sd_m": 0.03, "curvature_sd_per_m": 0.001,
         "camera_period_s": 0.2, "camera_delay_s": 0.25, "camera_slots": 2}
    )  # fmt: skip
    assert camera_settings(log()) == {}


def test_a_late_column_holds_from_its_arrival() -> None:
    nan = float("nan")
    columns = {
        "road_curvature_per_m": np.array([nan, 1.0, nan, 2.0, nan, nan]),
        "camera_arrival_s": np.array([nan, 0.25, nan, 0.35, nan, nan]),
    }
    late = SignalLog(np.arange(6) * 0.1, columns)
    held = arrived(late, "road_curvature_per_m", "camera_arrival_s")
    assert held.tolist() == [0.0, 0.0, 0.0, 1.0, 2.0, 2.0]
    assert not arrived(log(), "road_curvature_per_m", "camera_arrival_s").any()


def test_a_bend_is_what_the_exponential_of_the_model_says() -> None:
    v, kappa, period = 14.0, 0.01, 0.05
    a, _ = combined_vision(CAR, v)
    drive = np.array([[0.0], [0.0], [-v], [0.0]])
    _, h = zero_order_hold(a, drive, period)
    assert bend_of_lane(v, kappa, period) == pytest.approx((h[2:, 0] * kappa).tolist())


def bent_road(curvature: float, told: bool) -> tuple[SignalLog, Floats]:
    """A car that follows a bend exactly, from its model: log and true side-slip."""
    config, v = EstimatorConfig(), 8.0
    stamps = np.arange(6001) * config.step_s
    a, b = combined_vision(CAR, v)
    steady = np.linalg.solve(np.column_stack([a[:2, 0], b[:2, 0]]), -a[:2, 1] * v * curvature)
    slip, steering = float(steady[0]), float(steady[1])
    rows = np.arange(33, 6001, 33)
    heading, offset, kappa, arrival = (np.full(6001, np.nan) for _ in range(4))
    # the preview point keeps its place where its velocity lies along the lane
    heading[rows] = -slip - CAR.preview_m * curvature
    offset[rows], kappa[rows], arrival[rows] = 0.1, curvature, stamps[rows] + 0.033
    columns = {
        "road_wheel_angle_rad": np.full(6001, steering), "vx_mps": np.full(6001, v),
        "yaw_rate_radps": np.full(6001, v * curvature), "heading_rad": heading,
        "lateral_offset_m": offset, "camera_arrival_s": arrival,
    }  # fmt: skip
    if told:
        columns["road_curvature_per_m"] = kappa
    return SignalLog(stamps, columns), np.full(6001, slip)


@pytest.mark.parametrize(
    "name", ["clones", "replay", "single_rate", "compensated", "stiffness", "uneven_delay"]
)
def test_a_bend_does_not_lean_the_sideslip_of_a_model_that_is_told_of_it(name: str) -> None:
    errors = []
    for told in (True, False):
        made, truth = bent_road(0.01, told)
        config = EstimatorConfig(heading_walk_rad=0.0)
        played = play(make_estimator(name, CAR, config), made, every=50)
        errors.append(np.abs(played.column("sideslip_rad") - truth[::50])[60:].max())
    assert errors[0] < 0.3 * errors[1]
    assert errors[0] < 0.004
