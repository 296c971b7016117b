"""Sensors: their errors have the size and the memory that the settings state."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.simulate import sensors
from polemap.simulate.config import GnssConfig, OdometryConfig
from polemap.simulate.driver import Motion, drive_route
from polemap.simulate.route import make_route
from polemap.simulate.scenario import Scenario
from polemap.simulate.skyline import Fronts, echoes
from polemap.simulate.traffic import make_traffic
from polemap.simulate.world import make_world

ORIGIN = np.array([400_000.0, 5_800_000.0])
OPEN = Fronts.of([])
CANYON = Fronts.of([(20.0, -15.0, 0.0, 400.0, 200.0)])


@pytest.fixture(scope="module")
def motion(street: Scenario) -> Motion:
    route = make_route(street.route.corners_m, street.route.corner_radius_m, True)
    return drive_route(route, street.drive, 3, np.random.default_rng(3))


def test_gauss_markov_noise_has_its_sd_and_memory() -> None:
    stamps = np.arange(0, 4000, 0.5)
    noise = sensors.gauss_markov(stamps, 2.0, 10.0, np.random.default_rng(5), 3)
    # about 200 independent stretches a column
    assert noise.std() == pytest.approx(2.0, rel=4 / np.sqrt(2 * 600))
    lag = np.mean(noise[20:] * noise[:-20]) / noise.var()
    assert lag == pytest.approx(np.exp(-1.0), abs=0.12)


def test_odometry_rolls_the_way_within_its_scale(motion: Motion) -> None:
    config = OdometryConfig()
    ratios, biases = [], []
    way = np.sum(motion.speed_mps) * 0.005
    for seed in range(40):
        stream = sensors.odometry(motion, config, np.random.default_rng(seed))
        ratios.append(np.sum(stream.speed_mps) / config.rate_hz / way)
        still = stream.stamp_s < 0.9
        assert np.all(stream.speed_mps[still] == 0)
        biases.append(stream.yaw_rate_radps[still].mean())
        assert np.all(stream.arrival_s > stream.stamp_s)
    assert np.mean(ratios) == pytest.approx(1.0, abs=4 * config.speed_scale_sd / np.sqrt(40) + 1e-3)
    assert np.std(ratios) == pytest.approx(config.speed_scale_sd, rel=0.5)
    assert np.std(biases) == pytest.approx(config.yaw_bias_sd_radps, rel=0.5)


def test_odometry_without_errors_is_the_truth(motion: Motion) -> None:
    config = OdometryConfig(
        speed_scale_sd=0, speed_noise_sd_mps=0, yaw_bias_sd_radps=0, yaw_noise_sd_radps=0,
    )  # fmt: skip
    stream = sensors.odometry(motion, config, np.random.default_rng(0), sensors.NO_WHEEL_ERRORS)
    assert np.allclose(stream.speed_mps, motion.value("speed_mps", stream.stamp_s), atol=1e-9)
    rate = motion.value("yaw_rate_radps", stream.stamp_s)
    assert np.allclose(stream.yaw_rate_radps, rate, atol=1e-12)


def test_gnss_errors_over_many_drives(motion: Motion) -> None:
    quiet = GnssConfig(multipath_per_min=0, outages_per_min=0)
    errors = []
    for seed in range(60):
        stream = sensors.gnss(motion, ORIGIN, quiet, np.random.default_rng(seed), OPEN)
        pose = motion.at(stream.stamp_s)
        antenna = pose[:, :2] + 0.4 * np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], 1)
        place = np.stack([stream.east_m, stream.north_m], 1) - ORIGIN
        errors.append((place - antenna)[len(place) // 2])
    expected = np.hypot(quiet.wander_sd_m, sensors.ReceiverErrors().noise_sd_m)
    assert np.std(errors) == pytest.approx(expected, rel=4 / np.sqrt(2 * 120))


def test_gnss_jumps_raise_hdop_and_outages_remove_fixes(motion: Motion) -> None:
    quiet = GnssConfig(multipath_per_min=0, outages_per_min=0)
    loud = GnssConfig(multipath_per_min=30, outages_per_min=0)
    far_jumps = sensors.ReceiverErrors(multipath_sd_m=8)
    gone = GnssConfig(outages_per_min=20)
    streams = [
        sensors.gnss(motion, ORIGIN, config, np.random.default_rng(1), CANYON, far_jumps)
        for config in (quiet, loud, gone)
    ]
    assert streams[1].hdop.max() > streams[0].hdop.max() + 0.2
    assert len(streams[2]) < 0.8 * len(streams[0])


def test_gnss_jumps_come_beside_high_fronts_only_and_across_them(motion: Motion) -> None:
    # one tall house along the first leg of the loop, which lies on the x axis
    beside = Fronts.of([(20.0, -14.0, 0.0, 16.0, 12.0)])
    config = GnssConfig(multipath_per_min=60, wander_sd_m=0.0, outages_per_min=0.0)
    silent = sensors.ReceiverErrors(noise_sd_m=0.0, multipath_sd_m=8)
    near, far = [], []
    for seed in range(8):
        stream = sensors.gnss(motion, ORIGIN, config, np.random.default_rng(seed), beside, silent)
        pose = motion.at(stream.stamp_s)
        lever = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], 1)
        antenna = pose[:, :2] + config.antenna_x_m * lever
        error = np.stack([stream.east_m, stream.north_m], 1) - ORIGIN - antenna
        share, _ = echoes(antenna, beside)
        near.append(error[share > 0.5])
        far.append(error[share == 0.0])
    assert np.abs(np.concatenate(far)).max() < 1e-6
    jumps = np.concatenate(near)
    assert (np.hypot(*jumps.T) > 1).mean() > 0.2
    assert jumps[:, 1].std() > 1.3 * jumps[:, 0].std()


def test_echoes_rise_with_the_front_and_point_at_it() -> None:
    fronts = Fronts.of([(0.0, 10.0, 0.0, 20.0, 15.0)])
    share, toward = echoes(np.array([[0.0, 0.0], [0.0, -60.0], [14.0, 10.0]]), fronts)
    assert share[0] == 1.0
    assert share[1] == 0.0
    assert toward == pytest.approx(np.array([[0, 1], [0, 1], [-1, 0]]), abs=1e-9)
    assert echoes(np.zeros((2, 2)), OPEN)[0].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("kind", "low", "high"), [("good", 0.01, 0.03), ("drifting", 0.4, 1.3)])
def test_references_are_good_or_drift(motion: Motion, kind: str, low: float, high: float) -> None:
    errors = sensors.REFERENCES[kind]
    ends = []
    for seed in range(40):
        stream = sensors.reference(motion, ORIGIN, errors, 50.0, np.random.default_rng(seed))
        truth = motion.at(stream.stamp_s)
        ends.append((stream.poses[:, :2] - ORIGIN - truth[:, :2])[-1])
    assert low < np.std(ends) < high


def test_pictures_arrive_late_in_order_and_some_never(motion: Motion) -> None:
    latency = sensors.CameraLatency(drop_share=0.2)
    stamps, late = sensors.frame_times(motion, 20.0, np.random.default_rng(1), latency)
    delay = late - stamps
    assert delay.min() >= latency.least_s
    assert delay.max() <= latency.largest_s + 0.06
    assert np.all(np.diff(late) >= 0)
    share = len(stamps) / (motion.stamp_s[-1] * 20)
    assert share == pytest.approx(0.8, abs=0.06)


def test_nothing_that_moves_drives_through_another(street: Scenario, motion: Motion) -> None:
    busy = street.traffic.model_copy(
        update={"oncoming_per_km": 150, "beside_per_km": 60, "ahead_per_km": 60}
    )
    world = make_world(street.model_copy(update={"traffic": busy}), 2)
    movers = make_traffic(world, motion, np.random.default_rng(0))
    cars = [m for m in movers if m.stride_s == 0]
    assert len(cars) > 5
    for stamp in np.arange(0, motion.stamp_s[-1], 0.5):
        here = [
            (m.station_m + m.speed_mps * (stamp - m.from_s), m.lateral_m)
            for m in cars
            if m.from_s <= stamp < m.until_s
        ]
        own = (
            float(motion.value("station_m", np.array([stamp]))[0]),
            float(motion.value("lateral_m", np.array([stamp]))[0]),
        )
        places = [*here, own]
        for i, (s1, l1) in enumerate(places):
            for s2, l2 in places[i + 1 :]:
                assert abs(l1 - l2) > 1.2 or abs(s1 - s2) > 5.0
