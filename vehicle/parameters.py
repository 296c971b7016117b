"""What the models need to know of a car."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import isfinite

from polemap.vehicle.errors import VehicleError


@dataclass(frozen=True, slots=True)
class Car:
    """Parameters of a single-track car; stiffness is per *tyre*, two tyres an axle.

    Attributes:
        name: what the command line calls it.
        source: where the figures come from; a parameter without a source is a guess.
        mass_kg: total mass.
        yaw_inertia_kgm2: about the vertical axis through the centre of gravity.
        cg_to_front_m: centre of gravity to front axle.
        cg_to_rear_m: centre of gravity to rear axle.
        front_stiffness_nprad: cornering stiffness of one front tyre.
        rear_stiffness_nprad: cornering stiffness of one rear tyre.
        preview_m: how far ahead of the centre of gravity the camera reads the lateral offset.
        steering_offset_rad: road-wheel angle that the sensor shows when the car runs straight.
        steering_scale: road-wheel angle over what the sensor shows beyond that.
        steering_delay_s: how much later the wheels turn than the sensor shows.
        sideslip_point_m: how far ahead of the centre of gravity the side-slip reference sits.
        gps_point_m: how far ahead of the centre of gravity the GPS antenna sits.
        rear_track_m: distance of the rear wheels; 0 if unknown.
        wheel_radius_m: 0 if unknown.
        steering_ratio: steering-wheel angle over road-wheel angle; 0 if unknown.
        motor_torque_limit_nm: of one in-wheel motor; 0 if there is none.
        front_slip_stiffness_nprad: cornering stiffness of one front tyre at no slip; 0: as
            `front_stiffness_nprad`, which linear models use, and which is less where a car was
            driven hard. This and the next six are of nonlinear models, and the defaults are a
            passenger car's.
        rear_slip_stiffness_nprad: the same of one rear tyre.
        front_friction: largest lateral force of the front tyres over their load.
        rear_friction: the same of the rear tyres.
        cg_height_m: centre of gravity above the road; with ax it shifts load between the axles.
        front_drive_share: share of the driving force on the front axle, 0 to 1.
        front_brake_share: share of the braking force on the front axle, 0 to 1.
    """

    name: str
    source: str
    mass_kg: float
    yaw_inertia_kgm2: float
    cg_to_front_m: float
    cg_to_rear_m: float
    front_stiffness_nprad: float
    rear_stiffness_nprad: float
    preview_m: float = 0.0
    steering_offset_rad: float = 0.0
    sideslip_point_m: float = 0.0
    gps_point_m: float = 0.0
    rear_track_m: float = 0.0
    wheel_radius_m: float = 0.0
    steering_ratio: float = 0.0
    motor_torque_limit_nm: float = 0.0
    steering_scale: float = 1.0
    steering_delay_s: float = 0.0
    front_slip_stiffness_nprad: float = 0.0
    rear_slip_stiffness_nprad: float = 0.0
    front_friction: float = 1.0
    rear_friction: float = 1.0
    cg_height_m: float = 0.5
    front_drive_share: float = 0.5
    front_brake_share: float = 0.6

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name in ("name", "source"):
                if not isinstance(value, str) or not value.strip():
                    raise VehicleError(f"car: {item.name} is {value!r}, a text is needed")
                continue
            if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
                raise VehicleError(f"car {self.name}: {item.name} is {value!r}, not a number")
        for name in POSITIVE:
            if getattr(self, name) <= 0.0:
                raise VehicleError(
                    f"car {self.name}: {name} is {getattr(self, name)}, it must be positive"
                )
        for name in SHARES:
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise VehicleError(
                    f"car {self.name}: {name} is {getattr(self, name)}, it must lie in 0 to 1"
                )
        if abs(self.steering_delay_s) > STEERING_DELAY_MAX_S:
            raise VehicleError(
                f"car {self.name}: steering_delay_s is {self.steering_delay_s}, it must lie within "
                f"{STEERING_DELAY_MAX_S:g} s of 0"
            )

    @property
    def wheelbase_m(self) -> float:
        """Rear axle to front axle."""
        return self.cg_to_front_m + self.cg_to_rear_m

    @property
    def front_slip_rad_per_mps2(self) -> float:
        """Slip angle of the front tyres per lateral acceleration: m lr / (2 Cf l).

        Source: the axles' shares of m a_y in a steady bend, W14 (1).
        """
        return (
            self.mass_kg * self.cg_to_rear_m / (2.0 * self.front_stiffness_nprad * self.wheelbase_m)
        )

    @property
    def rear_slip_rad_per_mps2(self) -> float:
        """Outward slip angle of the rear axle per lateral acceleration: m lf / (2 Cr l).

        In a steady bend the rear axle goes in the direction yaw - k a_y: what arcs of the rear
        axle need beside speed and yaw rate.
        """
        return (
            self.mass_kg * self.cg_to_front_m / (2.0 * self.rear_stiffness_nprad * self.wheelbase_m)
        )

    @property
    def understeer_s2pm(self) -> float:
        """K of `steering angle = (l + K v^2) curvature` in a steady bend, positive: understeer."""
        front, rear = 2 * self.front_stiffness_nprad, 2 * self.rear_stiffness_nprad
        moment = self.cg_to_rear_m * rear - self.cg_to_front_m * front
        return self.mass_kg * moment / (front * rear * self.wheelbase_m)

    def scaled(self, *, stiffness: float = 1.0, mass: float = 1.0) -> Car:
        """The same car with all tyres `stiffness` times as stiff and `mass` times as heavy.

        The radius of gyration stays, so the yaw inertia follows the mass.
        """
        return replace(
            self,
            front_slip_stiffness_nprad=self.front_slip_stiffness_nprad * stiffness,
            rear_slip_stiffness_nprad=self.rear_slip_stiffness_nprad * stiffness,
            mass_kg=self.mass_kg * mass,
            yaw_inertia_kgm2=self.yaw_inertia_kgm2 * mass,
            front_stiffness_nprad=self.front_stiffness_nprad * stiffness,
            rear_stiffness_nprad=self.rear_stiffness_nprad * stiffness,
        )


POSITIVE = (
    "mass_kg",
    "yaw_inertia_kgm2",
    "cg_to_front_m",
    "cg_to_rear_m",
    "front_stiffness_nprad",
    "rear_stiffness_nprad",
    "front_friction",
    "rear_friction",
    "cg_height_m",
    "steering_scale",
)
STEERING_DELAY_MAX_S = 1.0
SHARES = ("front_drive_share", "front_brake_share")
