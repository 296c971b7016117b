"""Side-slip errors of an estimator over simulated drives, and its curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import Estimator
from polemap.electric.estimators.registry import make_estimator
from polemap.electric.signals import play
from polemap.electric.studies.scenes import Simulated
from polemap.electric.studies.study import Curve
from polemap.vehicle.parameters import Car

SETTLED_S = 1.5
EVERY = 5  # steps from one look at the estimate to the next


@dataclass(frozen=True, slots=True)
class Outcome:
    """Errors of one estimator over all seeds."""

    rmse_rad: float
    sd_rad: float
    nees: float
    spread_rad: float


def outcome(
    name: str,
    car: Car,
    config: EstimatorConfig,
    drives: list[Simulated],
    *,
    with_nees: bool = False,
    field: str = "sideslip_rad",
) -> Outcome:
    """RMSE of a field (side-slip) over all drives, mean stated variance (as a root), mean NEES."""
    state = ("sideslip_rad", "yaw_rate_radps", "heading_rad", "lateral_offset_m").index(field)
    errors, variances, nees = [], [], []
    for drive in drives:
        skip = round(SETTLED_S / config.step_s)

        def weigh(
            row: int, estimator: Estimator, drive: Simulated = drive, skip: int = skip
        ) -> None:
            if with_nees and row >= skip and row % 50 == 0:
                error = estimator.estimate().mean[:4] - drive.truth[row]
                nees.append(error @ np.linalg.solve(estimator.covariance(), error) / 4.0)

        played = play(make_estimator(name, car, config), drive.log, every=EVERY, observe=weigh)
        late = slice(skip // EVERY, None)
        truth = drive.truth[::EVERY, state]
        errors.append((played.column(field) - truth)[late])
        variances.append(np.mean(played.sd_of(field)[late] ** 2))
    each = np.sqrt(np.mean(np.square(errors), axis=1))
    return Outcome(
        float(np.sqrt(np.mean(np.square(errors)))),
        float(np.sqrt(np.mean(variances))),
        float(np.mean(nees)) if nees else float("nan"),
        float(np.std(each, ddof=1)) if len(each) > 1 else 0.0,
    )


def sideslip_curves(
    names: dict[str, str], car: Car, config: EstimatorConfig, drive: Simulated
) -> tuple[Curve, ...]:
    """True side-slip of a drive, and that of the estimators that `names` gives labels to."""
    stamps = drive.log.stamp_s[::EVERY]
    curves = [Curve("truth", stamps, drive.truth[::EVERY, 0])]
    for name, label in names.items():
        played = play(make_estimator(name, car, config), drive.log, every=EVERY)
        curves.append(Curve(label, stamps, played.column("sideslip_rad")))
    return tuple(curves)
