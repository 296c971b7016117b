"""The study N13-cornering: lateral stability control at 20 km/h behind every estimator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulate.closed_loop.cars import plant_of, with_stiffness
from simulate.closed_loop.choice import NONE, REJECTING_NOISE, TRUTH, behind, choose
from simulate.closed_loop.cornering import (
    Corner,
    CornerSettings,
    StabilityLoop,
    yaw_moment_limit_nm,
)
from simulate.closed_loop.lateral import Command, LateralRun, run_lateral
from simulate.closed_loop.sensing import Measured, SensorModel
from vehicle.control.lateral_stability import LateralLimits
from vehicle.estimators.base import GPS, Estimate
from vehicle.parameters import Car
from vehicle.studies.settings import GPS_STIFFNESS_NPRAD, KMH
from vehicle.studies.study import Curve, Line, Panel, Report, Study, curves_of

NAME = "N13-cornering"
SPEED_MPS, DURATION_S = 20 * KMH, 8.5
GPS_PERIOD_S = 0.05
ICE, ICE_STEER_RAD = 0.3, 0.15
SPUN_RAD = 0.5
PAPER = {
    "two_layer": ("10.0 / 0.4", ""),
    "two_layer_reconstructed": ("", "tracks the reference (Fig. 16)"),
}
"""What errata gives and what the paper claims."""
DEFAULT = (
    "bicycle",
    "linear_observer",
    "two_layer",
    "two_layer_reconstructed",
    "two_layer_ignored",
    "stiffness",
)


@dataclass(frozen=True, slots=True)
class Case:
    """A scene with its car; runs of it differ by what closes the loop."""

    car: Car
    corner: Corner
    friction: float
    duration_s: float = DURATION_S

    def run(
        self, name: str, seed: int, settings: CornerSettings | None = None, hold_s: float = 0.0
    ) -> LateralRun:
        real, nominal = GPS_STIFFNESS_NPRAD
        model = with_stiffness(self.car, nominal)
        limits = LateralLimits(0.35, yaw_moment_limit_nm(self.car))
        loop = StabilityLoop(model, settings or CornerSettings(), limits)
        estimator, late = behind(name, model, REJECTING_NOISE, (GPS,))
        return run_lateral(
            plant_of(with_stiffness(self.car, real)),
            SPEED_MPS,
            self.duration_s,
            self.corner,
            _Watched(loop) if name == NONE else loop,
            rng=np.random.default_rng(seed),
            friction=lambda _east, _north: self.friction,
            sensors=SensorModel(gps_period_s=GPS_PERIOD_S),
            estimator=estimator,
            late=late,
            hold_s=hold_s,
        )


class _Watched:
    """No control, but the reference that control would have had."""

    def __init__(self, loop: StabilityLoop) -> None:
        self._loop = loop

    def __call__(
        self, driver_rad: float, seen: Estimate, measured: Measured, dt_s: float
    ) -> Command:
        aim = self._loop(driver_rad, seen, measured, dt_s)
        return Command(driver_rad, 0.0, False, *aim[3:])


def cornering_study(car: Car, seeds: int, report: Report, estimators: tuple[str, ...]) -> Study:
    """0.1 rad of steering held; 7000 real against 10 000 nominal N/rad; GPS at 20 Hz, 100 ms late.

    Raises:
        ConfigError: an estimator that needs a camera, or has no side-slip.
    """
    names = choose(NAME, estimators, DEFAULT, (GPS,), "sideslip_rad")
    dry = Case(car, Corner(), 0.9)
    settled, begin = dry.corner.settled_s, dry.corner.begin_s
    lines: list[Line] = []
    limit_nm = yaw_moment_limit_nm(car)
    figures = {"moment_limit_nm": limit_nm}
    curves: dict[str, LateralRun] = {}

    def several(
        case: Case, name: str, settings: CornerSettings, hold_s: float = 0.0
    ) -> list[LateralRun]:
        runs = [case.run(name, seed, settings, hold_s) for seed in range(seeds)]
        report(seeds)
        return runs

    def mean(runs: list[LateralRun], start_s: float) -> float:
        return float(np.mean([r.error_rms_rad(start_s) for r in runs]))

    free = several(dry, NONE, CornerSettings())
    figures["free_settled_rad"] = mean(free, settled)
    lines.append(
        Line(NONE, f"{1e3 * mean(free, settled):.2f} mrad", "15.6", "off the reference (Fig. 15)")
    )
    curves[NONE] = free[0]
    for name in (TRUTH, *names):
        left = several(dry, name, CornerSettings(reject=False))
        done = several(dry, name, CornerSettings())
        held = several(dry, name, CornerSettings(), GPS_PERIOD_S)
        ratio = mean(done, settled) / mean(left, settled)
        key = name.replace(" ", "_")
        peak = max(r.moment_peak_nm() for r in (*left, *done, *held))
        figures |= {
            f"{key}_unrejected_rad": mean(left, settled),
            f"{key}_rejected_rad": mean(done, settled),
            f"{key}_ratio": ratio,
            f"{key}_ratio_worst": max(
                d.error_rms_rad(settled) / u.error_rms_rad(settled)
                for d, u in zip(done, left, strict=True)
            ),
            f"{key}_whole_ratio": mean(done, begin) / mean(left, begin),
            f"{key}_held_rad": mean(held, settled),
            f"{key}_moment_nm": peak,
            f"{key}_saturated": float(np.mean([r.saturated.mean() for r in done])),
        }
        sat = figures[f"{key}_saturated"]
        values = [1e3 * mean(runs, settled) for runs in (left, done, held)]
        errata, claim = PAPER.get(name, ("", ""))
        lines += [
            Line(
                f"{name}: unrejected / rejected / single rate",
                " / ".join(f"{v:.2f}" for v in values) + " mrad",
                errata,
                claim,
            ),
            Line(
                f"{name}: rejected / unrejected; whole corner",
                f"{ratio:.3f}; {figures[f'{key}_whole_ratio']:.2f}",
                "0.04" if errata else "",
                f"|Nz| up to {peak:.1f} N m (limit {limit_nm:.1f}), {100 * sat:.1f} % saturated",
            ),
        ]
        curves[name] = done[0]
    ice = Case(car, Corner(ICE_STEER_RAD), ICE)
    lines += _ice(ice, names[-1], seeds, figures)
    report(3 * seeds)
    remarks = (
        "Side-slip against its reference, rms from 1 s after the wheel stands; single rate: the "
        f"controller runs once per GPS value ({1000 * GPS_PERIOD_S:.0f} ms).",
        "The loop brings the estimate to the reference, so what is left is the estimator's own "
        "error. Layer 1 tells side-slip from heading only by how long it saw the car go straight; "
        "the stiffness filter knows that a straight car has none.",
        "A controller sees through an estimator without disturbances by an observer behind it; the "
        "bicycle's side-slip is its model's, so there is nothing in it to find.",
        f"Friction {ICE}, {ICE_STEER_RAD} rad: the reference cannot be driven. Saturated is the "
        "share of time in which a limit was met or the car was handed back to the driver.",
    )
    return Study(
        NAME,
        "Lateral stability in a corner at 20 km/h",
        tuple(lines),
        (),
        remarks,
        figures,
        _panels(curves, limit_nm),
        ("ours", "errata", "the paper says; moment"),
    )


def _ice(ice: Case, name: str, seeds: int, figures: dict[str, float]) -> list[Line]:
    """The corner where the ground carries too little: free, with the guard, and without it."""
    lines = []
    for key, label, who, settings in (
        ("ice_free", NONE, NONE, CornerSettings()),
        ("ice_guarded", name, name, CornerSettings()),
        ("ice_unguarded", f"{name}, never handed back", name, CornerSettings(guarded=False)),
    ):
        runs = [ice.run(who, seed, settings) for seed in range(seeds)]
        peak = max(r.peak_rad() for r in runs)
        share = float(np.mean([r.saturated.mean() for r in runs]))
        figures |= {f"{key}_peak_rad": peak, f"{key}_saturated": share}
        spun = "spins" if peak > SPUN_RAD else f"peak {1e3 * peak:.0f} mrad"
        text = "" if who == NONE else f"{100 * share:.0f} % saturated or handed back"
        lines.append(Line(f"friction {ice.friction}: {label}", spun, "", text))
    return lines


def _panels(runs: dict[str, LateralRun], limit_nm: float) -> tuple[Panel, ...]:
    first = next(iter(runs.values()))
    degrees = 180.0 / np.pi
    wanted = Curve("reference", first.stamp_s, degrees * first.sideslip_reference_rad)
    turn = Curve("reference", first.stamp_s, degrees * first.yaw_rate_reference_radps)
    return (
        Panel("side-slip, degrees", (wanted, *curves_of(runs, "sideslip_rad", degrees))),
        Panel("yaw rate, degrees/s", (turn, *curves_of(runs, "yaw_rate_radps", degrees))),
        Panel("yaw moment, N m", curves_of(runs, "yaw_moment_nm"), (-limit_nm, limit_nm)),
    )
