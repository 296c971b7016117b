"""Settings of the simulator: cameras, sensors, faults; the world is the scenario's."""

from __future__ import annotations

from math import pi
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from polemap.simulate.camera_mounting import CameraConfig
from polemap.simulate.faults import Fault


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class RenderConfig(_Section):
    """Quality of the pictures against time."""

    shadows: bool = Field(True, description="Whether the sun casts shadows.")
    shadow_rays: bool = Field(
        False, description="Shadows by a ray a pixel: sharper than a shadow map, and slower."
    )
    workers: int = Field(0, ge=0, le=64, description="Processes; 0 for one a core.")
    truth_images: bool = Field(False, description="Write true disparities and object ids, too.")


class OdometryConfig(_Section):
    """Wheel odometry and yaw gyro; a scale or bias is drawn once a drive.

    Ticks, slip, drift and scale of the gyro are `sensors.WheelErrors`.
    """

    rate_hz: float = Field(50.0, gt=0.0, description="Samples a second, Hz.")
    speed_scale_sd: float = Field(0.006, ge=0.0, description="Relative error of the speed, sd.")
    speed_noise_sd_mps: float = Field(
        0.03, ge=0.0, description="White noise of the speed while rolling, sd, m/s."
    )
    yaw_bias_sd_radps: float = Field(0.003, ge=0.0, description="Bias of the gyro, sd, rad/s.")
    yaw_noise_sd_radps: float = Field(
        0.003, ge=0.0, description="White noise of the gyro, sd, rad/s."
    )
    latency_s: float = Field(
        0.012, ge=0.0, description="From measuring to arrival, s; jitter comes on top of it."
    )


class GnssConfig(_Section):
    """A cheap receiver: slowly wandering error, jumps near buildings, outages.

    How long these last is `sensors.ReceiverErrors`.
    """

    rate_hz: float = Field(2.0, gt=0.0, description="Fixes a second, Hz.")
    wander_sd_m: float = Field(
        1.8, ge=0.0, description="Error that wanders slowly, sd in each axis, m."
    )
    multipath_per_min: float = Field(
        5.0,
        ge=0.0,
        description="Jumps a minute beside the highest fronts; fewer beside lower ones, none where"
        " no house is near.",
    )
    outages_per_min: float = Field(0.15, ge=0.0, description="Outages a minute.")
    antenna_x_m: float = Field(0.4, description="Antenna ahead of the rear axle, m.")
    antenna_y_m: float = Field(0.0, description="Antenna left of the middle, m.")
    latency_s: float = Field(
        0.18, ge=0.0, description="From measuring to arrival, s; jitter comes on top of it."
    )


class ReferenceConfig(_Section):
    """The reference system."""

    kind: Literal["good", "drifting"] = Field(
        "good", description="good is a coupled INS, drifting the source paper's."
    )


class DetectorConfig(_Section):
    """A pole detector without pictures: misses, clutter, errors of stereo that stay alike."""

    rate_hz: float = Field(22.0, gt=0.0, description="Scans a second, Hz.")
    half_view_rad: float = Field(
        0.44, gt=0.0, le=pi, description="Half the horizontal field of view, rad."
    )
    range_max_m: float = Field(30.0, gt=3.0, description="Farthest pole seen, m.")
    detected_share: float = Field(
        0.75, ge=0.0, le=1.0, description="Of the poles in view, the share that a scan holds."
    )
    clutter_share: float = Field(
        0.1, ge=0.0, lt=1.0, description="Of what a scan holds, the share that is no pole."
    )
    range_sd_per_m2: float = Field(
        0.0008, ge=0.0, description="Error of the range over its square, sd, 1/m."
    )
    bearing_sd_rad: float = Field(
        0.002, ge=0.0, description="Error across the line of sight, sd, rad."
    )
    correlated_share: float = Field(
        0.5, ge=0.0, le=1.0, description="Share of the variance that stays with a pole."
    )
    latency_s: float = Field(0.1, ge=0.0, description="From looking to the scan's arrival, s.")


class LineDetectorConfig(_Section):
    """A detector of markings and kerbs: straight pieces of a few metres with stated errors."""

    range_max_m: float = Field(20.0, gt=4.0, description="Farthest piece seen, ahead, m.")
    piece_m: float = Field(6.0, gt=1.0, description="Longest piece, m.")
    detected_share: float = Field(
        0.7, ge=0.0, le=1.0, description="Of the pieces in view, the share that a scan holds."
    )
    clutter_per_scan: float = Field(
        0.3, ge=0.0, description="Pieces a scan that are no line: shadows, seams."
    )
    offset_sd_m: float = Field(0.05, gt=0.0, description="Error across a piece, sd, m.")
    offset_sd_per_m: float = Field(
        0.004, ge=0.0, description="What is added to it, in squares, per metre of distance, sd."
    )
    frame_share: float = Field(
        0.3, ge=0.0, le=1.0, description="Share of its variance that all pieces of a scan have."
    )
    lasting_share: float = Field(
        0.2, ge=0.0, le=1.0, description="Share that they have, and that lasts, too."
    )
    lasting_s: float = Field(10.0, gt=0.0, description="For how long it lasts, s.")
    direction_sd_rad: float = Field(0.01, gt=0.0, description="Error of the direction, sd, rad.")

    @model_validator(mode="after")
    def _shares_leave_room(self) -> LineDetectorConfig:
        if self.frame_share + self.lasting_share > 1.0:
            raise ValueError("frame_share and lasting_share are more than 1 together")
        return self


class CornerDetectorConfig(_Section):
    """A detector of corners of houses, beside that of poles and with its field of view."""

    range_max_m: float = Field(25.0, gt=3.0, description="Farthest corner seen, m.")
    detected_share: float = Field(
        0.5, ge=0.0, le=1.0, description="Of the corners in view, the share that a scan holds."
    )
    clutter_share: float = Field(
        0.2, ge=0.0, lt=1.0, description="Of what a scan holds, the share that is no corner."
    )
    range_sd_per_m2: float = Field(
        0.001, ge=0.0, description="Error of the range over its square, sd, 1/m."
    )
    bearing_sd_rad: float = Field(
        0.003, ge=0.0, description="Error across the line of sight, sd, rad."
    )
    correlated_share: float = Field(
        0.5, ge=0.0, le=1.0, description="Share of the variance that stays with a corner."
    )
    facing_sd_rad: float = Field(0.1, ge=0.0, description="Error of the free side, sd, rad.")


class SimulateConfig(_Section):
    """Every setting of the simulator."""

    camera: CameraConfig = CameraConfig()
    render: RenderConfig = RenderConfig()
    odometry: OdometryConfig = OdometryConfig()
    gnss: GnssConfig = GnssConfig()
    reference: ReferenceConfig = ReferenceConfig()
    detector: DetectorConfig = DetectorConfig()
    further_kinds: tuple[Literal["lines", "corners"], ...] = Field(
        (), description="What scans hold beside poles, as in [lines, corners]."
    )
    line_detector: LineDetectorConfig = LineDetectorConfig()
    corner_detector: CornerDetectorConfig = CornerDetectorConfig()
    light: Literal["scenario", "dusk", "overcast"] = Field(
        "scenario", description="Time of day and weather; scenario is what the scenario says."
    )
    faults: tuple[Fault, ...] = Field(
        (), description="Faults to lay over the drive, one after the other; see faults.py."
    )
