"""A run as a recording for rerun (.rrd), or straight into its viewer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.errors import OutputError
from polemap.drivelog.writers.trajectory import counts_from_1970
from polemap.extras import need
from polemap.tools.recording.scene import HEIGHT_M, WIDTH_M, Scene
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

_MESSAGE_MAX = 280
TIMELINE = "drive_time"
_COLOURS = {"kf": (47, 126, 216), "pf": (139, 188, 33), "reference": (150, 150, 150)}
_MAPPED, _SEEN, _CAR = (255, 153, 51), (77, 217, 64), (51, 128, 230)
_CAR_HALF_M = (2.25, 0.9, 0.75)
_AXLE_TO_MIDDLE_M = 1.35


def write_rerun(scene: Scene, path: Path, advance: Callable[[int], None] | None = None) -> None:
    """Write a run as .rrd with the views that show it.

    Args:
        advance: called with 1 after every picture.

    Raises:
        InputError: an image that cannot be read.
        OutputError: the recording cannot be written.
        MissingExtraError: rerun is not installed.
    """
    rerun: Any = need("rerun")
    with atomic_file(path) as part:
        recording = rerun.RecordingStream("polemap")
        try:
            recording.save(str(part), default_blueprint=_views(scene))
            _log(scene, recording, advance)
            recording.flush()
            recording.disconnect()
        except RuntimeError as error:
            # rerun's own, of a full disk say
            raise OutputError(f"{path}: cannot be written ({error})"[:_MESSAGE_MAX]) from error


def show_in_viewer(scene: Scene, advance: Callable[[int], None] | None = None) -> None:
    """Start rerun's viewer and send the run to it.

    Raises:
        InputError: an image that cannot be read.
        MissingExtraError: rerun is not installed.
    """
    rerun: Any = need("rerun")
    recording = rerun.RecordingStream("polemap")
    recording.spawn(default_blueprint=_views(scene))
    _log(scene, recording, advance)
    recording.flush()


def _views(scene: Scene) -> Any:
    views: Any = need("rerun.blueprint")
    above = views.Spatial3DView(origin="/map", name="from above")
    left = [above]
    if scene.pictures is not None:
        left.insert(0, views.Spatial2DView(origin="/camera", name="left picture"))
    plots = [
        views.TimeSeriesView(origin=f"/{name}", name=title)
        for name, title in (
            ("poles", "poles matched and seen"),
            ("accuracy", "stated position sd (m)"),
            ("motion", "speed (m/s), yaw rate (rad/s)"),
            ("health", "healthy (1) or not (0)"),
        )
    ]
    return views.Blueprint(
        views.Horizontal(views.Vertical(*left), views.Vertical(*plots), column_shares=[3, 2])
    )


def _log(scene: Scene, recording: Any, advance: Callable[[int], None] | None) -> None:
    rerun: Any = need("rerun")
    _still(scene, recording, rerun)
    _moving(scene, recording, rerun)
    _scans_and_pictures(scene, recording, rerun, advance)


def _still(scene: Scene, recording: Any, rerun: Any) -> None:
    recording.log("map", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for name, path in scene.paths.items():
        line = np.column_stack([path.poses[:, :2], np.zeros(len(path))])
        strip = rerun.LineStrips3D([line], colors=[_COLOURS[name]], radii=0.08)
        recording.log(f"map/path/{name}", strip, static=True)
    if scene.poles is not None:
        poles = scene.poles
        lines = _uprights(poles.points_m, poles.height_m)
        drawn = rerun.LineStrips3D(lines, colors=[_MAPPED], radii=0.5 * poles.width_m)
        recording.log("map/poles", drawn, static=True)
    recording.log(
        "map/car/body",
        rerun.Boxes3D(
            half_sizes=[_CAR_HALF_M],
            centers=[(_AXLE_TO_MIDDLE_M, 0.0, _CAR_HALF_M[2])],
            colors=[_CAR],
        ),
        static=True,
    )
    east, north = scene.origin_m
    text = f"{scene.name}, {scene.frame}; drawn from the origin {east:.0f} east, {north:.0f} north"
    recording.log("about", rerun.TextDocument(text), static=True)


def _moving(scene: Scene, recording: Any, rerun: Any) -> None:
    kf = scene.kf
    times = _times(kf.stamp_s, rerun)
    half = 0.5 * kf.poses[:, 2]
    zero = np.zeros(len(kf))
    recording.send_columns(
        "map/car",
        [times],
        rerun.Transform3D.columns(
            translation=np.column_stack([kf.poses[:, :2], zero]),
            quaternion=np.column_stack([zero, zero, np.sin(half), np.cos(half)]),
        ),
    )
    for place, name in (
        ("motion/speed_mps", "speed_mps"),
        ("motion/yaw_rate_radps", "yaw_rate_radps"),
        ("health/output", "healthy"),
    ):
        _series(kf, scene.kf_beside.get(name), place, recording, rerun)
    for place, name in (
        ("poles/matched", "matched"),
        ("poles/seen", "seen"),
        ("accuracy/position_sd_m", "position_sd_major_m"),
        ("health/particle_filter", "healthy"),
    ):
        _series(scene.pf, scene.pf_beside.get(name), place, recording, rerun)


def _series(of: Trajectory, values: Any, place: str, recording: Any, rerun: Any) -> None:
    if not isinstance(values, np.ndarray):
        return
    known = np.isfinite(values)
    if known.any():
        recording.send_columns(
            place, [_times(of.stamp_s[known], rerun)], rerun.Scalars.columns(scalars=values[known])
        )


def _scans_and_pictures(
    scene: Scene, recording: Any, rerun: Any, advance: Callable[[int], None] | None
) -> None:
    dated = counts_from_1970(scene.kf.stamp_s)

    def at(stamp_s: float) -> None:
        recording.set_time(TIMELINE, **{"timestamp" if dated else "duration": stamp_s})

    for scan in scene.scans:
        at(scan.stamp_s)
        width = np.where(np.isfinite(scan.width_m), scan.width_m, WIDTH_M)
        height = np.where(np.isfinite(scan.height_m), scan.height_m, HEIGHT_M)
        lines = _uprights(scan.points_vehicle_m, height)
        drawn = rerun.LineStrips3D(lines, colors=[_SEEN] * len(lines), radii=0.75 * width)
        recording.log("map/car/seen", drawn)
    if scene.pictures is None:
        return
    for picture in scene.pictures():
        at(picture.stamp_s)
        recording.log(
            "camera/left", rerun.EncodedImage(contents=picture.jpeg, media_type="image/jpeg")
        )
        for name, lines_px, colour in (
            ("mapped", picture.mapped_px, _MAPPED),
            ("seen", picture.seen_px, _SEEN),
        ):
            recording.log(
                f"camera/left/{name}",
                rerun.LineStrips2D(list(lines_px), colors=[colour] * len(lines_px), radii=1.5),
            )
        if advance is not None:
            advance(1)


def _uprights(points_m: Floats, height_m: Floats) -> Floats:
    """Poles `(n, 2)` as lines `(n, 2, 3)`."""
    feet = np.column_stack([points_m, np.zeros(len(points_m))])
    tops = np.column_stack([points_m, height_m])
    return np.stack([feet, tops], axis=1)


def _times(stamps_s: Floats, rerun: Any) -> Any:
    if counts_from_1970(stamps_s):
        return rerun.TimeColumn(TIMELINE, timestamp=stamps_s)
    return rerun.TimeColumn(TIMELINE, duration=stamps_s)
