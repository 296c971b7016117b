"""Gaps of a log: a new estimator after each, and rows that stand alone say nothing."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.gaps import find_gaps, play_parts, settled
from polemap.electric.signals import SignalLog
from polemap.vehicle.io import load_car
from tests.electric.made_log import made_log


def _without(log: SignalLog, start_s: float, end_s: float) -> SignalLog:
    keep = (log.stamp_s < start_s) | (log.stamp_s >= end_s)
    return SignalLog(log.stamp_s[keep], {k: v[keep] for k, v in log.columns.items()})


@pytest.mark.parametrize("name", ["linear_observer", "bicycle"])
@pytest.mark.parametrize("length_s", [1.0, 10.0])
def test_an_estimate_stays_sane_over_a_gap(name: str, length_s: float) -> None:
    car = load_car("rav4")
    log = _without(made_log(car, 40.0), 12.0, 12.0 + length_s)
    (gap,) = find_gaps(log)
    assert gap.length_s == pytest.approx(length_s, abs=0.011)
    config = EstimatorConfig(step_s=0.01)
    played, _ = play_parts(lambda: make_estimator(name, car, config), log)
    slip = played.column("sideslip_rad")
    assert len(slip) == len(log)
    assert np.isfinite(slip).all()
    assert np.abs(slip).max() < 0.1


def test_a_log_without_gaps_has_none_and_a_lone_row_is_not_estimated() -> None:
    car = load_car("rav4")
    log = made_log(car, 10.0)
    assert find_gaps(log) == []
    lone = _without(_without(log, 8.0, 10.0), 10.01, 12.0)
    assert len(find_gaps(lone)) == 2
    config = EstimatorConfig(step_s=0.01)
    played, _ = play_parts(lambda: make_estimator("bicycle", car, config), lone)
    assert np.isnan(played.column("sideslip_rad")).sum() == 1


def test_rows_settle_after_the_start_and_after_every_gap() -> None:
    stamps = np.array([0.0, 1.0, 2.0, 3.0, 10.0, 11.0, 12.0, 13.0])
    log = SignalLog(stamps, {})
    gaps = find_gaps(SignalLog(np.concatenate([np.arange(0, 3, 0.01), [10.0, 10.01]]), {}))
    assert settled(log.stamp_s, gaps, 2.0).tolist() == [
        False, False, True, True, False, False, True, True,
    ]  # fmt: skip
