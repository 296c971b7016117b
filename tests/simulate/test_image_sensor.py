"""The camera: noise as stated, gains as built, bits as asked."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.simulate.camera_mounting import CameraConfig
from polemap.simulate.image_sensor import CameraUnit, ImageSensor, expose, exposure_of, make_units

FLAT = ImageSensor(blur_px=0.0, vignetting=0.0, fixed_pattern=0.0, tone_exponent=1.0)
SHAPE = (200, 300)


def unit(gain: float = 1.0) -> CameraUnit:
    return CameraUnit(gain, 0.0, np.ones(SHAPE, np.float32), np.ones(SHAPE, np.float32))


@pytest.mark.parametrize("level", [0.05, 0.3, 0.7])
def test_noise_is_shot_and_read_noise(level: float) -> None:
    image = expose(
        np.full(SHAPE, level, np.float32), 1.0, unit(), 12, np.random.default_rng(1), FLAT
    ).astype(float)
    full = FLAT.full_well_e
    expected = np.sqrt(level * full + FLAT.read_noise_e**2) / full * 4095
    count = image.size
    assert image.mean() == pytest.approx(level * 4095, abs=4 * expected / np.sqrt(count) + 0.5)
    assert image.std() == pytest.approx(expected, rel=4 / np.sqrt(2 * count) + 0.02)


def test_gain_beyond_the_longest_exposure_brings_noise() -> None:
    bright, dim = (
        expose(np.full(SHAPE, level, np.float32), gain, unit(), 12, np.random.default_rng(1), FLAT)
        for level, gain in ((0.3, 1.0), (0.005, 60.0))
    )
    assert dim.mean() == pytest.approx(bright.mean(), rel=0.02)
    assert dim.std() > 2.5 * bright.std()


def test_eight_and_twelve_bits_and_white() -> None:
    for bits, kind in ((8, np.uint8), (12, np.uint16)):
        image = expose(np.full(SHAPE, 9.0, np.float32), 1.0, unit(), bits, np.random.default_rng())
        assert image.dtype == kind
        assert image.min() == image.max() == (1 << bits) - 1


def test_the_cameras_differ_in_gain() -> None:
    config, sensor = CameraConfig(width_px=40, height_px=32), ImageSensor(right_gain_sd=0.1)
    gains = [make_units(config, np.random.default_rng(n), sensor)[1].gain for n in range(300)]
    assert np.log(gains).std() == pytest.approx(0.1, rel=4 / np.sqrt(600))
    assert make_units(config, np.random.default_rng(0))[0].gain == 1.0


def test_exposure_brings_the_scene_to_the_target() -> None:
    for light in (0.02, 0.2, 0.9):
        scene = np.full(SHAPE, light, np.float32)
        assert light * exposure_of(scene, 0.0, FLAT) == pytest.approx(FLAT.target_level)
    assert exposure_of(scene, 0.3) > exposure_of(scene, 0.0)


def test_a_preset_gives_what_is_not_said() -> None:
    paper = CameraConfig()
    kitti = CameraConfig.model_validate({"preset": "kitti", "baseline_m": 0.6})
    assert (paper.rig().width_px, paper.rig().baseline_m) == (768, 0.3)
    assert (kitti.rig().width_px, kitti.rig().focal_px) == (1241, 718.856)
    assert kitti.rig().baseline_m == 0.6
    assert kitti.calibration_error_deg == paper.calibration_error_deg
    assert CameraConfig.model_validate(kitti.model_dump()) == kitti
