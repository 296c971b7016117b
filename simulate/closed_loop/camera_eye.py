"""The eye of a car in a closed loop that looks at rendered pictures, in its own time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from time import process_time

import numpy as np
from numpy.typing import NDArray

from polemap.config import PolemapConfig
from polemap.drivelog.camera_motion import planar_step
from polemap.drivelog.detections import Detections
from polemap.drivelog.samples import Image, OdometrySample, StereoFrame
from polemap.electric.control.path import Path
from polemap.perception import PolePerception
from polemap.simulate.closed_loop.taught_street import TaughtStreet
from polemap.simulate.plant import PlantState
from polemap.simulate.studio import Moment, Studio
from polemap.stereo.config import StereoConfig
from polemap.stereo.odometry.camera_odometry import CameraOdometry
from polemap.vehicle.pose import Pose2D

Floats = NDArray[np.float64]

READOUT_S = 0.02
"""From the middle of the exposure to the picture in memory."""
_SHOWN_HEIGHT_M = 2.5


@dataclass(slots=True)
class Timing:
    """What became of the pictures.

    Attributes:
        matching_s, seeing_s, localizing_s: processor time of disparity, of detection and
            tracking, and of the localizer with a scan.
        age_s: from the picture to its pose.
        dropped: pictures that came while another was worked on.
        shown: some of them, with their stamps and the axes `(n, 2, 2)` of the poles seen, px.
    """

    matching_s: list[float] = field(default_factory=list)
    seeing_s: list[float] = field(default_factory=list)
    localizing_s: list[float] = field(default_factory=list)
    age_s: list[float] = field(default_factory=list)
    dropped: int = 0
    shown: list[tuple[float, Image, Floats]] = field(default_factory=list)


class CameraEye:
    """Renders what the camera sees and looks at it with the stack's own perception.

    A picture is worked on when it is read out and the one before is done; else it is dropped.

    Args:
        street: where the car drives.
        studio: of that drive.
        processing_s: time that a picture takes; None for what matching, detection, tracking and
            the localizer take on this machine, one thread, in processor time.
        config: of perception.
        show_every_s: how often a picture is kept to be shown.
        measures_motion: the car's motion is seen by the camera, too (`CameraOdometry`), at no
            other times than the poles.
    """

    def __init__(
        self,
        street: TaughtStreet,
        studio: Studio,
        processing_s: float | None,
        config: PolemapConfig | None = None,
        show_every_s: float = np.inf,
        *,
        measures_motion: bool = False,
    ) -> None:
        self.timing = Timing()
        self._street, self._studio, self._processing_s = street, studio, processing_s
        self._perception = PolePerception(
            studio.renderer.rig, config or PolemapConfig(), stereo=StereoConfig(threads=1)
        )
        self._centre = Path(street.world.route.points_m)
        self._near_m: float | None = None
        self._number = 0
        self._free_s, self._localizing_s = -np.inf, 0.0
        self._waiting: deque[tuple[float, Detections]] = deque()
        self._show_every_s, self._show_s = show_every_s, 0.0
        self.measures_motion = measures_motion
        self._odometry = CameraOdometry(studio.renderer.rig)
        self._last_s: float | None = None
        self._moved: deque[tuple[float, OdometrySample]] = deque()

    def record_odometry(self, sample: OdometrySample) -> None:
        """See `Eye`."""
        self._perception.record_odometry(sample)

    def look(self, now_s: float, rear: Pose2D, state: PlantState) -> None:
        """See `Eye`."""
        number, self._number = self._number, self._number + 1
        came_s = now_s + READOUT_S
        if came_s < self._free_s - 1e-9:
            self.timing.dropped += 1
            return
        left, right = self._picture(number, now_s, rear, state)
        frame = StereoFrame(now_s, came_s, number, left, right)
        begin = process_time()
        moved = self._measure(frame) if self.measures_motion else None
        disparity = self._perception.match(frame)
        between = process_time()
        seen = self._perception.perceive(frame, disparity).scan
        end = process_time()
        self.timing.matching_s.append(between - begin)
        self.timing.seeing_s.append(end - between)
        took = self._processing_s
        if took is None:
            took = end - begin + self._localizing_s
        self._free_s = came_s + took
        self.timing.age_s.append(self._free_s - now_s)
        self._waiting.append((self._free_s, seen))
        if moved is not None:
            self._moved.append((self._free_s, moved))
        if now_s >= self._show_s:
            self._show_s = now_s + self._show_every_s
            self.timing.shown.append((now_s, left, self._axes_px(seen)))

    def scans(self, now_s: float) -> list[Detections]:
        """See `Eye`."""
        seen = []
        while self._waiting and self._waiting[0][0] <= now_s + 1e-9:
            seen.append(replace(self._waiting.popleft()[1], arrival_s=now_s))
        return seen

    def motion(self, now_s: float) -> list[OdometrySample]:
        """See `Eye`."""
        seen = []
        while self._moved and self._moved[0][0] <= now_s + 1e-9:
            seen.append(replace(self._moved.popleft()[1], arrival_s=now_s))
        return seen

    def _measure(self, frame: StereoFrame) -> OdometrySample | None:
        """The motion up to a picture, which the tracks of the poles are told at once."""
        seen = self._odometry.advance(frame.stamp_s, frame.left, frame.right)
        last_s, self._last_s = self._last_s, frame.stamp_s
        if last_s is None or not seen.known:
            return None
        step_s = frame.stamp_s - last_s
        speed, yaw_rate, *_ = planar_step(self._studio.renderer.rig, seen, step_s)
        stamp_s = frame.stamp_s - 0.5 * step_s
        sample = OdometrySample(stamp_s, frame.arrival_s, speed, yaw_rate)
        self._perception.record_odometry(sample)
        return sample

    def localized(self, seconds: float) -> None:
        """See `Eye`: the next picture waits for it, too."""
        self._localizing_s = seconds
        self.timing.localizing_s.append(seconds)

    def _axes_px(self, seen: Detections) -> Floats:
        """Foot and top of the poles of a scan in the left picture."""
        feet = np.column_stack([seen.points_vehicle_m.reshape(-1, 2), np.zeros(len(seen))])
        height = np.where(np.isfinite(seen.height_m), seen.height_m, _SHOWN_HEIGHT_M)
        tops = feet + np.outer(height, [0.0, 0.0, 1.0])
        return self._studio.renderer.rig.project(np.stack([feet, tops], axis=1))[..., :2]

    def _picture(
        self, number: int, now_s: float, rear: Pose2D, state: PlantState
    ) -> tuple[Image, Image]:
        x, y = (np.array(rear[:2]) - self._street.origin_m).tolist()
        foot = self._centre.locate(x, y, rear.yaw_rad, self._near_m)
        self._near_m = foot.station_m
        views = self._studio.views_at(
            Moment(
                now_s,
                np.array([x, y, rear.yaw_rad]),
                foot.lateral_m,
                rear.yaw_rad - foot.heading_rad,
                state.ax_mps2,
                state.vx_mps * state.yaw_rate_radps,
                self._studio.plan.body_rad[number],
            )
        )
        return self._studio.picture(number, views)
