"""From irradiance to a digital picture: exposure, lens, electrons, tone curve, quantisation."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import Image
from polemap.simulate.config import CameraConfig

Floats32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class CameraUnit:
    """One of the two cameras, as built: no two are alike."""

    gain: float
    offset: float
    vignette: Floats32
    pattern: Floats32


def make_units(config: CameraConfig, rng: np.random.Generator) -> tuple[CameraUnit, CameraUnit]:
    """Left and right camera of a drive; the right one differs in gain and black level."""
    shape = (config.height_px, config.width_px)
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    units = []
    for side in (0, 1):
        centre = (np.array(shape) - 1) / 2 + rng.normal(0, 0.02, 2) * shape
        radius = ((v - centre[0]) ** 2 + (u - centre[1]) ** 2) / (np.sum(np.square(shape)) / 4)
        pattern = 1 + config.fixed_pattern * rng.standard_normal(shape).astype(np.float32)
        units.append(
            CameraUnit(
                float(np.exp(side * config.right_gain_sd * rng.standard_normal())),
                float(side * config.right_offset_sd * rng.standard_normal()),
                (1 - config.vignetting * radius).astype(np.float32),
                pattern,
            )
        )
    return units[0], units[1]


def exposure_of(irradiance: Floats32, config: CameraConfig, wander: float) -> float:
    """Gain that brings the middle of the picture to the target level, off by what a control lags.

    `wander` is in log units. Only part of a change of light is followed, as in a real control.
    """
    middle = irradiance[irradiance.shape[0] // 4 :: 7, ::7]
    level = float(np.mean(np.minimum(middle, 1.5)))
    target = config.target_level ** (1.0 / config.tone_exponent)
    return float(target / max(level, 1e-3) * np.exp(wander))


def expose(
    irradiance: Floats32,
    gain: float,
    unit: CameraUnit,
    config: CameraConfig,
    rng: np.random.Generator,
) -> Image:
    """The picture `(height, width)`, uint8, or uint16 holding 12 bits."""
    opened = min(gain, config.largest_exposure)
    amplified = gain / opened
    signal = irradiance * np.float32(opened * unit.gain)
    signal *= unit.vignette
    if config.blur_px > 0:
        signal = np.asarray(cv2.GaussianBlur(signal, (0, 0), config.blur_px), dtype=np.float32)
    signal *= unit.pattern
    noise = rng.standard_normal(signal.shape, dtype=np.float32)
    electrons = np.maximum(signal, 0.0) * np.float32(config.full_well_e)
    noise *= np.sqrt(electrons + np.float32(config.read_noise_e**2))
    signal = (electrons + noise) * np.float32(amplified / config.full_well_e)
    signal += np.float32(unit.offset)
    np.clip(signal, 0.0, 1.0, out=signal)
    if config.tone_exponent != 1.0:
        cv2.pow(signal, config.tone_exponent, dst=signal)
    top = (1 << config.bits) - 1
    levels = np.asarray(np.rint(signal * np.float32(top)), dtype=np.float32)
    return levels.astype(np.uint8) if config.bits == 8 else levels.astype(np.uint16)
