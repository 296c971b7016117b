"""Each paper's simulation with its table: our figures, the paper's claim, and the errata's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.signals import play
from polemap.electric.studies.convergence import frame_radii, running_radius, update_jumps
from polemap.electric.studies.experiments import (
    delay_rows,
    position_panels,
    position_rows,
    swinging,
    swinging_rows,
)
from polemap.electric.studies.gps_study import n13
from polemap.electric.studies.outcomes import EVERY, outcome, sideslip_curves
from polemap.electric.studies.scenes import (
    KMH,
    MATCHED,
    MISMATCH,
    PATTERN_S,
    Scene,
    Simulated,
    drive_with_camera,
)
from polemap.electric.studies.study import Curve, Line, Report, Study, sideslip_panels
from polemap.vehicle.parameters import Car


def _drives(plant: Car, scene: Scene, config: EstimatorConfig, seeds: int) -> list[Simulated]:
    return [
        drive_with_camera(plant, scene, config, np.random.default_rng(seed))
        for seed in range(seeds)
    ]


def w12(car: Car, seeds: int = 10, report: Report = lambda _n: None) -> Study:
    """Stiffness x 5, mass x 2, 30 km/h: single-rate and multi-rate against the bicycle."""
    scene = Scene(30 * KMH, 8.0, 0.06, 0.5, model_noise=False)
    drives = _drives(car.scaled(stiffness=5.0, mass=2.0), scene, MISMATCH, seeds)
    lines, figures = _relative(
        car,
        drives,
        {
            "single_rate": ("0.6", "-16 % (experiment)"),
            "clones": ("0.6", "-28 % (experiment)"),
        },
        report,
    )
    names = {
        "bicycle": "bicycle",
        "single_rate": "single rate",
        "clones": "multi-rate, exact delay",
    }
    claims = {"single_rate": "-16 %", "clones": "-28 %"}
    for rows, found in (
        delay_rows(car, seeds, report),
        swinging_rows(car, car.scaled(stiffness=5.0, mass=2.0), swinging(10.0, 20.0, scene),
                      claims, seeds, report),
    ):  # fmt: skip
        lines += rows
        figures |= found
    remarks = (
        "Compare ratios: the paper prints neither noise nor steering amplitude.",
        "Multi-rate and single-rate are close at 30 km/h; the paper's gap is not forced.",
        "At 10-20 km/h single rate is no better than the bicycle: this car's side-slip by steering "
        "changes its sign at 20.7 km/h and is small below, so that the holding over 33 ms is most "
        "of what is left.",
    )
    curves = sideslip_curves(names, car, MISMATCH, drives[0])
    return Study(
        "W12", "Side-slip with a camera, model far off", tuple(lines), curves, remarks, figures
    )


def w14(car: Car, seeds: int = 10, report: Report = lambda _n: None) -> Study:
    """Stiffness x 1.2, 25 km/h sine: all camera filters against the bicycle, and convergence."""
    scene = Scene(25 * KMH, 8.0, 0.06, 0.5, model_noise=False)
    drives = _drives(car.scaled(stiffness=1.2), scene, MISMATCH, seeds)
    better = "better than bicycle"
    lines, figures = _relative(
        car,
        drives,
        {
            "single_rate": ("0.82", better),
            "clones": ("0.81", "better than single rate"),
            "compensated": ("0.83", "best"),
            "uneven_delay": ("0.77", "(W13)"),
            "stiffness": ("0.04", "beyond the papers"),
        },
        report,
    )
    scales = []
    for drive in drives:
        played = play(make_estimator("stiffness", car, MISMATCH), drive.log, every=EVERY)
        scales.append(played.column("stiffness_scale")[len(played.stamp_s) // 2 :].mean())
        report(1)
    figures["stiffness_scale"] = float(np.mean(scales))
    lines.append(
        Line(
            "estimated stiffness scale", f"{np.mean(scales):.3f} +- {np.std(scales):.3f}", "1.2", ""
        )
    )
    claims = {"single_rate": better, "clones": "", "compensated": "best", "stiffness": ""}
    rows, found = swinging_rows(
        car, car.scaled(stiffness=1.2), swinging(0.0, 30.0, scene), claims, seeds, report
    )
    lines += rows
    figures |= found
    radii = frame_radii(car, MISMATCH, 25 * KMH)
    jumps = update_jumps(car, MISMATCH, drives[0])
    figures |= radii | jumps
    gap = abs(radii["radius_compensated"] - radii["radius_ideal"])
    lines.append(Line("radius a frame, compensated - ideal", f"{gap:.1e}", "4e-6", "converges"))
    running = running_radius("compensated", car, MISMATCH, 25 * KMH)
    figures["radius_running"] = running
    lines.append(
        Line("radius a frame, compensated: running filter, analysis",
             f"{running:.4f}, {radii['radius_compensated']:.4f}", "equal", "converges")
    )  # fmt: skip
    lines.append(
        Line("radius a frame, uncompensated", f"{radii['radius_switching']:.4f}", "", "open loop")
    )
    share = jumps["jump_compensated_rad"] / jumps["jump_uncompensated_rad"]
    figures["jump_share"] = share
    lines.append(Line("jump at pictures, compensated / exact", f"{share:.3f}", "0.1", "smoother"))
    remarks = (
        "At 25 km/h the full ordering bicycle > single > multi > compensated of the paper's Fig. 7 "
        "held at none of 147 tunings (errata): a model that is 20 % off has a bias of one sign at "
        "one speed, and a sub-optimal filter can cancel it. At 0-30 km/h it has either sign, and "
        "the ordering comes out.",
        "Uncompensated is not open loop between pictures: the yaw rate still corrects it.",
        "Table II does not reproduce: three closed-loop poles at -2 Hz cannot be had above "
        "14.5 km/h, and 15.15 Hz is the Nyquist frequency of 33 ms.",
    )
    names = {
        "bicycle": "bicycle",
        "single_rate": "single rate",
        "clones": "multi-rate, exact",
        "compensated": "compensated",
    }
    curves = sideslip_curves(names, car, MISMATCH, drives[0])
    return Study("W14", "Inter-sample compensation", tuple(lines), curves, remarks, figures)


def w13(car: Car, seeds: int = 20, report: Report = lambda _n: None) -> Study:
    """Matched noise: every treatment of the delay against the exact filter, two delay patterns."""
    lines: list[Line] = []
    figures: dict[str, float] = {}
    curves: tuple[Curve, ...] = ()
    expected = {
        "reconstruction": ("1.00", "1.00"),
        "uneven_compensated": ("", ""),
        "uneven_delay": ("1.04", "1.01"),
        "measurement_reconstruction": ("1.04", "1.02"),
        "compensated": ("", ""),
        "single_rate": ("", ""),
        "bicycle": ("1.07-1.10", "1.07-1.10"),
        "ignored": ("1.5-1.6", "1.5-1.6"),
        "assumed": ("", "1.3-1.4"),
    }
    variants = {
        "ignored": MATCHED.model_copy(update={"camera_delay_s": 0.0}),
        "assumed": MATCHED.model_copy(update={"camera_delay_s": 0.033}),
    }
    for column, delays in enumerate(((0.033,), PATTERN_S)):
        title = "33 ms" if column == 0 else "20, 15, 10, 25 ms"
        drives = _drives(car, Scene(25 * KMH, 8.0, 0.1, 0.5, delays), MATCHED, seeds)
        exact = outcome("clones", car, MATCHED, drives, with_nees=True)
        report(seeds)
        key = "constant" if column == 0 else "pattern"
        figures |= {f"{key}_nees": exact.nees, f"{key}_rmse_over_sd": exact.rmse_rad / exact.sd_rad}
        lines.append(Line(f"{title}: exact, NEES a state", f"{exact.nees:.3f}", "1", ""))
        lines.append(
            Line(f"{title}: exact, RMSE / own sd", f"{exact.rmse_rad / exact.sd_rad:.3f}", "1", "")
        )
        for name, texts in expected.items():
            if name == "assumed" and column == 0:
                continue
            config = variants.get(name, MATCHED)
            made = "multi_rate" if name in variants else name
            ratio = outcome(made, car, config, drives).rmse_rad / exact.rmse_rad
            report(seeds)
            figures[f"{key}_{name}"] = ratio
            claim = _W13_CLAIMS.get(name, "")
            label = "W13 (uneven_compensated)" if name == "uneven_compensated" else name
            lines.append(Line(f"{title}: {label} / exact", f"{ratio:.3f}", texts[column], claim))
        if column == 1:
            names = {
                "clones": "exact",
                "uneven_compensated": "W13",
                "multi_rate": "33 ms assumed",
            }
            curves = sideslip_curves(names, car, MATCHED, drives[0])
    panels = (*sideslip_panels(curves), *position_panels(car))
    rows, found = position_rows(car, seeds, report)
    lines += rows
    figures |= found
    remarks = (
        "W13's proposal is the stored residual with inter-sample propagation (16)-(22), gains from "
        "the steady Riccati equation; the exact filter has no such step and needs none.",
        "Printed W13 stores the a-priori state; with a delay of one frame it diverges.",
        "Judged with matched noise: plant and filters share model and noise.",
        "Stiffness x 1.2: W13 beats a constant delay, as the paper says. On lateral position the "
        "stored residual alone is better than with propagation: the propagated filter's gains are "
        "the steady ones for 33 times the camera's variance, which follow it more softly. "
        "On side-slip that softness keeps out what the wrong model makes of the pictures.",
    )
    return Study("W13", "Uneven delays", tuple(lines), curves, remarks, figures, panels)


_W13_CLAIMS = {"assumed": "fails", "uneven_compensated": "best"}


def _relative(
    car: Car, drives: list[Simulated], rows: dict[str, tuple[str, str]], report: Report
) -> tuple[list[Line], dict[str, float]]:
    base = outcome("bicycle", car, MISMATCH, drives)
    report(len(drives))
    lines = [Line("bicycle, RMSE rad", f"{base.rmse_rad:.5f}", "", "cannot track")]
    figures = {"bicycle_rmse_rad": base.rmse_rad}
    for name, (expected, claim) in rows.items():
        found = outcome(name, car, MISMATCH, drives)
        figures[name] = found.rmse_rad / base.rmse_rad
        text = f"{figures[name]:.3f} +- {found.spread_rad / base.rmse_rad:.3f}"
        lines.append(Line(f"{name} / bicycle", text, expected, claim))
        report(len(drives))
    return lines, figures


STUDIES: dict[str, tuple[Callable[..., Study], int]] = {
    "W12": (w12, 10),
    "W14": (w14, 10),
    "W13": (w13, 20),
    "N13": (n13, 10),
}
"""By name: the study and the seeds it takes by default."""
