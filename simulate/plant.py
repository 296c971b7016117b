"""The car that controllers are tried on: two tracks, four wheels, load transfer, real actuators.

It is richer than every model in `vehicle/`, so that an estimator or controller that works here
does not work because it is its own mirror. Axes ISO 8855, SI.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import copysign, isfinite

from polemap.drivelog.errors import ConfigError
from polemap.vehicle.motion import velocity_at
from polemap.vehicle.packed import rotate, rotate_back, transform_point
from polemap.vehicle.tyre import brush_force

GRAVITY_MPS2 = 9.81
FRONT_LEFT, FRONT_RIGHT, REAR_LEFT, REAR_RIGHT = range(4)
# slip is taken against at least this speed, so that it stays finite while the car stands
SLIP_SPEED_FLOOR_MPS = 0.3

# friction of the ground below a wheel, from its world position (east, north)
Friction = Callable[[float, float], float]


@dataclass(frozen=True, slots=True)
class PlantParameters:
    """Body, tyres and actuators. Stiffness is per tyre at the load of standstill.

    Raises:
        ConfigError: a length, mass, inertia or stiffness that is not positive.
    """

    mass_kg: float
    yaw_inertia_kgm2: float
    front_m: float
    rear_m: float
    track_m: float
    height_m: float
    wheel_radius_m: float
    wheel_inertia_kgm2: float
    cornering_front_n: float
    cornering_rear_n: float
    slip_stiffness_n: float
    torque_limit_nm: float
    torque_lag_s: float = 0.005
    steer_lag_s: float = 0.03
    steer_limit_rad: float = 0.6
    steer_rate_limit_radps: float = 3.0
    load_lag_s: float = 0.05
    drag_n_per_mps2: float = 0.3
    rolling_coefficient: float = 0.01

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not isfinite(value) or value < 0 or (value == 0 and not _may_vanish(name)):
                raise ConfigError(f"plant {name} is {value}, it must be positive and finite")


def _may_vanish(name: str) -> bool:
    return name.endswith("_lag_s") or name in {
        "height_m",
        "drag_n_per_mps2",
        "rolling_coefficient",
    }


@dataclass(frozen=True, slots=True)
class PlantInput:
    """Commands: front road-wheel angle, a motor torque for each wheel, and a disturbance moment."""

    steer_rad: float = 0.0
    torque_nm: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    disturbance_moment_nm: float = 0.0


@dataclass(frozen=True, slots=True)
class PlantState:
    """Truth at one moment; the pose is that of the centre of gravity."""

    time_s: float = 0.0
    east_m: float = 0.0
    north_m: float = 0.0
    yaw_rad: float = 0.0
    vx_mps: float = 0.0
    vy_mps: float = 0.0
    yaw_rate_radps: float = 0.0
    wheel_radps: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    steer_rad: float = 0.0
    torque_nm: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    ax_mps2: float = 0.0
    ay_mps2: float = 0.0
    load_ax_mps2: float = 0.0
    load_ay_mps2: float = 0.0

    def sideslip_rad(self) -> float:
        """Angle from the body's x axis to its velocity; 0 below walking pace."""
        return self.vy_mps / self.vx_mps if self.vx_mps > 0.5 else 0.0

    def slip_ratio(self, wheel: int, radius_m: float) -> float:
        """(r omega - v) / max(r omega, v) of one wheel, with the hub's speed taken as vx."""
        rim = radius_m * self.wheel_radps[wheel]
        return (rim - self.vx_mps) / max(abs(rim), abs(self.vx_mps), 1e-6)


class Plant:
    """Advances the truth by fixed steps, with sub-steps short enough for the wheels.

    Args:
        parameters: the car.
        friction: the ground, from world position to the coefficient of friction.
        step_s: length of a step.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        friction: Friction = lambda _east, _north: 0.9,
        step_s: float = 0.001,
    ) -> None:
        self.parameters = parameters
        self.friction = friction
        self.step_s = step_s
        half = parameters.track_m / 2.0
        self._hubs = (
            (parameters.front_m, half),
            (parameters.front_m, -half),
            (-parameters.rear_m, half),
            (-parameters.rear_m, -half),
        )

    def rolling(self, speed_mps: float) -> PlantState:
        """A state in which the car rolls straight ahead without slip."""
        spin = speed_mps / self.parameters.wheel_radius_m
        return PlantState(vx_mps=speed_mps, wheel_radps=(spin, spin, spin, spin))

    def wheel_loads_n(self, ax_mps2: float, ay_mps2: float) -> tuple[float, float, float, float]:
        """Vertical loads under quasi-static load transfer; a lifted wheel carries nothing.

        Source: Rajamani, Vehicle Dynamics and Control, 2nd ed., ch. 4 and 15 (rigid roll).
        """
        p = self.parameters
        length = p.front_m + p.rear_m
        pitch = p.mass_kg * ax_mps2 * p.height_m / length
        front = (p.mass_kg * GRAVITY_MPS2 * p.rear_m / length - pitch) / 2.0
        rear = (p.mass_kg * GRAVITY_MPS2 * p.front_m / length + pitch) / 2.0
        roll = p.mass_kg * ay_mps2 * p.height_m / p.track_m
        roll_front, roll_rear = roll * p.rear_m / length, roll * p.front_m / length
        return (
            max(front - roll_front, 0.0),
            max(front + roll_front, 0.0),
            max(rear - roll_rear, 0.0),
            max(rear + roll_rear, 0.0),
        )

    def step(self, state: PlantState, command: PlantInput) -> PlantState:
        """The state one step later, the command held."""
        p = self.parameters
        # the slip of a wheel settles within I v / (C r^2): stay well below it (explicit steps)
        settle = (
            p.wheel_inertia_kgm2
            * max(abs(state.vx_mps), SLIP_SPEED_FLOOR_MPS)
            / (p.slip_stiffness_n * p.wheel_radius_m**2)
        )
        parts = max(1, round(self.step_s / (0.4 * settle) + 0.5))
        for _ in range(parts):
            state = self._advance(state, command, self.step_s / parts)
        return state

    def _advance(self, s: PlantState, command: PlantInput, dt: float) -> PlantState:
        p = self.parameters
        steer = _steer(s.steer_rad, command.steer_rad, p, dt)
        torque = tuple(
            _lag(now, max(-p.torque_limit_nm, min(p.torque_limit_nm, want)), p.torque_lag_s, dt)
            for now, want in zip(s.torque_nm, command.torque_nm, strict=True)
        )
        force_x = force_y = moment = 0.0
        wheels: list[float] = []
        loads = self.wheel_loads_n(s.load_ax_mps2, s.load_ay_mps2)
        standing = self.wheel_loads_n(0.0, 0.0)
        pose = (s.east_m, s.north_m, s.yaw_rad)
        for i, (x, y) in enumerate(self._hubs):
            angle = steer if i < REAR_LEFT else 0.0
            hub = velocity_at(s.vx_mps, s.vy_mps, s.yaw_rate_radps, x, y)
            hub_x, hub_y = rotate_back(*hub, angle)
            rim = p.wheel_radius_m * s.wheel_radps[i]
            base = max(abs(rim), abs(hub_x), SLIP_SPEED_FLOOR_MPS)
            mu = self.friction(*transform_point(pose, x, y))
            share = loads[i] / standing[i]
            cornering = p.cornering_front_n if i < REAR_LEFT else p.cornering_rear_n
            along, across = brush_force(
                (rim - hub_x) / base,
                hub_y / base,
                p.slip_stiffness_n * share,
                cornering * share,
                mu * loads[i],
            )
            body_x, body_y = rotate(along, across, angle)
            force_x += body_x
            force_y += body_y
            moment += x * body_y - y * body_x
            rolling = copysign(p.rolling_coefficient * loads[i] * p.wheel_radius_m, rim)
            spin_up = torque[i] - along * p.wheel_radius_m - (rolling if abs(rim) > 0.05 else 0.0)
            wheels.append(s.wheel_radps[i] + dt * spin_up / p.wheel_inertia_kgm2)
        force_x -= p.drag_n_per_mps2 * s.vx_mps * abs(s.vx_mps)
        ax, ay = force_x / p.mass_kg, force_y / p.mass_kg
        yaw_acceleration = (moment + command.disturbance_moment_nm) / p.yaw_inertia_kgm2
        yaw_rate = s.yaw_rate_radps + dt * yaw_acceleration
        vx = s.vx_mps + dt * (ax + s.vy_mps * yaw_rate)
        vy = s.vy_mps + dt * (ay - s.vx_mps * yaw_rate)
        east_mps, north_mps = rotate(vx, vy, s.yaw_rad)
        return PlantState(
            time_s=s.time_s + dt,
            east_m=s.east_m + dt * east_mps,
            north_m=s.north_m + dt * north_mps,
            yaw_rad=s.yaw_rad + dt * yaw_rate,
            vx_mps=vx,
            vy_mps=vy,
            yaw_rate_radps=yaw_rate,
            wheel_radps=(wheels[0], wheels[1], wheels[2], wheels[3]),
            steer_rad=steer,
            torque_nm=(torque[0], torque[1], torque[2], torque[3]),
            ax_mps2=ax,
            ay_mps2=ay,
            load_ax_mps2=_lag(s.load_ax_mps2, ax, p.load_lag_s, dt),
            load_ay_mps2=_lag(s.load_ay_mps2, ay, p.load_lag_s, dt),
        )


def _lag(now: float, want: float, lag_s: float, dt: float) -> float:
    """First-order lag, exact enough for dt well below it and a pass-through at zero lag."""
    return want if lag_s <= dt else now + (want - now) * dt / lag_s


def _steer(now: float, want: float, p: PlantParameters, dt: float) -> float:
    wanted = max(-p.steer_limit_rad, min(p.steer_limit_rad, want))
    step = _lag(now, wanted, p.steer_lag_s, dt) - now
    limit = p.steer_rate_limit_radps * dt
    return now + max(-limit, min(limit, step))


def patches(
    default: float, strips: list[tuple[float, float, float]], *, split: bool = False
) -> Friction:
    """Friction that jumps on strips of the road `(from_m, to_m, friction)` along east.

    With `split` a strip covers only the half of the road at negative north (the right wheels of a
    car that drives east).
    """

    def friction(east_m: float, north_m: float) -> float:
        for begin, end, value in strips:
            if begin <= east_m < end and (not split or north_m < 0.0):
                return value
        return default

    return friction
