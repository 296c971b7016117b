"""A watched estimator says the same, and its record is right: innovations and refused values."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.electric.fault_drives import driven
from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA, Estimate, Inputs, Value
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.signals import play
from polemap.electric.studies.scenes import MATCHED, Scene, drive_with_camera
from polemap.electric.watched import Record, Watched
from polemap.vehicle.io import load_car

CAR = load_car("coms")


@pytest.mark.parametrize("name", ["clones", "bicycle", "compensated"])
def test_watching_changes_nothing(name: str) -> None:
    log = drive_with_camera(CAR, Scene(7.0, 2.0), MATCHED, np.random.default_rng(0)).log
    plain = play(make_estimator(name, CAR, MATCHED), log)
    record = Record()
    watched = play(Watched(make_estimator(name, CAR, MATCHED), MATCHED, record, 3), log)
    assert (watched.mean == plain.mean).all()
    assert (watched.sd == plain.sd).all()
    assert "yaw_rate_radps" in record.innovations


def test_innovations_of_an_exact_filter_have_unit_variance() -> None:
    """Late pictures too: compared with what was held at the capture, not now."""
    drive = drive_with_camera(CAR, Scene(7.0, 20.0), MATCHED, np.random.default_rng(1))
    record = Record()
    play(Watched(make_estimator("clones", CAR, MATCHED), MATCHED, record), drive.log)
    for name in ("yaw_rate_radps", "heading_rad", "lateral_offset_m"):
        stamps, off = record.innovations[name].normalised()
        late = off[stamps > 2.0]
        # of n independent ones the variance errs by sqrt(2 / n); four of these
        assert np.mean(late**2) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / len(late)))
    assert record.faults == []


class Refusing:
    """Refuses pictures between 1 and 2 s, and one at 4 s."""

    fields = ("heading_rad", "lateral_offset_m")

    def __init__(self) -> None:
        self.dropped: dict[str, int] = {}
        self.gate = "mine"

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        pass

    def capture(self, kind: str, stamp_s: float) -> None:
        pass

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if 1.0 <= stamp_s < 2.0 or stamp_s == 4.0:
            self.dropped["wild"] = self.dropped.get("wild", 0) + 1

    def estimate(self) -> Estimate:
        return Estimate(0.0, self.fields, np.zeros(2), np.ones(2))

    def covariance(self) -> np.ndarray:
        return np.eye(2)


def test_refused_values_in_a_row_are_one_fault() -> None:
    record = Record()
    watched = Watched(Refusing(), EstimatorConfig(), record)
    for k in range(60):
        stamp = k / 10
        watched.step(stamp, Inputs(0.0, 5.0))
        watched.capture(CAMERA, stamp)
        watched.measure(CAMERA, (6.3, 0.1), stamp, stamp)
    found = [(f.sensor, f.what, f.from_s, f.to_s, f.count) for f in record.faults]
    assert found == [("camera", "wild", 1.0, 1.9, 10), ("camera", "wild", 4.0, 4.0, 1)]
    assert watched.gate == "mine"
    assert abs(record.innovations["heading_rad"].value[0]) < 0.02  # a turn less
    assert watched.covariance().shape == (2, 2)


@pytest.mark.parametrize(
    ("name", "signals"),
    [
        ("nonlinear", {"yaw_rate_radps", "course_rad"}),
        ("clones", {"yaw_rate_radps", "heading_rad", "lateral_offset_m"}),
    ],
)
def test_only_what_tells_the_same_is_compared(name: str, signals: set[str]) -> None:
    """A log has camera and GPS: a heading in the lane is none from which a course is counted."""
    log = driven(load_car("passat"), "country", 4.0, seed=3).log
    record, config = Record(), EstimatorConfig(step_s=0.01)
    play(Watched(make_estimator(name, load_car("passat"), config), config, record), log)
    assert set(record.innovations) == signals
