"""What one look at the mapped poles allows along a route, for its band and its picture."""

from __future__ import annotations

from dataclasses import dataclass

from polemap.drivelog.errors import ConfigError
from polemap.evaluation.localizability import (
    Localizability,
    camera_sensor,
    drive_sensor,
    localizability,
)
from polemap.evaluation.results import RouteResult
from polemap.localize.particle_filter.pole_weigher import default_view
from polemap.tools.report.sweep_spec import settings_of

STEP_M = 4.0
# What a car knows without any pole: a wide prior keeps the bound finite, and a single pole useful.
PRIOR_SD = (10.0, 0.2)
# focal length in pixels and baseline in metres, where the drive does not say what it sees with
DEFAULT_CAMERA = (800.0, 0.5)


@dataclass(frozen=True, slots=True)
class RouteBound:
    """Bounds along a route's first recording, how far is seen, and whose errors were taken."""

    bound: Localizability
    range_m: float
    errors_of: str


def route_bound(result: RouteResult) -> RouteBound | None:
    """None where there is no map, or the settings of the run are of another version."""
    recording, poles = result.route.recordings[0], result.route.pole_map
    if poles is None or len(poles) == 0:
        return None
    try:
        settings = settings_of(recording.main.config, ())
    except ConfigError:
        return None
    detection, p_detection = settings.polemap.detection, settings.localize.p_detection
    drive = recording.drive
    sensor = drive_sensor(drive, detection, p_detection) if drive is not None else None
    errors_of = "the drive's own sensor"
    if sensor is None:
        errors_of = "a camera of {} px and {} m".format(*DEFAULT_CAMERA)
        view = default_view(settings.localize.poles)
        sensor = camera_sensor(view, *DEFAULT_CAMERA, p_detection)
    bound = localizability(poles, recording.guide.poses, sensor, step_m=STEP_M, prior_sd=PRIOR_SD)
    return RouteBound(bound, float(sensor.view.free_range_m.max()), errors_of)
