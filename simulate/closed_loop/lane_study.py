"""The study W14-lane-change: body-slip control at 25 km/h, single-rate and multi-rate."""

from __future__ import annotations

from collections.abc import Callable
from math import pi

import numpy as np

from polemap.electric.control.body_slip import PiGains, feed_forward_gain, place_pi
from polemap.electric.estimators.base import CAMERA, GPS
from polemap.electric.studies.scenes import KMH
from polemap.electric.studies.study import Line, Panel, Report, Study, curves_of
from polemap.simulate.closed_loop.cars import plant_of
from polemap.simulate.closed_loop.choice import CAMERA_NOISE, NONE, TRUTH, behind, choose
from polemap.simulate.closed_loop.cornering import yaw_moment_limit_nm
from polemap.simulate.closed_loop.lateral import BodySlipLoop, LaneChange, LateralRun, run_lateral
from polemap.simulate.closed_loop.margins import FAST_S, SLOW_S, gains_for_margin
from polemap.simulate.closed_loop.sensing import SensorModel
from polemap.simulate.closed_loop.speeds import RANGES, Swing
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import KINEMATIC_SPEED_MPS, lateral

NAME = "W14-lane-change"
SPEED_MPS, DURATION_S = 25 * KMH, 6.0
STIFFER = 1.2
MARGIN_DB = 18.0
POLE_RADPS = 2.0 * pi
DEFAULT = (
    "bicycle",
    "single_rate",
    "clones",
    "compensated",
    "uneven_delay",
    "two_layer",
    "stiffness",
)


def speeding(stamp_s: float) -> float:
    """From 15 to 35 km/h in 5 s, 25 km/h in the middle of the lane change."""
    return (15.0 + 20.0 * min(max((stamp_s - 0.5) / 5.0, 0.0), 1.0)) * KMH


def run_lane(
    car: Car,
    name: str,
    gains: PiGains | None,
    seed: int,
    hold_s: float,
    driver: LaneChange,
    *,
    speed: float | Callable[[float], float] = SPEED_MPS,
    feed_forward: float | None = None,
) -> LateralRun:
    """One lane change behind an estimator, with no control where there are no gains.

    Args:
        speed: of the car, m/s, or that of each stamp.
        feed_forward: N m/rad at any speed; None schedules it.
    """
    estimator, late = behind(name, car, CAMERA_NOISE, (CAMERA, GPS))
    limit = yaw_moment_limit_nm(car)
    return run_lateral(
        plant_of(car.scaled(stiffness=STIFFER)),
        speed,
        speed.lasts_s if isinstance(speed, Swing) else DURATION_S,
        driver,
        None if gains is None else BodySlipLoop(car, gains, limit, feed_forward),
        rng=np.random.default_rng(seed),
        sensors=SensorModel(preview_m=car.preview_m),
        estimator=estimator,
        late=late,
        hold_s=hold_s,
    )


def lane_study(car: Car, seeds: int, report: Report, estimators: tuple[str, ...]) -> Study:
    """One sine of 0.1 rad in 2 s before a straight lane; real stiffness 1.2 times the nominal.

    Raises:
        ConfigError: an estimator without side-slip.
    """
    names = choose(NAME, estimators, DEFAULT, (CAMERA, GPS), "sideslip_rad")
    lane = _Lane(car, seeds, report)
    designed, slow, fast = _gains(lane)
    lane.note(NONE, NONE, None, 0.0, "0.03 rad (Fig. 10, car)")
    for name in (TRUTH, *names):
        lane.note(f"{name}, same gain, single rate", name, designed, SLOW_S)
        lane.note(f"{name}, same gain, multi-rate", name, designed, 0.0)
        claim = "tracks worse (Fig. 8)" if name == "single_rate" else ""
        lane.note(f"{name}, same margin, single rate", name, slow, SLOW_S, claim)
        claim = "tracks better" if name == "compensated" else ""
        lane.note(f"{name}, same margin, multi-rate", name, fast, 0.0, claim)
    fixed = lane.figures["feed_forward_nm_per_rad"]
    lane.note(f"15-35 km/h, {NONE}", NONE, None, 0.0, speed=speeding)
    for name in (TRUTH, names[-1]):
        for text, forward in (("scheduled", None), ("of 25 km/h", fixed)):
            label = f"15-35 km/h, {name}, feed-forward {text}"
            lane.note(label, name, designed, 0.0, speed=speeding, feed_forward=forward)
    for swing in RANGES:
        lane.driver = LaneChange(begin_s=0.25 * swing.lasts_s)
        lane.note(f"{swing}, {NONE}", NONE, None, 0.0, speed=swing)
        for name in (TRUTH, *names):
            lane.note(f"{swing}, {name}, single rate", name, designed, SLOW_S, speed=swing)
            lane.note(f"{swing}, {name}, multi-rate", name, designed, 0.0, speed=swing)
    limit_nm = yaw_moment_limit_nm(car)
    remarks = (
        "Columns: rms and largest side-slip; largest |Nz| "
        f"(limit {limit_nm:.1f} N m), share of time at it.",
        "Same gain: two closed-loop poles at -1 Hz. Same margin: gain raised until 18 dB are left "
        "with motors of 5 ms; W14 compares so. Less margin only drives the motors by noise.",
        "Single rate: controller and command once a camera frame, whatever the estimator; "
        "single_rate is W14's estimator, which itself stands still between pictures.",
        "At 10-20 and 0-30 km/h the speed goes up and down once in 16 s, the lane is changed while "
        "it rises; same gain, feed-forward scheduled, one drive each, scored from 1 m/s on.",
    )
    return Study(
        NAME,
        "Body-slip control in a lane change at 25 km/h",
        tuple(lane.lines),
        (),
        remarks,
        lane.figures,
        _panels(_shown(lane.curves), limit_nm),
        ("rms, peak", "moment", "the paper says"),
    )


class _Lane:
    """Lane changes, and the table, figures and curves that they fill."""

    def __init__(self, car: Car, seeds: int, report: Report) -> None:
        self.car, self.seeds, self.report = car, seeds, report
        self.driver = LaneChange()
        self.lines: list[Line] = []
        self.figures: dict[str, float] = {}
        self.curves: dict[str, LateralRun] = {}

    def note(
        self,
        label: str,
        name: str,
        gains: PiGains | None,
        hold_s: float,
        claim: str = "",
        *,
        speed: float | Callable[[float], float] = SPEED_MPS,
        feed_forward: float | None = None,
    ) -> None:
        """A row: a run a seed behind an estimator, one where the speed swings."""
        runs = [
            run_lane(self.car, name, gains, seed, hold_s, self.driver, speed=speed,
                     feed_forward=feed_forward)
            for seed in range(1 if isinstance(speed, Swing) else self.seeds)
        ]  # fmt: skip
        self.report(len(runs))
        key = label.replace(", ", "_").replace(" ", "_")
        least_mps = KINEMATIC_SPEED_MPS if isinstance(speed, Swing) else 0.0
        each = [r.error_rms_rad(self.driver.begin_s, least_mps) for r in runs]
        rms = float(np.mean(each))
        peak = float(np.max([r.peak_rad() for r in runs]))
        moment = float(np.max([r.moment_peak_nm() for r in runs]))
        share = float(np.mean([r.saturated.mean() for r in runs]))
        self.figures |= {
            f"{key}_rms_rad": rms,
            f"{key}_rms_sd_rad": float(np.std(each, ddof=1)) if len(each) > 1 else 0.0,
            f"{key}_peak_rad": peak,
            f"{key}_moment_nm": moment,
            f"{key}_saturated": share,
            f"{key}_rough_nm": float(np.mean([r.moment_step_nm() for r in runs])),
        }
        text = f"{1e3 * rms:.2f}, {1e3 * peak:.1f} mrad"
        self.lines.append(Line(label, text, f"{moment:.0f} N m, {100 * share:.1f} % sat.", claim))
        self.curves[label] = runs[0]


def _gains(lane: _Lane) -> tuple[PiGains, PiGains, PiGains]:
    """By pole placement, and raised until the margin is left: single rate and multi-rate."""
    car = lane.car
    a, b = lateral(car, SPEED_MPS)
    designed = place_pi(a, b, POLE_RADPS)
    lag = plant_of(car).torque_lag_s
    slow = gains_for_margin(car, SPEED_MPS, designed, SLOW_S, lag, MARGIN_DB)
    fast = gains_for_margin(car, SPEED_MPS, designed, FAST_S, lag, MARGIN_DB)
    lane.figures |= {
        "feed_forward_nm_per_rad": feed_forward_gain(a, b),
        "designed_nm_per_rad": designed.proportional_nm_per_rad,
        "single_nm_per_rad": slow.proportional_nm_per_rad,
        "multi_nm_per_rad": fast.proportional_nm_per_rad,
    }
    lane.lines += [
        Line("feed-forward, N m/rad", f"{feed_forward_gain(a, b):.0f}", "-2652", ""),
        Line(
            f"kp at {MARGIN_DB:.0f} dB, single / multi, N m/rad",
            f"{slow.proportional_nm_per_rad:.0f} / {fast.proportional_nm_per_rad:.0f}",
            "",
            "multi-rate allows more gain",
        ),
    ]
    return designed, slow, fast


def _shown(curves: dict[str, LateralRun]) -> dict[str, LateralRun]:
    """The runs of the picture: those that the paper compares, or all that are there."""
    wanted = (
        NONE,
        "single_rate, same margin, single rate",
        "compensated, same margin, multi-rate",
        "clones, same margin, multi-rate",
    )
    picked = {name: curves[name] for name in wanted if name in curves}
    if len(picked) < 3:
        picked = {NONE: curves[NONE]} | {n: r for n, r in curves.items() if "same margin" in n}
    return picked


def _panels(runs: dict[str, LateralRun], limit_nm: float) -> tuple[Panel, ...]:
    degrees = 180.0 / np.pi
    return (
        Panel("steering, degrees", curves_of(runs, "steer_rad", degrees)[:1]),
        Panel("side-slip, degrees", curves_of(runs, "sideslip_rad", degrees)),
        Panel("yaw moment, N m", curves_of(runs, "yaw_moment_nm"), (-limit_nm, limit_nm)),
    )
