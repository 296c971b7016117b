"""Units and signs of a signal log, told from what its signals say of one motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from polemap.electric.plausibility import check_log
from polemap.electric.signals import SignalLog
from polemap.vehicle.io import load_car
from tests.electric.made_log import made_log

CAR = load_car("rav4")
Change = Callable[[np.ndarray], np.ndarray]

# column, what is done to it, the finding's kind and stream
MISTAKES: dict[str, tuple[str, Change, str, str]] = {
    "ay in g": ("ay_mps2", lambda x: x / 9.81, "signal_unit", "ay_mps2"),
    "ay to the right": ("ay_mps2", lambda x: -x, "signal_sign", "ay_mps2"),
    "yaw rate in degrees": ("yaw_rate_radps", np.degrees, "signal_range", "yaw_rate_radps"),
    "yaw rate clockwise": ("yaw_rate_radps", lambda x: -x, "signal_sign", "yaw_rate_radps"),
    "steering wheel": ("road_wheel_angle_rad", lambda x: 15.0 * x, "signal_unit",
                       "road_wheel_angle_rad"),
    "steering in degrees": ("road_wheel_angle_rad", np.degrees, "signal_range",
                            "road_wheel_angle_rad"),
    "steering to the right": ("road_wheel_angle_rad", lambda x: -x, "signal_sign",
                              "road_wheel_angle_rad"),
    "speed in km/h": ("vx_mps", lambda x: 3.6 * x, "signal_unit", "vx_mps"),
    "ax in g": ("ax_mps2", lambda x: x / 9.81, "signal_unit", "ax_mps2"),
    "ax backward": ("ax_mps2", lambda x: -x, "signal_sign", "ax_mps2"),
    "course clockwise": ("course_rad", lambda x: -x, "signal_sign", "course_rad"),
    "course in degrees": ("course_rad", np.degrees, "signal_unit", "course_rad"),
    "slip in degrees": ("sideslip_rad", np.degrees, "signal_unit", "sideslip_rad"),
    "slip to the right": ("sideslip_rad", lambda x: -x, "signal_sign", "sideslip_rad"),
}  # fmt: skip


def test_a_clean_log_is_left_alone() -> None:
    assert check_log(made_log(CAR), CAR) == []


@pytest.mark.parametrize("name", list(MISTAKES))
def test_a_mistake_is_noticed_and_its_signal_named(name: str) -> None:
    column, change, kind, stream = MISTAKES[name]
    log = made_log(CAR)
    wrong = SignalLog(log.stamp_s, {**log.columns, column: change(log.columns[column])})
    findings = check_log(wrong, CAR)
    assert (kind, stream) in {(f.kind, f.stream) for f in findings}, [f.line() for f in findings]


def test_stamps_in_milliseconds_and_gaps_are_found() -> None:
    log = made_log(CAR, 10.0)
    slow = SignalLog(log.stamp_s * 1e3, log.columns)
    assert "stamp_unit" in {f.kind for f in check_log(slow, CAR)}
    keep = (log.stamp_s < 8.0) | (log.stamp_s > 10.0)
    gapped = SignalLog(log.stamp_s[keep], {k: v[keep] for k, v in log.columns.items()})
    assert [f.kind for f in check_log(gapped, CAR)] == ["gap"]


def arriving(later_s: float) -> SignalLog:
    log = made_log(CAR)
    arrival = np.where(np.isfinite(log.columns["course_rad"]), log.stamp_s + later_s, np.nan)
    return SignalLog(log.stamp_s, {**log.columns, "gnss_arrival_s": arrival})


def test_arrivals_of_another_clock_are_told() -> None:
    """Before their stamps, or later than any receiver is: both were heard without a word."""
    assert check_log(arriving(0.1), CAR) == []
    for later_s, said in ((-1.7e9, "arrive before their stamps"), (30.0, "arrive 30 s after")):
        (finding,) = check_log(arriving(later_s), CAR)
        assert (finding.kind, finding.severity) == ("arrival", "warning")
        assert finding.stream == "gnss_arrival_s"
        assert said in finding.value
