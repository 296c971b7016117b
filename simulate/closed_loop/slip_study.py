"""The study N13-slip: slip-ratio control on a wet sheet, its robustness, and its velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simulate.closed_loop.cars import plant_of
from simulate.closed_loop.choice import COURSE_NOISE, choose, fresh
from simulate.closed_loop.sensing import SensorModel
from simulate.closed_loop.slip import (
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
from simulate.plant import PlantParameters
from vehicle.control.slip_ratio import SlipRatioSettings
from vehicle.estimators.base import GPS
from vehicle.parameters import Car
from vehicle.studies.study import Curve, Line, Panel, Report, Study

NAME = "N13-slip"
TARGET = SlipRatioSettings().target
SPEED_ERRORS = (-0.05, -0.025, 0.0, 0.025, 0.05)
FRICTIONS = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
LAGS_S = (0.0, 0.002, 0.005, 0.01, 0.02, 0.05)
FULL_TORQUE_NM = 100.0
DEFAULT = ("kinematic", "two_layer", "two_layer_reconstructed", "two_layer_ignored")


def slip_study(car: Car, seeds: int, report: Report, estimators: tuple[str, ...]) -> Study:
    """Wet sheet of friction 0.15 after a road of 0.8, 70 N m at each rear wheel.

    Raises:
        ConfigError: an estimator without a forward velocity.
    """
    names = choose(NAME, estimators, DEFAULT, (GPS,), "vx_mps")
    parameters, scene = plant_of(car), SheetScene()
    lines: list[Line] = []
    figures: dict[str, float] = {}

    def note(
        key: str, label: str, runs: list[SlipRun], expected: str = "", claim: str = ""
    ) -> None:
        peak = float(np.max([r.peak() for r in runs]))
        mean = float(np.mean([r.mean() for r in runs]))
        settled = float(np.max([r.settled_s(TARGET) for r in runs]))
        figures.update({f"{key}_mean": mean, f"{key}_peak": peak, f"{key}_settled_s": settled})
        late = f"{settled:.3f} s" if np.isfinite(settled) else "-"
        lines.append(Line(label, f"{mean:.3f}, {peak:.3f}, {late}", expected, claim))

    def several(velocity: Velocity | None, plant: PlantParameters, at: SheetScene) -> list[SlipRun]:
        runs = [
            run_sheet(plant, at, velocity=velocity, rng=np.random.default_rng(seed))
            for seed in range(seeds)
        ]
        report(seeds)
        return runs

    free = several(None, parameters, scene)
    held = several(biased(0.0), parameters, scene)
    note("free", "no control", free, "peak 0.79", "slips (Fig. 13)")
    note("true", "sliding mode, true velocity", held, "0.100, <= 0.102", "holds 0.1 (Fig. 14)")
    for error in SPEED_ERRORS:
        note(
            f"velocity_{100 * error:+.1f}",
            f"velocity {100 * error:+.1f} %",
            several(biased(error), parameters, scene),
            f"theory {held_slip(TARGET, error):.3f}",
        )
    for friction in FRICTIONS:
        at = replace(scene, sheet_friction=friction, driver_torque_nm=FULL_TORQUE_NM)
        grip = friction * parameters.mass_kg * 9.81 * parameters.front_m * parameters.wheel_radius_m
        grip /= 2.0 * (parameters.front_m + parameters.rear_m)
        text = f"grip {grip:.0f} of {FULL_TORQUE_NM:.0f} N m"
        note(
            f"friction_{friction}_free",
            f"friction {friction}, no control",
            several(None, parameters, at),
            text,
        )
        note(
            f"friction_{friction}",
            f"friction {friction}",
            several(biased(0.0), parameters, at),
            text,
        )
    for lag in LAGS_S:
        runs = several(biased(0.0), with_lag(parameters, lag), scene)
        note(f"lag_{1000 * lag:.0f}ms", f"motor lag {1000 * lag:.0f} ms", runs)
    curves = {"no control": free[0], "true velocity": held[0]}
    sources: list[tuple[str, Velocity]] = [
        ("front wheels", front_wheels),
        ("GPS, held", gps_held()),
    ]
    for name, velocity in sources:
        runs = several(velocity, parameters, scene)
        note(name.replace(", ", "_").replace(" ", "_"), f"velocity from {name}", runs)
        curves[name] = runs[0]
    for name in names:
        runs = []
        for seed in range(seeds):
            estimator = fresh(name, car, COURSE_NOISE)
            runs.append(
                run_sheet(
                    parameters,
                    scene,
                    velocity=estimated,
                    rng=np.random.default_rng(seed),
                    sensors=SensorModel(),
                    estimator=estimator,
                )
            )
            report(1)
        claim = "proposed" if name == "two_layer_reconstructed" else ""
        note(name, f"velocity from {name}", runs, claim=claim)
        curves[name] = runs[0]
    remarks = (
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
    return Study(
        NAME,
        "Slip-ratio control on a wet sheet",
        tuple(lines),
        (),
        remarks,
        figures,
        _panels(curves),
        ("mean, peak, settled", "expected", "the paper says"),
    )


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
