"""All estimators by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import (
    CAMERA,
    GPS,
    LATERAL_ACCELERATION,
    WHEEL_SPEED,
    YAW_RATE,
    Estimator,
)
from polemap.electric.estimators.bicycle import BicycleKalman
from polemap.electric.estimators.compensated import CompensatedKalman
from polemap.electric.estimators.kinematic import KinematicKalman
from polemap.electric.estimators.late_camera import (
    CloneKalman,
    MeasurementReconstructionKalman,
    ReconstructionKalman,
    UnevenDelayKalman,
)
from polemap.electric.estimators.linear_observer import LinearObserver
from polemap.electric.estimators.nonlinear import NonlinearKalman
from polemap.electric.estimators.replay import MultiRateKalman, ReplayKalman
from polemap.electric.estimators.single_rate import SingleRateKalman
from polemap.electric.estimators.stiffness import StiffnessKalman
from polemap.electric.estimators.two_layer import Delay, TwoLayerKalman
from polemap.plugins import ESTIMATORS as ESTIMATOR_PLUGINS
from polemap.plugins import load_plugins, short
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.parameters import Car


@dataclass(frozen=True, slots=True)
class Entry:
    """An estimator: what it is, the kinds of measurement it needs, and how it is made.

    `late` are the kinds of which any one is enough, where there are several.
    """

    summary: str
    needs: tuple[str, ...]
    make: Callable[[Car, EstimatorConfig], Estimator]
    late: tuple[str, ...] = ()


ESTIMATORS: dict[str, Entry] = {
    "bicycle": Entry("single-track Kalman filter on the gyro", (YAW_RATE,), BicycleKalman),
    "linear_observer": Entry(
        "linear observer on yaw rate and lateral acceleration",
        (YAW_RATE, LATERAL_ACCELERATION),
        LinearObserver,
    ),
    "kinematic": Entry(
        "accelerations integrated, wheel speed measured", (YAW_RATE, WHEEL_SPEED), KinematicKalman
    ),
    "single_rate": Entry(
        "camera and gyro at the camera's rate, one frame late (W12, W14)",
        (YAW_RATE, CAMERA),
        SingleRateKalman,
        (CAMERA,),
    ),
    "multi_rate": Entry(
        "camera and gyro, no inter-sample compensation, delay assumed constant (W12, W14)",
        (YAW_RATE, CAMERA),
        MultiRateKalman,
        (CAMERA,),
    ),
    "compensated": Entry(
        "inter-sample residual compensation, scheduled steady gains (W14)",
        (YAW_RATE, CAMERA),
        CompensatedKalman,
        (CAMERA,),
    ),
    "uneven_compensated": Entry(
        "residual against the stored state, propagated to the next picture (W13's proposal)",
        (YAW_RATE, CAMERA),
        lambda car, config: CompensatedKalman(car, config, until_arrival=True),
        (CAMERA,),
    ),
    "uneven_delay": Entry(
        "residual against the stored state (W13, corrected)",
        (YAW_RATE, CAMERA),
        UnevenDelayKalman,
        (CAMERA,),
    ),
    "reconstruction": Entry(
        "gain of the capture carried to now (Larsen)",
        (YAW_RATE, CAMERA),
        ReconstructionKalman,
        (CAMERA,),
    ),
    "measurement_reconstruction": Entry(
        "late picture carried to now and measured there (N13, for the camera)",
        (YAW_RATE, CAMERA),
        MeasurementReconstructionKalman,
        (CAMERA,),
    ),
    "clones": Entry("exact for late pictures, clones", (YAW_RATE, CAMERA), CloneKalman, (CAMERA,)),
    "replay": Entry("exact for late pictures, replay", (YAW_RATE, CAMERA), ReplayKalman, (CAMERA,)),
    "stiffness": Entry(
        "extended: tyre stiffness estimated too (camera or GPS)",
        (YAW_RATE,),
        StiffnessKalman,
        (CAMERA, GPS),
    ),
    "nonlinear": Entry(
        "extended: brush tyres, disturbances and sensor biases (accelerometer, GPS if there)",
        (YAW_RATE,),
        NonlinearKalman,
    ),
    "two_layer": Entry(
        "GPS in two layers, delay exact (N13)", (YAW_RATE, GPS), TwoLayerKalman, (GPS,)
    ),
    "two_layer_reconstructed": Entry(
        "GPS in two layers, measurement reconstruction (N13)",
        (YAW_RATE, GPS),
        lambda car, config: TwoLayerKalman(car, config, Delay.RECONSTRUCTED),
        (GPS,),
    ),
    "two_layer_ignored": Entry(
        "GPS in two layers, delay ignored (comparison)",
        (YAW_RATE, GPS),
        lambda car, config: TwoLayerKalman(car, config, Delay.IGNORED),
        (GPS,),
    ),
}


def known_estimators() -> dict[str, Entry]:
    """Ours, and those of installed packages; one that cannot be used is warned of."""
    found = load_plugins(ESTIMATOR_PLUGINS, ("summary", "needs", "make"), frozenset(ESTIMATORS))
    return ESTIMATORS | dict(found)


def make_estimator(name: str, car: Car, config: EstimatorConfig) -> Estimator:
    """An estimator by name.

    Raises:
        VehicleError: no such name, or a plug-in that fails.
    """
    if name in ESTIMATORS:
        return ESTIMATORS[name].make(car, config)
    known = known_estimators()
    if name not in known:
        raise VehicleError(f"no estimator {name}; known are {', '.join(known)}")
    try:
        return known[name].make(car, config)
    except Exception as error:
        raise VehicleError(f"estimator plug-in {name} fails ({short(error)})") from error
