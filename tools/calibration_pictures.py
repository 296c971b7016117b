"""Pictures of a calibration: rows of the pair, the road under the camera, speeds and turns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.calibration.ground import on_road
from polemap.calibration.result import Calibration
from polemap.drivelog.drive import Drive
from polemap.drivelog.plausibility.features import to_8_bit
from polemap.drivelog.plausibility.odometer import of_reference
from polemap.extras import check_installed
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import make_matcher
from polemap.stereo.rig import Mounting, StereoRig

Floats = NDArray[np.float64]


def write_pictures(drive: Drive, found: Calibration, config: StereoConfig, folder: Path) -> None:
    """Writes rows.png, road.png and odometry.png, as far as there is something to show.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    check_installed("matplotlib")
    if found.rows is not None:
        _rows(drive, found, folder / "rows.png")
    if any(plane is not None for plane in found.planes):
        _road(drive, found, config, folder / "road.png")
    if found.odometry and drive.odometry is not None:
        _odometry(drive, found, folder / "odometry.png")


def _figure(width: float, height: float) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


def _rows(drive: Drive, found: Calibration, path: Path) -> None:
    """Vertical disparity over a picture, parts of it in colour."""
    if found.rows is None or drive.rig is None:
        return
    rig, grid = drive.rig, found.rows.grid_px
    figure, axes = _figure(9.0, 9.0 * rig.height_px / rig.width_px + 0.9)
    frame = drive.read_frame(found.plane_rows[len(found.plane_rows) // 2])
    axes.imshow(to_8_bit(frame.left), cmap="gray", vmin=0, vmax=255)
    limit = max(0.5, float(np.nanmax(np.abs(grid))))
    extent = (-0.5, rig.width_px - 0.5, rig.height_px - 0.5, -0.5)
    shown = axes.imshow(
        grid, cmap="RdBu", vmin=-limit, vmax=limit, alpha=0.55, extent=extent, aspect="auto"
    )
    tall, wide = grid.shape
    for (i, j), value in np.ndenumerate(grid):
        text = "none" if np.isnan(value) else f"{value:+.2f}"
        place = (j + 0.5) * rig.width_px / wide, (i + 0.5) * rig.height_px / tall
        axes.text(*place, text, ha="center", va="center", fontsize=10)
    axes.set_axis_off()
    axes.set_title(
        f"{drive.name}: by how many rows the right picture stands lower "
        f"({found.rows.matches} features)", fontsize=10,
    )  # fmt: skip
    figure.colorbar(shown, ax=axes, label="px", shrink=0.8)
    figure.savefig(path)


def _road(drive: Drive, found: Calibration, config: StereoConfig, path: Path) -> None:
    """The pixels that agree with the road's plane, and both horizons."""
    if drive.rig is None:
        return
    rig = drive.rig
    seen = [k for k, plane in enumerate(found.planes) if plane is not None]
    k = seen[len(seen) // 2]
    plane = found.planes[k]
    if plane is None:
        return
    frame = drive.read_frame(found.plane_rows[k])
    disparity = make_matcher(config, rig).match(frame.left, frame.right).left
    road = on_road(disparity, rig, plane)
    figure, axes = _figure(9.0, 9.0 * rig.height_px / rig.width_px + 0.6)
    colour = np.repeat(to_8_bit(frame.left)[..., None], 3, axis=2)
    colour[road] = (0.5 * colour[road] + 0.5 * np.array([40, 200, 60])).astype(np.uint8)
    axes.imshow(colour)
    stated = rig.vehicle_from_camera
    for mount, style, name in (
        (stated, "--", "horizon as stated"), (found.mounting(stated), "-", "horizon as found"),
    ):  # fmt: skip
        columns = np.array([0.0, rig.width_px - 1.0])
        axes.plot(columns, _horizon(rig, mount, columns), style, lw=1.5, label=name)
    axes.set_xlim(-0.5, rig.width_px - 0.5)
    axes.set_ylim(rig.height_px - 0.5, -0.5)
    axes.set_axis_off()
    axes.legend(loc="upper right", fontsize=8)
    axes.set_title(
        f"{drive.name}, frame {frame.index}: pixels on the road's plane; camera "
        f"{plane.height_m:.3f} m above it in this frame", fontsize=10,
    )  # fmt: skip
    figure.savefig(path)


def _horizon(rig: StereoRig, mount: Mounting, columns: Floats) -> Floats:
    """Rows `(n,)` in which a level direction is seen."""
    down = -mount.rotation()[2]
    x = (columns - rig.cx_px) / rig.focal_px
    return np.asarray(rig.cy_px - rig.focal_px * (down[0] * x + down[2]) / down[1])


def _odometry(drive: Drive, found: Calibration, path: Path) -> None:
    """Speed and turn rate of odometry and witnesses over the first two minutes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    odometry, best = drive.odometry, found.odometry[0]
    if odometry is None:
        return
    figure = Figure(figsize=(9.0, 5.0), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, sharex=True)
    start = float(odometry.stamp_s[0])
    delay = best.delay_s if np.isfinite(best.delay_s) else 0.0
    for axes, values in ((upper, odometry.speed_mps), (lower, np.degrees(odometry.yaw_rate_radps))):
        axes.plot(odometry.stamp_s - start, values, lw=0.8, color="0.7", label="odometry as it is")
    corrected = odometry.stamp_s - start - delay
    upper.plot(corrected, odometry.speed_mps / best.speed_scale, lw=0.8, label="corrected")
    lower.plot(corrected, np.degrees(odometry.yaw_rate_radps), lw=0.8, label="corrected")
    if found.steps is not None and len(found.steps) and drive.rig is not None:
        steps = found.steps
        moved, turn = steps.in_vehicle(found.mounting(drive.rig.vehicle_from_camera))
        span, middle = steps.to_s - steps.from_s, 0.5 * (steps.from_s + steps.to_s) - start
        upper.plot(middle, np.hypot(moved[:, 0], moved[:, 1]) / span, ".", ms=3, label="camera")
        lower.plot(middle, np.degrees(turn / span), ".", ms=3, label="camera")
    if drive.reference is not None and len(drive.reference) > 2:
        witness = of_reference(drive.reference)
        stamps = np.arange(witness.stamp_s[0], witness.stamp_s[-1] - 0.2, 0.2)
        way, turn, known = witness.spans(stamps, stamps + 0.2)
        upper.plot(stamps[known] + 0.1 - start, way[known] / 0.2, lw=1.0, label="reference")
        lower.plot(stamps[known] + 0.1 - start, np.degrees(turn[known] / 0.2), lw=1.0,
                   label="reference")  # fmt: skip
    upper.set_xlim(0.0, min(120.0, float(odometry.stamp_s[-1]) - start))
    upper.set_ylabel("speed, m/s")
    lower.set_ylabel("turn rate, degrees/s")
    lower.set_xlabel(f"seconds from stamp {start:.3f}")
    upper.legend(fontsize=8, ncols=4, loc="best")
    upper.set_title(
        f"{drive.name}: odometry against {best.against}: scale {best.speed_scale:.4f}, delay "
        + (f"{best.delay_s:.3f} s" if np.isfinite(best.delay_s) else "unknown"), fontsize=10,
    )  # fmt: skip
    figure.savefig(path)
