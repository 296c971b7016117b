"""Exact late filters: against each other, against the generic parts, and against their own sd."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import (
    CAMERA,
    GPS,
    KINDS,
    YAW_RATE,
    Estimator,
    Inputs,
)
from polemap.electric.estimators.registry import ESTIMATORS, make_estimator
from polemap.electric.signals import play
from polemap.electric.studies.outcomes import outcome
from polemap.electric.studies.scenes import (
    MATCHED,
    PATTERN_S,
    Scene,
    drive_with_camera,
    drive_with_gps,
)
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.io import load_car

COMS, SPEED = load_car("coms"), 25 / 3.6


@pytest.mark.parametrize("delays", [(0.033,), PATTERN_S])
def test_clones_and_replay_are_one_filter_and_reconstruction_is_near(
    delays: tuple[float, ...],
) -> None:
    scene = Scene(SPEED, 1.5, delays_s=delays)
    drive = drive_with_camera(COMS, scene, MATCHED, np.random.default_rng(4))
    played = {
        name: play(make_estimator(name, COMS, MATCHED), drive.log)
        for name in ("clones", "replay", "reconstruction")
    }
    clones, replay = played["clones"], played["replay"]
    assert np.abs(clones.mean - replay.mean).max() < 1e-9
    assert np.abs(clones.sd - replay.sd).max() < 1e-9
    near = played["reconstruction"]
    assert np.abs(clones.mean - near.mean)[:, 0].max() < 0.2 * clones.sd[200:, 0].min()
    assert (near.sd > clones.sd - 1e-9).all()
    np.testing.assert_allclose(near.sd[200:], clones.sd[200:], rtol=0.02)


def test_clones_stay_exact_with_two_pictures_on_their_way() -> None:
    config = MATCHED.model_copy(update={"camera_slots": 3})
    scene = Scene(SPEED, 1.2, delays_s=(0.05, 0.06), period_s=0.033)
    drive = drive_with_camera(COMS, scene, config, np.random.default_rng(5))
    clones = make_estimator("clones", COMS, config)
    first, second = play(clones, drive.log), play(make_estimator("replay", COMS, config), drive.log)
    assert np.abs(first.mean - second.mean).max() < 1e-9
    assert not clones.dropped


@pytest.mark.slow
def test_exact_filter_is_consistent_and_others_are_ordered() -> None:
    """Matched noise, 6 drives of 8 s. Side-slip errors correlate over some 0.2 s (about 200 are
    independent), heading and offset over a second (about 40, each of variance 2/4): the bounds
    are three sigma of the mean.
    """
    scene = Scene(SPEED, 8.0, 0.1, 0.5, PATTERN_S)
    drives = [
        drive_with_camera(COMS, scene, MATCHED, np.random.default_rng(100 + seed))
        for seed in range(6)
    ]
    exact = outcome("clones", COMS, MATCHED, drives, with_nees=True)
    assert 0.66 < exact.nees < 1.34
    assert 0.85 < exact.rmse_rad / exact.sd_rad < 1.15
    ratio = {
        name: outcome(name, COMS, MATCHED, drives).rmse_rad / exact.rmse_rad
        for name in ("reconstruction", "uneven_delay", "measurement_reconstruction", "bicycle")
    }
    assert ratio["reconstruction"] == pytest.approx(1.0, abs=0.01)
    assert ratio["uneven_delay"] < 1.05
    assert ratio["measurement_reconstruction"] < 1.08
    assert ratio["bicycle"] > 1.02
    ignored = MATCHED.model_copy(update={"camera_delay_s": 0.0})
    base = outcome("clones", COMS, MATCHED, drives[:1]).rmse_rad
    assert outcome("multi_rate", COMS, ignored, drives[:1]).rmse_rad > 1.2 * base


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_every_estimator_keeps_the_protocol(name: str) -> None:
    config = EstimatorConfig()
    estimator: Estimator = make_estimator(name, COMS, config)
    for step in range(80):
        stamp = step * 0.001
        speed = 6.0 + 0.01 * step if step < 40 else 0.4
        estimator.step(stamp, Inputs(0.02, speed, 5.0, 0.1, 0.5, 0.05))
        estimator.measure(YAW_RATE, 0.05, stamp, stamp)
        estimator.measure("lateral_acceleration", 0.4, stamp, stamp)
        estimator.measure("wheel_speed", speed, stamp, stamp)
        if step % 33 == 10 and step > 33:
            for kind in (CAMERA, GPS):
                estimator.measure(kind, (0.01, 5.0), stamp - 0.033, stamp)
        if step % 33 == 10:
            kind = (
                GPS
                if GPS in ESTIMATORS[name].late and CAMERA not in ESTIMATORS[name].late
                else CAMERA
            )
            estimator.capture(kind, stamp)
    now = estimator.estimate()
    assert now.fields == estimator.fields
    assert np.isfinite(now.mean).all()
    assert (now.sd > 0.0).all()
    p = estimator.covariance()
    assert p.shape == (len(now.fields),) * 2
    assert np.linalg.eigvalsh(p).min() > -1e-12
    assert now.value("sideslip_rad") == now.mean[0]
    assert now.sd_of("sideslip_rad") == now.sd[0]
    with pytest.raises(VehicleError, match="does not follow"):
        estimator.step(0.01, Inputs(0.0, 6.0))


@pytest.mark.parametrize(
    "name",
    ["clones", "replay", "compensated", "uneven_delay", "stiffness", "measurement_reconstruction"],
)
def test_a_value_that_is_no_pair_is_refused(name: str) -> None:
    estimator = make_estimator(name, COMS, EstimatorConfig())
    estimator.step(0.0, Inputs(0.0, 5.0))
    for bad in (0.1, (0.1,), (float("nan"), 1.0), ("a", 2.0)):
        with pytest.raises(VehicleError, match=CAMERA):
            estimator.measure(CAMERA, bad, 0.0, 0.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "name",
    ["clones", "compensated", "uneven_delay", "two_layer", "measurement_reconstruction"],
)
def test_values_without_a_capture_are_counted(name: str) -> None:
    estimator = make_estimator(name, COMS, EstimatorConfig())
    estimator.step(0.0, Inputs(0.0, 5.0))
    before = estimator.estimate().mean
    estimator.measure(GPS if name == "two_layer" else CAMERA, (0.1, 5.0), -0.1, 0.0)
    assert sum(estimator.dropped.values()) == 1
    np.testing.assert_array_equal(estimator.estimate().mean, before)


@pytest.mark.parametrize("name", ["clones", "compensated", "reconstruction"])
def test_a_lost_camera_is_said_and_comes_back_without_a_jump(name: str) -> None:
    scene = Scene(SPEED, 6.0, 0.05, 0.5)
    drive = drive_with_camera(COMS, scene, MATCHED, np.random.default_rng(9))
    columns = dict(drive.log.columns)
    silent = (drive.log.stamp_s > 2.0) & (drive.log.stamp_s < 4.0)
    for column in ("heading_rad", "lateral_offset_m"):
        columns[column] = np.where(silent, np.nan, columns[column])
    log = type(drive.log)(drive.log.stamp_s, columns)
    played = play(make_estimator(name, COMS, MATCHED), log)
    offset_sd = played.sd_of("lateral_offset_m")
    assert offset_sd[3990] > 5.0 * offset_sd[1990]
    assert offset_sd[5900] < 1.5 * offset_sd[1990]
    error = np.abs(played.mean - drive.truth)[2000:4000]
    assert (error < 4.5 * played.sd[2000:4000])[:, [0, 3]].all()
    # the step at the first picture is no larger than what the bridge lets through in one ms
    steps = np.abs(np.diff(played.column("sideslip_rad")))
    assert steps[3990:4100].max() < 2.0 * np.quantile(steps[500:1990], 0.999) + 1e-4


def test_a_perfect_picture_reconstructed_leaves_a_perfect_state_alone() -> None:
    """Without noise the picture carried to now says what the state says, whatever the delay."""
    scene = Scene(SPEED, 1.2, 0.1, 0.5, PATTERN_S, model_noise=False)
    quiet = MATCHED.model_copy(
        update={"gyro_sd_radps": 1e-9, "heading_sd_rad": 1e-9, "lateral_offset_sd_m": 1e-9}
    )
    drive = drive_with_camera(COMS, scene, quiet, np.random.default_rng(0))
    played = play(make_estimator("measurement_reconstruction", COMS, MATCHED), drive.log)
    np.testing.assert_allclose(played.mean, drive.truth, rtol=0, atol=1e-6)


def test_unknown_estimators_and_kinds() -> None:
    with pytest.raises(VehicleError, match="no estimator oracle"):
        make_estimator("oracle", COMS, EstimatorConfig())
    assert len(set(KINDS)) == len(KINDS)


@pytest.mark.slow
def test_gps_layers_beat_what_they_should() -> None:
    from polemap.electric.studies.papers import n13

    figures = n13(COMS, seeds=1, duration_s=8.0).figures
    assert figures["two_layer"] < 0.75
    assert figures["two_layer_reconstructed"] < 0.95
    assert figures["two_layer_ignored"] > 1.5
    assert figures["lateral_speed"] < 0.3


def test_two_layer_outlives_a_lost_gps() -> None:
    from polemap.electric.studies.scenes import GPS_NOISE

    scene = Scene(29 / 3.6, 8.0, 0.06, 0.2, (0.1,), 0.2, model_noise=False)
    drive = drive_with_gps(COMS, scene, GPS_NOISE, np.random.default_rng(2))
    columns = dict(drive.log.columns)
    silent = (drive.log.stamp_s > 3.0) & (drive.log.stamp_s < 6.0)
    columns["course_rad"] = np.where(silent, np.nan, columns["course_rad"])
    log = type(drive.log)(drive.log.stamp_s, columns)
    played = play(make_estimator("two_layer", COMS, GPS_NOISE), log)
    sd = played.sd_of("sideslip_rad")
    assert sd[5900] > 1.2 * sd[2900]
    assert sd[7900] < 1.2 * sd[2900]
    slip_steps = np.abs(np.diff(played.column("sideslip_rad")))
    assert slip_steps[5950:6400].max() < 2.0 * slip_steps[1500:2900].max() + 1e-4


def test_two_layer_starts_from_any_course_with_several_fixes_on_their_way() -> None:
    """The first course sets the heading; the captures already taken must follow it."""
    from polemap.electric.studies.scenes import GPS_NOISE

    config = GPS_NOISE.model_copy(update={"gps_slots": 3})
    scene = Scene(29 / 3.6, 3.0, 0.02, 0.2, (0.24,), 0.1, model_noise=False)
    drive = drive_with_gps(COMS, scene, config, np.random.default_rng(3))
    turned = {**drive.log.columns, "course_rad": drive.log.columns["course_rad"] + 1.5}
    log = type(drive.log)(drive.log.stamp_s, turned)
    for name in ("two_layer", "two_layer_reconstructed"):
        straight = play(make_estimator(name, COMS, config), drive.log, every=10)
        other = play(make_estimator(name, COMS, config), log, every=10)
        slip, same = other.column("sideslip_rad"), straight.column("sideslip_rad")
        np.testing.assert_allclose(slip, same, rtol=0, atol=1e-9)
        assert np.abs(slip - drive.truth[::10, 0])[50:].max() < 0.01
