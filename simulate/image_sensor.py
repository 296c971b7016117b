"""From irradiance to a digital picture: exposure, lens, electrons, tone curve, quantisation."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import Image
from polemap.simulate.camera_mounting import CameraConfig

Floats32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class ImageSensor:
    """How the pictures of an industrial grey camera look; chosen so that a matcher finds them as
    hard as real ones (`benchmarks.simulate.realism`).

    Attributes:
        tone_exponent: of the tone curve, 1 for a linear sensor.
        target_level: grey level, of 1, to which the exposure control brings a picture's middle.
        full_well_e: electrons at the white level; they set the shot noise.
        read_noise_e: sd, electrons.
        fixed_pattern: sd of the pixels' gains.
        blur_px: sd of the lens.
        vignetting: loss of light in the corners.
        right_gain_sd, right_offset_sd: what the right camera differs by.
        largest_exposure: light that it cannot gather is made up by gain, noise included.
        exposure_wander: sd, in log units, of what the exposure control lags behind.
    """

    tone_exponent: float = 0.9
    target_level: float = 0.36
    full_well_e: float = 8000.0
    read_noise_e: float = 9.0
    fixed_pattern: float = 0.006
    blur_px: float = 0.55
    vignetting: float = 0.18
    right_gain_sd: float = 0.06
    right_offset_sd: float = 0.006
    largest_exposure: float = 6.0
    exposure_wander: float = 0.12


SENSOR = ImageSensor()


@dataclass(frozen=True, slots=True)
class CameraUnit:
    """One of the two cameras, as built: no two are alike."""

    gain: float
    offset: float
    vignette: Floats32
    pattern: Floats32


def make_units(
    config: CameraConfig, rng: np.random.Generator, sensor: ImageSensor = SENSOR
) -> tuple[CameraUnit, CameraUnit]:
    """Left and right camera of a drive; the right one differs in gain and black level."""
    shape = (config.height_px, config.width_px)
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    units = []
    for side in (0, 1):
        centre = (np.array(shape) - 1) / 2 + rng.normal(0, 0.02, 2) * shape
        radius = ((v - centre[0]) ** 2 + (u - centre[1]) ** 2) / (np.sum(np.square(shape)) / 4)
        pattern = 1 + sensor.fixed_pattern * rng.standard_normal(shape).astype(np.float32)
        units.append(
            CameraUnit(
                float(np.exp(side * sensor.right_gain_sd * rng.standard_normal())),
                float(side * sensor.right_offset_sd * rng.standard_normal()),
                (1 - sensor.vignetting * radius).astype(np.float32),
                pattern,
            )
        )
    return units[0], units[1]


def exposure_of(irradiance: Floats32, wander: float, sensor: ImageSensor = SENSOR) -> float:
    """Gain that brings the middle of the picture to the target level, off by what a control lags.

    `wander` is in log units. Only part of a change of light is followed, as in a real control.
    """
    middle = irradiance[irradiance.shape[0] // 4 :: 7, ::7]
    level = float(np.mean(np.minimum(middle, 1.5)))
    target = sensor.target_level ** (1.0 / sensor.tone_exponent)
    return float(target / max(level, 1e-3) * np.exp(wander))


def expose(
    irradiance: Floats32,
    gain: float,
    unit: CameraUnit,
    bits: int,
    rng: np.random.Generator,
    sensor: ImageSensor = SENSOR,
) -> Image:
    """The picture `(height, width)`, uint8, or uint16 holding 12 bits."""
    opened = min(gain, sensor.largest_exposure)
    amplified = gain / opened
    signal = irradiance * np.float32(opened * unit.gain)
    signal *= unit.vignette
    if sensor.blur_px > 0:
        signal = np.asarray(cv2.GaussianBlur(signal, (0, 0), sensor.blur_px), dtype=np.float32)
    signal *= unit.pattern
    noise = rng.standard_normal(signal.shape, dtype=np.float32)
    electrons = np.maximum(signal, 0.0) * np.float32(sensor.full_well_e)
    noise *= np.sqrt(electrons + np.float32(sensor.read_noise_e**2))
    signal = (electrons + noise) * np.float32(amplified / sensor.full_well_e)
    signal += np.float32(unit.offset)
    np.clip(signal, 0.0, 1.0, out=signal)
    if sensor.tone_exponent != 1.0:
        cv2.pow(signal, sensor.tone_exponent, dst=signal)
    top = (1 << bits) - 1
    levels = np.asarray(np.rint(signal * np.float32(top)), dtype=np.float32)
    return levels.astype(np.uint8) if bits == 8 else levels.astype(np.uint16)
