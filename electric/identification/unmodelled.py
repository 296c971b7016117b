"""What tyres do beyond their model, and what that makes of a prediction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.estimators.process_noise import (
    FORCE_FLOOR_MPS2,
    FORCE_SHARE,
    LEAST_SLOPE,
    MOMENT_FLOOR_RADPS2,
    MOMENT_SHARE,
)
from polemap.electric.identification.prediction import HEARD_HZ, Predicted, Rows
from polemap.vehicle.axles import Axles
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import KINEMATIC_SPEED_MPS

Floats = NDArray[np.float64]

# a side-slip that is left to itself at the limit grows for as long as it is not heard; and beyond
# so much of it a row tells nothing any more
_LEAST_RATE_HZ, _LEAST_STABLE, _MOST_SIDESLIP_RAD = 0.5, 0.1, 0.3


def unmodelled_sds(
    car: Car, rows: Rows, predicted: Predicted, *, reference_heard: bool
) -> dict[str, Floats]:
    """Deviation of each channel of a prediction, `(n,)`, by what its tyres' forces do not hold.

    A model errs by a share of the forces that it tells, as `NonlinearKalman` believes it. A force
    `F` that lasts moves the side-slip until the tyres hold it: -A^-1 [F / (m v), M / I] with the
    linear model's A at the state and the gains of what is heard. So a slide, where the tyres hardly
    answer a slip, tells of friction, and hardly of stiffness.

    Args:
        reference_heard: as in `predict_rows`.
    """
    total, front_slope, rear_slope = predicted.tyres.T
    v = np.maximum(rows.speed_mps, KINEMATIC_SPEED_MPS)
    m, inertia, lf, lr = car.mass_kg, car.yaw_inertia_kgm2, car.cg_to_front_m, car.cg_to_rear_m
    front, _, rear, _ = Axles(car).limits(0.0)
    front_slope = np.minimum(front_slope, -LEAST_SLOPE * front)
    rear_slope = np.minimum(rear_slope, -LEAST_SLOPE * rear)
    force = np.hypot(FORCE_FLOOR_MPS2, FORCE_SHARE * total / m)
    moment = np.hypot(MOMENT_FLOOR_RADPS2, MOMENT_SHARE * total * (lf + lr) / inertia)
    turning = (lf * front_slope - lr * rear_slope) / inertia
    a00 = (front_slope + rear_slope) / (m * v) - rows.ax_mps2 / v
    a00 = np.minimum(a00 - HEARD_HZ * reference_heard, -_LEAST_RATE_HZ)
    a01 = turning * inertia / (m * v * v) - 1.0
    a11 = (lf * lf * front_slope + lr * lr * rear_slope) / (inertia * v) - HEARD_HZ
    # a car on the brink of a spin: its own answer has no bound, what is heard gives it one
    det = np.maximum(a00 * a11 - a01 * turning, _LEAST_STABLE * a00 * a11)
    sideslip = np.hypot(a11 * force / v, a01 * moment) / det
    return {
        "sideslip_rad": np.minimum(sideslip, _MOST_SIDESLIP_RAD),
        "yaw_rate_radps": np.hypot(turning * force / v, a00 * moment) / det,
        "ay_mps2": force,
    }
