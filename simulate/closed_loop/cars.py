"""The plant of a car: its single-track parameters, and the body that a single track lacks."""

from __future__ import annotations

from dataclasses import dataclass, replace

from polemap.drivelog.errors import ConfigError
from polemap.simulate.plant import PlantParameters
from polemap.vehicle.parameters import Car


@dataclass(frozen=True, slots=True)
class Body:
    """What the plant needs beyond a `Car`.

    The defaults are a one-seat electric car's. Height, wheel inertia and slip stiffness are
    assumptions: no source prints them.
    """

    height_m: float = 0.4
    wheel_inertia_kgm2: float = 0.5
    slip_stiffness_n: float = 9000.0
    torque_lag_s: float = 0.005


PASSENGER_CAR = Body(0.55, 1.0, 80_000.0, 0.05)
"""Typical of a middle-class car whose torque comes from an engine and brakes; an assumption."""


def plant_of(car: Car, body: Body | None = None) -> PlantParameters:
    """The plant of a car with motors in its rear wheels.

    Raises:
        ConfigError: track, wheel radius or motor torque of the car are not known.
    """
    for name in ("rear_track_m", "wheel_radius_m", "motor_torque_limit_nm"):
        if getattr(car, name) <= 0.0:
            raise ConfigError(
                f"car {car.name}: {name} is not known; a closed loop needs it, add it to the car's "
                "file or take coms"
            )
    b = body or Body()
    return PlantParameters(
        mass_kg=car.mass_kg,
        yaw_inertia_kgm2=car.yaw_inertia_kgm2,
        front_m=car.cg_to_front_m,
        rear_m=car.cg_to_rear_m,
        track_m=car.rear_track_m,
        height_m=b.height_m,
        wheel_radius_m=car.wheel_radius_m,
        wheel_inertia_kgm2=b.wheel_inertia_kgm2,
        cornering_front_n=car.front_stiffness_nprad,
        cornering_rear_n=car.rear_stiffness_nprad,
        slip_stiffness_n=b.slip_stiffness_n,
        torque_limit_nm=car.motor_torque_limit_nm,
        torque_lag_s=b.torque_lag_s,
    )


def with_stiffness(car: Car, per_tyre_nprad: float) -> Car:
    """The car on other tyres, front and rear alike."""
    return replace(car, front_stiffness_nprad=per_tyre_nprad, rear_stiffness_nprad=per_tyre_nprad)
