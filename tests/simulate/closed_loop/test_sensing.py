"""The plant's sensors: rates, delays, and the truth where noise is off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.errors import ConfigError
from polemap.electric.estimators.base import CAMERA, GPS, YAW_RATE, Estimate, Inputs, Value
from polemap.electric.estimators.registry import ESTIMATORS
from polemap.simulate.closed_loop.cars import plant_of
from polemap.simulate.closed_loop.choice import CAMERA_NOISE, choose, fresh, kinds_for
from polemap.simulate.closed_loop.sensing import SensorFeed, SensorModel
from polemap.simulate.plant import Plant, PlantInput
from polemap.vehicle.io import load_car

COMS = load_car("coms")
QUIET = SensorModel(
    gyro_sd_radps=0.0,
    acceleration_sd_mps2=0.0,
    acceleration_bias_mps2=0.0,
    roll_rad_per_mps2=0.0,
    steering_sd_rad=0.0,
    wheel_sd_radps=0.0,
    preview_m=COMS.preview_m,
    heading_sd_rad=0.0,
    offset_sd_m=0.0,
    gps_period_s=0.05,
    course_sd_rad=0.0,
    gps_speed_sd_mps=0.0,
)


class Recorder:
    """An estimator that only writes down what it is told."""

    fields = ("sideslip_rad",)

    def __init__(self) -> None:
        self.dropped: dict[str, int] = {}
        self.inputs: list[Inputs] = []
        self.values: list[tuple[str, Value, float, float]] = []
        self.captures: list[tuple[str, float]] = []

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        self.inputs.append(inputs)

    def capture(self, kind: str, stamp_s: float) -> None:
        self.captures.append((kind, stamp_s))

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        self.values.append((kind, value, stamp_s, arrival_s))

    def estimate(self) -> Estimate:
        return Estimate(0.0, self.fields, np.zeros(1), np.zeros(1))

    def covariance(self) -> np.ndarray:
        return np.eye(1)


def test_late_values_come_late_and_hold_the_truth_of_their_capture() -> None:
    parameters, recorder = plant_of(COMS), Recorder()
    plant = Plant(parameters)
    feed = SensorFeed(parameters, QUIET, np.random.default_rng(0), recorder, (CAMERA, GPS))
    state, truth, moments = plant.rolling(6.0), {}, []
    for _ in range(1000):
        measured = feed.step(state)
        truth[round(state.time_s, 6)] = state
        moments.append(measured.yaw_moment_nm)
        assert measured.yaw_rate_radps == state.yaw_rate_radps
        assert measured.speed_mps == pytest.approx(state.vx_mps, rel=0.01)
        state = plant.step(state, PlantInput(0.03, (0.0, 0.0, -20.0, 20.0)))
    # two motors of 20 N m at the rim, half a track aside each
    assert moments[-1] == pytest.approx(40.0 / 0.22 * 0.82 / 2.0, rel=1e-6)
    for kind, delay, period in ((CAMERA, 0.033, 0.033), (GPS, 0.1, 0.05)):
        late = [v for v in recorder.values if v[0] == kind]
        stamps = np.array([v[2] for v in late])
        np.testing.assert_allclose([v[3] - v[2] for v in late], delay, atol=1e-9)
        np.testing.assert_allclose(np.diff(stamps), period, atol=1e-9)
        assert {s for k, s in recorder.captures if k == kind} >= set(stamps.tolist())
        for _, value, stamp, _ in late:
            then = truth[round(stamp, 6)]
            yaw, beta = then.yaw_rad, np.arctan2(then.vy_mps, then.vx_mps)
            assert isinstance(value, tuple)
            if kind == CAMERA:
                offset = then.north_m + COMS.preview_m * yaw
                assert value == pytest.approx((yaw, offset))
            else:
                speed = np.hypot(then.vx_mps, then.vy_mps)
                assert value == pytest.approx((yaw + beta, speed))
    assert sum(v[0] == YAW_RATE for v in recorder.values) == 1000
    # inputs hold over the step that ends at the stamp: those of the step before
    assert recorder.inputs[5].road_wheel_angle_rad == truth[0.004].steer_rad


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_every_estimator_can_be_fed(name: str) -> None:
    parameters = plant_of(COMS)
    kinds = kinds_for(name, (CAMERA, GPS))
    assert kinds is not None
    estimator = fresh(name, COMS, CAMERA_NOISE)
    model = replace(QUIET, gyro_sd_radps=0.003, heading_sd_rad=0.002, course_sd_rad=0.003)
    feed = SensorFeed(parameters, model, np.random.default_rng(0), estimator, kinds)
    plant = Plant(parameters)
    state = plant.rolling(6.0)
    for _ in range(600):
        feed.step(state)
        state = plant.step(state, PlantInput(0.02))
    assert estimator.estimate().value("sideslip_rad") == pytest.approx(
        state.sideslip_rad(), abs=0.05
    )
    assert not estimator.dropped


def test_estimators_that_lack_a_sensor_or_a_state_are_refused() -> None:
    assert choose("x", (), ("bicycle",), (GPS,), "sideslip_rad") == ("bicycle",)
    with pytest.raises(ConfigError, match="x: estimator clones cannot serve here; bicycle, "):
        choose("x", ("clones",), (), (GPS,), "sideslip_rad")
    with pytest.raises(ConfigError, match="estimator bicycle cannot serve here; kinematic, "):
        choose("x", ("bicycle",), (), (GPS,), "vx_mps")


def test_a_car_without_motors_is_refused() -> None:
    with pytest.raises(ConfigError, match="passat: rear_track_m is not known"):
        plant_of(load_car("passat"))
