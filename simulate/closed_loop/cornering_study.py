"""The study N13-cornering: lateral stability control at 20 km/h behind every estimator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polemap.electric.control.lateral_stability import LateralLimits
from polemap.electric.estimators.base import GPS, Estimate
from polemap.electric.studies.scenes import GPS_STIFFNESS_NPRAD, KMH
from polemap.electric.studies.study import Curve, Line, Panel, Report, Study, curves_of
from polemap.simulate.closed_loop.cars import plant_of, with_stiffness
from polemap.simulate.closed_loop.choice import NONE, REJECTING_NOISE, TRUTH, behind, choose
from polemap.simulate.closed_loop.cornering import (
    Corner,
    CornerSettings,
    StabilityLoop,
    yaw_moment_limit_nm,
)
from polemap.simulate.closed_loop.lateral import Command, LateralRun, run_lateral
from polemap.simulate.closed_loop.sensing import Measured, SensorModel
from polemap.simulate.closed_loop.speeds import RANGES, Swing
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import KINEMATIC_SPEED_MPS

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
    speed: float | Swing = SPEED_MPS

    def run(
        self, name: str, seed: int, settings: CornerSettings | None = None, hold_s: float = 0.0
    ) -> LateralRun:
        """One run of the case with an estimator."""
        real, nominal = GPS_STIFFNESS_NPRAD
        model = with_stiffness(self.car, nominal)
        limits = LateralLimits(0.35, yaw_moment_limit_nm(self.car))
        loop = StabilityLoop(model, settings or CornerSettings(), limits)
        estimator, late = behind(name, model, REJECTING_NOISE, (GPS,))
        return run_lateral(
            plant_of(with_stiffness(self.car, real)),
            self.speed,
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
    table = _Table(Case(car, Corner(), 0.9), seeds, report)
    table.free()
    for name in (TRUTH, *names):
        table.behind(name)
    ice = Case(car, Corner(ICE_STEER_RAD), ICE)
    lines = [*table.lines, *_ice(ice, names[-1], seeds, table.figures)]
    report(3 * seeds)
    for swing in RANGES:
        lines += _varying(car, swing, names, table.figures, report)
    remarks = (
        "Side-slip against its reference, rms from 1 s after the wheel stands; single rate: the "
        f"controller runs once per GPS value ({1000 * GPS_PERIOD_S:.0f} ms).",
        "The loop brings the estimate to the reference, so what is left is the estimator's own "
        "error. Layer 1 tells side-slip from heading only by how long it saw the car go straight; "
        "the stiffness filter knows that a straight car has none.",
        "A controller sees through an estimator without disturbances by an observer behind it; the "
        "bicycle's side-slip is its model's, so there is nothing in it to find.",
        "At 10-20 and 0-30 km/h the speed goes up and down once in 16 s, one drive each, scored "
        f"from {KINEMATIC_SPEED_MPS:.0f} m/s on; the motors of the moment also drive and brake.",
        f"Friction {ICE}, {ICE_STEER_RAD} rad: the reference cannot be driven. Saturated is the "
        "share of time in which a limit was met or the car was handed back to the driver.",
    )
    return Study(
        NAME,
        "Lateral stability in a corner at 20 km/h",
        tuple(lines),
        (),
        remarks,
        table.figures,
        _panels(table.curves, table.limit_nm),
        ("ours", "errata", "the paper says; moment"),
    )


class _Table:
    """Runs of the dry corner, and the rows, figures and curves that they fill."""

    def __init__(self, case: Case, seeds: int, report: Report) -> None:
        self.case, self.seeds, self.report = case, seeds, report
        self.limit_nm = yaw_moment_limit_nm(case.car)
        self.lines: list[Line] = []
        self.figures = {"moment_limit_nm": self.limit_nm}
        self.curves: dict[str, LateralRun] = {}

    def several(self, name: str, settings: CornerSettings, hold_s: float = 0.0) -> list[LateralRun]:
        """A run a seed."""
        runs = [self.case.run(name, seed, settings, hold_s) for seed in range(self.seeds)]
        self.report(self.seeds)
        return runs

    def free(self) -> None:
        """The row of no control."""
        runs = self.several(NONE, CornerSettings())
        error = _mean_error_rad(runs, self.case.corner.settled_s)
        self.figures["free_settled_rad"] = error
        self.lines.append(
            Line(NONE, f"{1e3 * error:.2f} mrad", "15.6", "off the reference (Fig. 15)")
        )
        self.curves[NONE] = runs[0]

    def behind(self, name: str) -> None:
        """The rows of one estimator: without and with rejection, and at the GPS rate."""
        settled, begin = self.case.corner.settled_s, self.case.corner.begin_s
        left = self.several(name, CornerSettings(reject=False))
        done = self.several(name, CornerSettings())
        held = self.several(name, CornerSettings(), GPS_PERIOD_S)
        errors = [_mean_error_rad(runs, settled) for runs in (left, done, held)]
        ratio = errors[1] / errors[0]
        whole = _mean_error_rad(done, begin) / _mean_error_rad(left, begin)
        peak = max(r.moment_peak_nm() for r in (*left, *done, *held))
        share = float(np.mean([r.saturated.mean() for r in done]))
        key = name.replace(" ", "_")
        self.figures |= {
            f"{key}_unrejected_rad": errors[0],
            f"{key}_rejected_rad": errors[1],
            f"{key}_ratio": ratio,
            f"{key}_ratio_worst": max(
                d.error_rms_rad(settled) / u.error_rms_rad(settled)
                for d, u in zip(done, left, strict=True)
            ),
            f"{key}_whole_ratio": whole,
            f"{key}_held_rad": errors[2],
            f"{key}_moment_nm": peak,
            f"{key}_saturated": share,
        }
        errata, claim = PAPER.get(name, ("", ""))
        self.lines += [
            Line(
                f"{name}: unrejected / rejected / single rate",
                " / ".join(f"{1e3 * error:.2f}" for error in errors) + " mrad",
                errata,
                claim,
            ),
            Line(
                f"{name}: rejected / unrejected; whole corner",
                f"{ratio:.3f}; {whole:.2f}",
                "0.04" if errata else "",
                f"|Nz| up to {peak:.1f} N m (limit {self.limit_nm:.1f}), "
                f"{100 * share:.1f} % saturated",
            ),
        ]
        self.curves[name] = done[0]


def _mean_error_rad(runs: list[LateralRun], start_s: float) -> float:
    return float(np.mean([r.error_rms_rad(start_s) for r in runs]))


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


def _varying(
    car: Car, swing: Swing, names: tuple[str, ...], figures: dict[str, float], report: Report
) -> list[Line]:
    """The corner at a speed that swings: unrejected and rejected, one drive a row."""
    case = Case(car, Corner(), 0.9, swing.lasts_s, swing)
    settled = case.corner.settled_s
    lines = []
    for name in (NONE, TRUTH, *names):
        off = case.run(name, 0, CornerSettings(reject=False))
        errors = [off.error_rms_rad(settled, KINEMATIC_SPEED_MPS)]
        if name != NONE:
            on = case.run(name, 0, CornerSettings())
            errors.append(on.error_rms_rad(settled, KINEMATIC_SPEED_MPS))
        report(len(errors))
        key = f"{name}_{swing.lowest_kmh:.0f}_{swing.highest_kmh:.0f}".replace(" ", "_")
        figures |= {
            f"{key}_{what}_rad": error
            for what, error in zip(("unrejected", "rejected"), errors, strict=False)
        }
        ratio = f"ratio {errors[1] / errors[0]:.3f}" if name != NONE else ""
        text = " / ".join(f"{1e3 * error:.2f}" for error in errors) + " mrad"
        lines.append(Line(f"{swing}, {name}: unrejected / rejected", text, "", ratio))
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
