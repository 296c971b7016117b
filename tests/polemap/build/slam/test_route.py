"""Routes as they enter the graph."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.build.slam.constants import CAMERA_CALIBRATION_SD
from polemap.build.slam.motion import CALIBRATION, MotionNoise
from polemap.build.slam.route import open_route
from tests.polemap.build.slam.loops import beside, block, simulated, solve

pytest.importorskip("gtsam")


def test_a_cameras_odometry_is_known_better_than_wheels() -> None:
    rng = np.random.default_rng(5)
    poses = block(1.3)[:250]
    drive = simulated(poses, beside(poses, 8.0, rng), rng).drive
    camera = replace(drive, odometry_is_cameras=True)
    scales = []
    for one in (drive, camera):
        route = open_route("d", one, one.frame, np.zeros(2), MotionNoise())
        known, information = route.calibration_knowledge()
        assert not known.any()
        sds = 1.0 / np.sqrt(np.maximum(np.diagonal(information[0]), 1e-30))
        expected = len(CALIBRATION) * [1e15]
        if one is camera:
            expected[:4] = CAMERA_CALIBRATION_SD
        assert sds == pytest.approx(expected)
        scales.append(abs(solve(one).summary.drives[0].calibration["speed_scale"]))
    # the same odometry, called a camera's, is believed more
    assert scales[1] < scales[0]
