"""The study N13-slip: slip-ratio control on a wet sheet, its robustness, and its velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polemap.electric.control.slip_ratio import SlipRatioSettings
from polemap.electric.estimators.base import GPS
from polemap.electric.studies.study import Curve, Line, Panel, Report, Study
from polemap.simulate.closed_loop.cars import plant_of
from polemap.simulate.closed_loop.choice import COURSE_NOISE, choose, fresh
from polemap.simulate.closed_loop.sensing import SensorModel
from polemap.simulate.closed_loop.slip import (
    SheetScene,
    SlipRun,
    Velocity,
    biased,
    estimated,
    front_wheels,
    gps_held,
    held_slip,
    run_sheet,
    with_lag,
)
from polemap.simulate.plant import GRAVITY_MPS2, PlantParameters
from polemap.vehicle.parameters import Car

NAME = "N13-slip"
TARGET = SlipRatioSettings().target
SPEED_ERRORS = (-0.05, -0.025, 0.0, 0.025, 0.05)
FRICTIONS = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
LAGS_S = (0.0, 0.002, 0.005, 0.01, 0.02, 0.05)
FULL_TORQUE_NM = 100.0
DEFAULT = ("kinematic", "two_layer", "two_layer_reconstructed", "two_layer_ignored")
REMARKS = (
    "Slip from the wheel meeting the sheet: mean from 0.1 s on, largest, and time until it "
    "stays within 0.01 of 0.1; worst of the seeds.",
    "A controller that holds 1 - v/(r omega) turns an error e of the velocity into the slip "
    "1 - (1 - 0.1)/(1 + e): 0.053 and 0.143 at -5 and +5 %. No gain changes that, only a "
    "better velocity does.",
    f"Where the ground carries more than the motor's {FULL_TORQUE_NM:.0f} N m the slip stays "
    "below the target and the driver's torque passes unchanged.",
    f"Friction rows ask for {FULL_TORQUE_NM:.0f} N m, the motor's limit; a slow motor cannot "
    "undo a jump of friction within its lag, whatever it is told.",
)


def slip_study(car: Car, seeds: int, report: Report, estimators: tuple[str, ...]) -> Study:
    """Wet sheet of friction 0.15 after a road of 0.8, 70 N m at each rear wheel.

    Raises:
        ConfigError: an estimator without a forward velocity.
    """
    names = choose(NAME, estimators, DEFAULT, (GPS,), "vx_mps")
    sheet = _Sheet(car, seeds, report)
    free = sheet.several(None)
    held = sheet.several(biased(0.0))
    sheet.note("free", "no control", free, "peak 0.79", "slips (Fig. 13)")
    sheet.note(
        "true", "sliding mode, true velocity", held, "0.100, <= 0.102", "holds 0.1 (Fig. 14)"
    )
    _robustness(sheet)
    curves = {"no control": free[0], "true velocity": held[0]}
    curves |= _velocities(sheet, names)
    return Study(
        NAME,
        "Slip-ratio control on a wet sheet",
        tuple(sheet.lines),
        (),
        REMARKS,
        sheet.figures,
        _panels(curves),
        ("mean, peak, settled", "expected", "the paper says"),
    )


class _Sheet:
    """Runs over the sheet, and the table and the figures that they fill."""

    def __init__(self, car: Car, seeds: int, report: Report) -> None:
        self.car, self.seeds, self.report = car, seeds, report
        self.parameters, self.scene = plant_of(car), SheetScene()
        self.lines: list[Line] = []
        self.figures: dict[str, float] = {}

    def several(
        self,
        velocity: Velocity | None,
        plant: PlantParameters | None = None,
        at: SheetScene | None = None,
    ) -> list[SlipRun]:
        """A run a seed; without a velocity there is no control."""
        runs = [
            run_sheet(
                plant or self.parameters,
                at or self.scene,
                velocity=velocity,
                rng=np.random.default_rng(seed),
            )
            for seed in range(self.seeds)
        ]
        self.report(self.seeds)
        return runs

    def behind(self, name: str) -> list[SlipRun]:
        """A run a seed with the velocity of an estimator."""
        runs = []
        for seed in range(self.seeds):
            runs.append(
                run_sheet(
                    self.parameters,
                    self.scene,
                    velocity=estimated,
                    rng=np.random.default_rng(seed),
                    sensors=SensorModel(),
                    estimator=fresh(name, self.car, COURSE_NOISE),
                )
            )
            self.report(1)
        return runs

    def note(
        self, key: str, label: str, runs: list[SlipRun], expected: str = "", claim: str = ""
    ) -> None:
        """A row: worst peak and settling of the runs, and their mean."""
        peak = float(np.max([r.peak() for r in runs]))
        mean = float(np.mean([r.mean() for r in runs]))
        settled = float(np.max([r.settled_s(TARGET) for r in runs]))
        self.figures |= {f"{key}_mean": mean, f"{key}_peak": peak, f"{key}_settled_s": settled}
        late = f"{settled:.3f} s" if np.isfinite(settled) else "-"
        self.lines.append(Line(label, f"{mean:.3f}, {peak:.3f}, {late}", expected, claim))


def _robustness(sheet: _Sheet) -> None:
    """A velocity that is wrong, other frictions, a motor that lags."""
    for error in SPEED_ERRORS:
        sheet.note(
            f"velocity_{100 * error:+.1f}",
            f"velocity {100 * error:+.1f} %",
            sheet.several(biased(error)),
            f"theory {held_slip(TARGET, error):.3f}",
        )
    parameters = sheet.parameters
    for friction in FRICTIONS:
        at = replace(sheet.scene, sheet_friction=friction, driver_torque_nm=FULL_TORQUE_NM)
        grip = (
            friction
            * parameters.mass_kg
            * GRAVITY_MPS2
            * parameters.front_m
            * parameters.wheel_radius_m
        )
        grip /= 2.0 * (parameters.front_m + parameters.rear_m)
        text = f"grip {grip:.0f} of {FULL_TORQUE_NM:.0f} N m"
        name = f"friction_{friction}"
        free = sheet.several(None, at=at)
        sheet.note(f"{name}_free", f"friction {friction}, no control", free, text)
        sheet.note(name, f"friction {friction}", sheet.several(biased(0.0), at=at), text)
    for lag in LAGS_S:
        runs = sheet.several(biased(0.0), with_lag(parameters, lag))
        sheet.note(f"lag_{1000 * lag:.0f}ms", f"motor lag {1000 * lag:.0f} ms", runs)


def _velocities(sheet: _Sheet, names: tuple[str, ...]) -> dict[str, SlipRun]:
    """Where the velocity comes from: sensors as they are, and estimators; the first runs."""
    curves = {}
    for key, name, velocity in (
        ("front_wheels", "front wheels", front_wheels),
        ("GPS_held", "GPS, held", gps_held()),
    ):
        runs = sheet.several(velocity)
        sheet.note(key, f"velocity from {name}", runs)
        curves[name] = runs[0]
    for name in names:
        runs = sheet.behind(name)
        claim = "proposed" if name == "two_layer_reconstructed" else ""
        sheet.note(name, f"velocity from {name}", runs, claim=claim)
        curves[name] = runs[0]
    return curves


def _panels(runs: dict[str, SlipRun]) -> tuple[Panel, ...]:
    def curves(field: str) -> tuple[Curve, ...]:
        return tuple(
            Curve(label, r.stamp_s - r.entry_s(), getattr(r, field)) for label, r in runs.items()
        )

    x = "time since the wheel met the sheet, s"
    return (
        Panel("slip ratio", curves("slip"), (TARGET,), x),
        Panel("torque, N m", curves("torque_nm"), (), x),
        Panel("velocity used, m/s", curves("used_speed_mps"), (), x),
    )
