"""Logs whose rows were repeated and counted as time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from polemap.electric.clock_rate import stretched_clock
from polemap.electric.plausibility import check_log
from polemap.electric.signals import SignalLog
from polemap.tools.cli import run
from polemap.vehicle.io import dump_car, load_car
from tests.electric.driven import STEP_S, driven

CAR = load_car("passat")


def stretched(log: SignalLog, times: int, *, cut: int = 0) -> SignalLog:
    """Every row `times` times, at the log's own step; the first `cut` rows gone."""
    columns = {name: np.repeat(values, times)[cut:] for name, values in log.columns.items()}
    return SignalLog(STEP_S * np.arange(times * len(log))[cut:], columns)


@pytest.mark.parametrize(("times", "cut"), [(2, 0), (5, 0), (5, 3), (20, 7)])
def test_stretched_time_is_found_and_taken_back(times: int, cut: int) -> None:
    log = driven(CAR, 25.0)
    clock = stretched_clock(stretched(log, times, cut=cut))
    assert clock is not None
    assert clock.times == times
    assert clock.ratio == pytest.approx(1.0 / times, rel=0.1)
    back = clock.real_time(stretched(log, times, cut=cut))
    assert len(back) == len(log)
    np.testing.assert_array_equal(back.columns["ay_mps2"], log.columns["ay_mps2"])
    steps = np.diff(back.stamp_s)[1:]
    np.testing.assert_allclose(steps, STEP_S, rtol=1e-6)
    found = [f for f in check_log(stretched(log, times, cut=cut), CAR) if f.kind == "clock_rate"]
    assert len(found) == 1
    assert f"{times} times" in found[0].remedy


def test_held_values_on_a_true_clock_are_left_alone() -> None:
    log = driven(CAR, 25.0)
    held = SignalLog(log.stamp_s, {n: np.repeat(v[::5], 5) for n, v in log.columns.items()})
    assert stretched_clock(held) is None
    assert stretched_clock(log) is None


def test_a_course_that_turns_with_the_stamps_denies_it() -> None:
    log = stretched(driven(CAR, 25.0), 5)
    turned = np.cumsum(log.columns["yaw_rate_radps"]) * STEP_S
    course = np.full(len(log), np.nan)
    course[::20] = turned[::20]
    columns = {
        **log.columns,
        "course_rad": course,
        "speed_mps": np.where(course == course, 20.0, np.nan),
    }
    assert stretched_clock(SignalLog(log.stamp_s, columns)) is None


def test_the_command_estimates_in_real_time_at_the_logs_own_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "car.yaml").write_text(dump_car(CAR))
    log = driven(CAR, 12.0)
    said = {}
    for name, what in (("plain", log), ("slow", stretched(log, 5))):
        pd.DataFrame({"stamp_s": what.stamp_s, **what.columns}).to_csv(tmp_path / f"{name}.csv")
        call = ["estimate", str(tmp_path / f"{name}.csv"), "--estimator", "nonlinear"]
        out = tmp_path / f"{name}_out.csv"
        assert run([*call, "--vehicle", str(tmp_path / "car.yaml"), "--out", str(out)]) == 0
        told = capsys.readouterr()
        said[name] = (pd.read_csv(out), json.loads(told.out), told.err)
    plain, slow = said["plain"][0], said["slow"][0]
    assert len(slow) == 5 * len(plain)
    np.testing.assert_allclose(slow.sideslip_rad[::5], plain.sideslip_rad, atol=1e-6)
    assert "5 times as fast" in said["slow"][2]
    assert "times as fast" not in said["plain"][2]
