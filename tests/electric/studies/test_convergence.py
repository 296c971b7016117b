"""Spectral radii and jumps of the compensated filter; the stiffness filter under a wrong model."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.electric.estimators.registry import make_estimator
from polemap.electric.signals import play
from polemap.electric.studies.convergence import frame_radii, update_jumps
from polemap.electric.studies.outcomes import outcome
from polemap.electric.studies.papers import STUDIES
from polemap.electric.studies.scenes import MISMATCH, Scene, drive_with_camera
from polemap.vehicle.io import load_car

COMS, SPEED = load_car("coms"), 25 / 3.6


@pytest.mark.parametrize("speed_kmh", [10.0, 25.0, 40.0])
def test_compensated_converges_like_the_ideal_filter(speed_kmh: float) -> None:
    radii = frame_radii(COMS, MISMATCH, speed_kmh / 3.6)
    assert radii["radius_compensated"] == pytest.approx(radii["radius_ideal"], abs=1e-4)
    assert radii["radius_ideal"] < 1.0
    assert radii["radius_switching"] < 1.0


def test_compensated_jumps_a_tenth_as_far() -> None:
    scene = Scene(SPEED, 4.0, 0.06, 0.5, model_noise=False)
    drive = drive_with_camera(COMS.scaled(stiffness=1.2), scene, MISMATCH, np.random.default_rng(3))
    jumps = update_jumps(COMS, MISMATCH, drive)
    assert jumps["jump_compensated_rad"] < 0.1 * jumps["jump_uncompensated_rad"]


def test_stiffness_filter_finds_the_scale() -> None:
    scene = Scene(SPEED, 8.0, 0.06, 0.5, model_noise=False)
    drive = drive_with_camera(COMS.scaled(stiffness=1.2), scene, MISMATCH, np.random.default_rng(7))
    played = play(make_estimator("stiffness", COMS, MISMATCH), drive.log, every=20)
    assert played.column("stiffness_scale")[200:].mean() == pytest.approx(1.2, abs=0.03)
    slip = outcome("stiffness", COMS, MISMATCH, [drive]).rmse_rad
    assert slip < 0.1 * outcome("bicycle", COMS, MISMATCH, [drive]).rmse_rad


def test_studies_are_listed_with_their_seeds() -> None:
    assert set(STUDIES) == {"W12", "W13", "W14", "N13"}
    assert all(seeds >= 10 for _, seeds in STUDIES.values())
