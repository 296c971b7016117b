"""The camera: noise as stated, gains as built, bits as asked."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.simulate.camera import CameraUnit, expose, exposure_of, make_units
from polemap.simulate.config import CameraConfig

FLAT = {"blur_px": 0.0, "vignetting": 0.0, "fixed_pattern": 0.0, "tone_exponent": 1.0}
SHAPE = (200, 300)


def unit(gain: float = 1.0) -> CameraUnit:
    return CameraUnit(gain, 0.0, np.ones(SHAPE, np.float32), np.ones(SHAPE, np.float32))


@pytest.mark.parametrize("level", [0.05, 0.3, 0.7])
def test_noise_is_shot_and_read_noise(level: float) -> None:
    config = CameraConfig(bits=12, width_px=SHAPE[1], height_px=SHAPE[0], **FLAT)
    image = expose(
        np.full(SHAPE, level, np.float32), 1.0, unit(), config, np.random.default_rng(1)
    ).astype(float)
    full = config.full_well_e
    expected = np.sqrt(level * full + config.read_noise_e**2) / full * 4095
    count = image.size
    assert image.mean() == pytest.approx(level * 4095, abs=4 * expected / np.sqrt(count) + 0.5)
    assert image.std() == pytest.approx(expected, rel=4 / np.sqrt(2 * count) + 0.02)


def test_gain_beyond_the_longest_exposure_brings_noise() -> None:
    config = CameraConfig(bits=12, width_px=SHAPE[1], height_px=SHAPE[0], **FLAT)
    bright = expose(np.full(SHAPE, 0.3, np.float32), 1.0, unit(), config, np.random.default_rng(1))
    dim = expose(np.full(SHAPE, 0.005, np.float32), 60.0, unit(), config, np.random.default_rng(1))
    assert dim.mean() == pytest.approx(bright.mean(), rel=0.02)
    assert dim.std() > 2.5 * bright.std()


def test_eight_and_twelve_bits_and_white() -> None:
    for bits, kind in ((8, np.uint8), (12, np.uint16)):
        config = CameraConfig(bits=bits, width_px=SHAPE[1], height_px=SHAPE[0])
        image = expose(
            np.full(SHAPE, 9.0, np.float32), 1.0, unit(), config, np.random.default_rng()
        )
        assert image.dtype == kind
        assert image.min() == image.max() == (1 << bits) - 1


def test_the_cameras_differ_in_gain() -> None:
    config = CameraConfig(width_px=40, height_px=32, right_gain_sd=0.1)
    gains = [make_units(config, np.random.default_rng(seed))[1].gain for seed in range(300)]
    assert np.log(gains).std() == pytest.approx(0.1, rel=4 / np.sqrt(600))
    assert make_units(config, np.random.default_rng(0))[0].gain == 1.0


def test_exposure_brings_the_scene_to_the_target() -> None:
    config = CameraConfig(width_px=SHAPE[1], height_px=SHAPE[0], **FLAT)
    for light in (0.02, 0.2, 0.9):
        scene = np.full(SHAPE, light, np.float32)
        assert light * exposure_of(scene, config, 0.0) == pytest.approx(config.target_level)
    assert exposure_of(scene, config, 0.3) > exposure_of(scene, config, 0.0)


def test_a_preset_gives_what_is_not_said() -> None:
    paper = CameraConfig()
    kitti = CameraConfig.model_validate({"preset": "kitti", "baseline_m": 0.6})
    assert (paper.rig().width_px, paper.rig().baseline_m) == (768, 0.3)
    assert (kitti.rig().width_px, kitti.rig().focal_px) == (1241, 718.856)
    assert kitti.rig().baseline_m == 0.6
    assert kitti.read_noise_e == paper.read_noise_e
    assert CameraConfig.model_validate(kitti.model_dump()) == kitti
