"""Which estimator a closed loop takes, with what sensors and settings."""

from __future__ import annotations

from polemap.drivelog.errors import ConfigError
from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import CAMERA, GPS, Estimator
from polemap.electric.estimators.registry import ESTIMATORS, make_estimator
from polemap.electric.studies.scenes import GPS_NOISE, MISMATCH
from polemap.vehicle.parameters import Car

LATE = (CAMERA, GPS)
TRUTH, NONE = "true state", "no control"
"""What closes a loop, or leaves it open, where no estimator does."""
_ANY = Car("any", "names of fields", 1000.0, 1000.0, 1.0, 1.0, 50_000.0, 50_000.0)

COURSE_NOISE = GPS_NOISE.model_copy(update={"gps_slots": 4})
"""For cars with GPS: N13's study, with room for values that overtake the next capture."""
REJECTING_NOISE = COURSE_NOISE.model_copy(
    update={"sideslip_disturbance_radps": 0.3, "yaw_disturbance_radps2": 5.0}
)
"""For rejection: disturbances as large as 30 % of stiffness makes them at 0.1 rad of steering,
2 dC delta / (m V) = 0.28 rad/s and 2 dC lf delta / I = 3.5 rad/s^2."""
CAMERA_NOISE = MISMATCH.model_copy(update={"gps_slots": 4, "course_sd_rad": 0.003})
"""For cars before a lane: the study of a wrong model."""


def kinds_for(name: str, there: tuple[str, ...]) -> tuple[str, ...] | None:
    """The late sensors of `there` that an estimator takes; None if it lacks one that it needs.

    One that can do with any of several gets the first.
    """
    entry = ESTIMATORS[name]
    needed = [kind for kind in entry.needs if kind in LATE]
    if any(kind not in there for kind in needed):
        return None
    if needed or not entry.late:
        return tuple(needed)
    found = [kind for kind in entry.late if kind in there]
    return (found[0],) if found else None


def fresh(name: str, car: Car, config: EstimatorConfig) -> Estimator:
    """A new estimator by name, before its first step."""
    return make_estimator(name, car, config)


def behind(
    name: str, car: Car, config: EstimatorConfig, there: tuple[str, ...]
) -> tuple[Estimator | None, tuple[str, ...]]:
    """What a controller sees through, and its late sensors of `there`; TRUTH and NONE need none."""
    if name in (TRUTH, NONE):
        return None, ()
    return fresh(name, car, config), kinds_for(name, there) or ()


def choose(
    study: str, chosen: tuple[str, ...], usual: tuple[str, ...], there: tuple[str, ...], field: str
) -> tuple[str, ...]:
    """The estimators of a study: those that were asked for, or the usual ones.

    Raises:
        ConfigError: one is unknown, lacks a sensor in this scene, or does not give the field.
    """
    able = [
        name
        for name in ESTIMATORS
        if kinds_for(name, there) is not None
        and field in ESTIMATORS[name].make(_ANY, COURSE_NOISE).fields
    ]
    for name in chosen:
        if name not in able:
            raise ConfigError(f"{study}: estimator {name} cannot serve here; {', '.join(able)} can")
    return chosen or usual
