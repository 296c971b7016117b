"""Pictures that stay away and come back: no camera filter takes the return for a slide."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA
from polemap.electric.estimators.registry import ESTIMATORS, make_estimator
from polemap.electric.signals import SignalLog, play
from polemap.electric.studies.scenes import MATCHED, Scene, drive_with_camera
from polemap.vehicle.io import load_car

COMS = load_car("coms")
SEEING = [name for name, entry in ESTIMATORS.items() if CAMERA in entry.late]
CONFIG: EstimatorConfig = MATCHED.model_copy(update={"step_s": 0.005})
SPEED_MPS, FROM_S = 11.0, 3.0


def log_with_outage(outage_s: float) -> tuple[SignalLog, NDArray[np.float64]]:
    """A drive and its side-slip; without pictures a gyro offset leads the offset metres aside."""
    scene = Scene(SPEED_MPS, FROM_S + outage_s + 3.0, 0.02, 0.5, delays_s=(0.05,), period_s=0.06)
    driven = drive_with_camera(COMS, scene, CONFIG, np.random.default_rng(2))
    log = driven.log
    columns = dict(log.columns)
    away = (log.stamp_s > FROM_S) & (log.stamp_s < FROM_S + outage_s)
    for name in ("heading_rad", "lateral_offset_m", "camera_arrival_s"):
        if name in columns:
            columns[name] = np.where(away, np.nan, columns[name])
    columns["yaw_rate_radps"] = columns["yaw_rate_radps"] + 0.04
    return SignalLog(log.stamp_s, columns), driven.truth[:, 0]


@pytest.mark.parametrize("outage_s", [0.5, 8.0])
@pytest.mark.parametrize("name", SEEING)
def test_pictures_that_return_after_an_outage_move_no_filter_into_a_slide(
    name: str, outage_s: float
) -> None:
    log, truth = log_with_outage(outage_s)
    error = np.abs(play(make_estimator(name, COMS, CONFIG), log).column("sideslip_rad") - truth)
    before = error[(log.stamp_s > 2.0) & (log.stamp_s < FROM_S + outage_s)].max()
    after = error[log.stamp_s >= FROM_S + outage_s].max()
    assert after < before + 0.09
