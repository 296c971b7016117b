"""The study W13-lane-keeping: motion and position in one loop at 25 km/h, single and multi-rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polemap.electric.control.lane_keeping import LaneKeeper, LaneWeights
from polemap.electric.control.lateral_stability import LateralLimits
from polemap.electric.estimators.base import CAMERA, Estimate
from polemap.electric.studies.scenes import KMH
from polemap.electric.studies.study import Curve, Line, Panel, Report, Study, curves_of
from polemap.simulate.closed_loop.cars import plant_of
from polemap.simulate.closed_loop.choice import CAMERA_NOISE, TRUTH, behind, choose
from polemap.simulate.closed_loop.cornering import yaw_moment_limit_nm
from polemap.simulate.closed_loop.lateral import Command, LateralRun, run_lateral
from polemap.simulate.closed_loop.margins import FAST_S, SLOW_S
from polemap.simulate.closed_loop.sensing import Measured, SensorModel
from polemap.simulate.closed_loop.speeds import RANGES, Swing
from polemap.vehicle.parameters import Car

NAME = "W13-lane-keeping"
SPEED_MPS, DURATION_S = 25 * KMH, 8.0
STIFFER = 1.2
BOTH = LaneWeights()
STEERING = LaneWeights(yaw_moment_nm=0.0)
DEFAULT = ("single_rate", "multi_rate", "clones", "uneven_delay", "compensated")
STATES = ("sideslip_rad", "yaw_rate_radps", "heading_rad", "lateral_offset_m")


@dataclass(frozen=True, slots=True)
class LaneShift:
    """From the middle of the lane to `aside_m` beside it, without a jump of speed or acceleration.

    A quintic in time, which is the smoothest between two places at rest.
    """

    aside_m: float = 1.0
    begin_s: float = 2.0
    lasts_s: float = 3.0

    def __call__(self, stamp_s: float) -> tuple[float, float]:
        """Offset that is wanted, m, and its rate, m/s."""
        s = min(max((stamp_s - self.begin_s) / self.lasts_s, 0.0), 1.0)
        offset = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        rate = 30.0 * s * s * (1.0 - s) ** 2 / self.lasts_s
        return self.aside_m * offset, self.aside_m * rate


class LaneKeepingLoop:
    """`LaneKeeper` on an estimate, along a shift; the driver's steering is not heard."""

    def __init__(self, keeper: LaneKeeper, shift: LaneShift) -> None:
        self._keeper, self._shift = keeper, shift

    def __call__(
        self, driver_rad: float, seen: Estimate, measured: Measured, dt_s: float
    ) -> Command:
        offset, rate = self._shift(seen.stamp_s)
        state = np.array([seen.value(name) for name in STATES])
        done = self._keeper.step(state, measured.speed_mps, offset, rate)
        return Command(
            done.steer_rad, done.yaw_moment_nm, done.saturated, offset_reference_m=offset
        )


def run_keeping(
    car: Car,
    name: str,
    weights: LaneWeights,
    seed: int,
    hold_s: float,
    shift: LaneShift,
    speed: float | Swing = SPEED_MPS,
) -> LateralRun:
    """One shift behind an estimator; above 0 `hold_s` is the period of controller and command."""
    estimator, late = behind(name, car, CAMERA_NOISE, (CAMERA,))
    limits = LateralLimits(yaw_moment_nm=yaw_moment_limit_nm(car))
    keeper = LaneKeeper(car, weights, limits, hold_s or FAST_S)
    return run_lateral(
        plant_of(car.scaled(stiffness=STIFFER)),
        speed,
        speed.lasts_s if isinstance(speed, Swing) else DURATION_S,
        lambda _stamp_s: 0.0,
        LaneKeepingLoop(keeper, shift),
        rng=np.random.default_rng(seed),
        sensors=SensorModel(preview_m=car.preview_m),
        estimator=estimator,
        late=late,
        hold_s=hold_s,
    )


def lane_keeping_study(car: Car, seeds: int, report: Report, estimators: tuple[str, ...]) -> Study:
    """One metre aside in 3 s along a straight lane; real stiffness 1.2 times the nominal.

    Raises:
        ConfigError: an estimator without an offset in the lane.
    """
    names = choose(NAME, estimators, DEFAULT, (CAMERA,), "lateral_offset_m")
    shift = LaneShift()
    lines: list[Line] = []
    figures: dict[str, float] = {}
    curves: dict[str, LateralRun] = {}
    for name in (TRUTH, *names):
        for what, weights in (("steering", STEERING), ("steering and moment", BOTH)):
            for rate, hold_s in (("single rate", SLOW_S), ("multi-rate", 0.0)):
                runs = [
                    run_keeping(car, name, weights, seed, hold_s, shift) for seed in range(seeds)
                ]
                report(seeds)
                label = f"{name}, {what}, {rate}"
                line, found = _row(label, runs, shift)
                lines.append(line)
                figures |= found
                curves[label] = runs[0]
    for swing in RANGES:
        # the lane is changed while the speed rises
        for name in (TRUTH, *names):
            for rate, hold_s in (("single rate", SLOW_S), ("multi-rate", 0.0)):
                run = run_keeping(car, name, BOTH, 0, hold_s, shift, swing)
                report(1)
                line, found = _row(f"{swing}, {name}, {rate}", [run], shift)
                lines.append(line)
                figures |= found
    shown = {
        f"{name}, {rate}": curves[f"{name}, steering and moment, {rate}"]
        for name, rate in ((TRUTH, "multi-rate"), (names[0], "single rate"),
                           (names[-1], "multi-rate"))
    }  # fmt: skip
    remarks = (
        "Columns: rms and largest error of y_l against where it is wanted; rms of the side-slip "
        "and largest |Nz|; W13 names integrated motion and position control and prints none.",
        "Single rate: controller and command once a camera frame, gains for that period; "
        "multi-rate: every millisecond.",
        "At 10-20 and 0-30 km/h the speed goes up and down once in 16 s: steering and moment, one "
        "drive each, scored to the end; the gains follow the speed.",
    )
    return Study(
        NAME,
        "Lane keeping on y_l with the side-slip by yaw moment, 25 km/h",
        tuple(lines),
        (),
        remarks,
        figures,
        _panels(shown),
        ("y_l error rms, peak", "side-slip, moment", "the paper says"),
    )


def _row(label: str, runs: list[LateralRun], shift: LaneShift) -> tuple[Line, dict[str, float]]:
    errors = [r.offset_error_m(shift.begin_s) for r in runs]
    rms = float(np.mean([np.sqrt(np.mean(e**2)) for e in errors]))
    peak = float(max(np.abs(e).max() for e in errors))
    slip = float(np.mean([r.error_rms_rad(shift.begin_s) for r in runs]))
    moment = float(max(r.moment_peak_nm() for r in runs))
    rough = float(np.mean([np.sqrt(np.mean(np.diff(r.steer_rad) ** 2)) for r in runs]))
    key = label.replace(", ", "_").replace(" ", "_")
    claim = "one rate for motion and position (1)" if "compensated" in label else ""
    return (
        Line(
            label,
            f"{1e3 * rms:.1f}, {1e3 * peak:.0f} mm",
            f"{1e3 * slip:.2f} mrad, {moment:.0f} N m",
            claim,
        ),
        {
            f"{key}_offset_rms_m": rms,
            f"{key}_offset_peak_m": peak,
            f"{key}_sideslip_rms_rad": slip,
            f"{key}_moment_nm": moment,
            f"{key}_steering_step_rad": rough,
        },
    )


def _panels(runs: dict[str, LateralRun]) -> tuple[Panel, ...]:
    degrees = 180.0 / np.pi
    wanted = curves_of({"wanted": next(iter(runs.values()))}, "offset_reference_m")
    errors = tuple(
        Curve(name, run.stamp_s, 1e3 * (run.offset_m - run.offset_reference_m))
        for name, run in runs.items()
    )
    return (
        Panel("offset at the preview point, m", (*wanted, *curves_of(runs, "offset_m"))),
        Panel("offset error, mm", errors, (0.0,)),
        Panel("side-slip, degrees", curves_of(runs, "sideslip_rad", degrees)),
        Panel("steering, degrees", curves_of(runs, "steer_rad", degrees)),
        Panel("yaw moment, N m", curves_of(runs, "yaw_moment_nm")),
    )
