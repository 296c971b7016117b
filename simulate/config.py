"""Settings of the simulator: cameras, sensors, latencies, faults; the world is the scenario's."""

from __future__ import annotations

from math import pi, tan
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from polemap.simulate.faults import Fault
from polemap.stereo.rig import Mounting, StereoRig

# rectified grey cameras; focal length and baseline from calib.txt of the odometry sequences
KITTI_GEOMETRY: dict[str, float] = {
    "width_px": 1241,
    "height_px": 376,
    "focal_px": 718.856,
    "baseline_m": 0.537,
    "mount_x_m": 1.03,
    "mount_y_m": 0.06,
    "mount_z_m": 1.65,
    "frame_rate_hz": 10.0,
}


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class CameraConfig(_Section):
    """The stereo camera; the default is the source paper's, `preset: kitti` that of KITTI.

    How its pictures look (noise, optics, exposure) is in `simulate/camera.py`.
    """

    preset: Literal["paper", "kitti"] = Field(
        "paper", description="Whose geometry stands for what is not said: kitti is KITTI's."
    )
    width_px: int = Field(768, ge=32, le=4096, description="Width of a picture, px.")
    height_px: int = Field(480, ge=32, le=4096, description="Height of a picture, px.")
    focal_px: float = Field(
        384.0 / tan(25.0 * pi / 180.0), gt=0.0, description="Rectified focal length, px."
    )
    baseline_m: float = Field(0.30, gt=0.0, description="Between the two cameras, m.")
    mount_x_m: float = Field(1.9, description="Left camera ahead of the rear axle, m.")
    mount_y_m: float = Field(0.15, description="Left camera left of the middle, m.")
    mount_z_m: float = Field(1.3, gt=0.0, description="Cameras above the ground, m.")
    mount_pitch_rad: float = Field(0.0, description="Nose down positive, rad.")
    frame_rate_hz: float | None = Field(
        None, gt=0.0, description="Pairs a second, Hz; without it the scenario's."
    )
    bits: Literal[8, 12] = Field(8, description="Bits of a pixel.")
    calibration_error_deg: float = Field(
        0.02,
        ge=0.0,
        le=5.0,
        description="Error of the rectification about each axis, sd, degrees; KITTI's pairs, colour"
        " and grey, are 0.2 to 0.3 px out of true vertically.",
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, values: Any) -> Any:
        """A preset gives what is not said."""
        if isinstance(values, dict) and values.get("preset") == "kitti":
            return KITTI_GEOMETRY | values
        return values

    def rig(self) -> StereoRig:
        """The rig that the written drive claims to have."""
        return StereoRig(
            self.width_px,
            self.height_px,
            self.focal_px,
            (self.width_px - 1) / 2,
            (self.height_px - 1) / 2,
            self.baseline_m,
            Mounting(
                self.mount_x_m, self.mount_y_m, self.mount_z_m, 0.0, self.mount_pitch_rad, 0.0
            ),
        )


def kitti_camera(**changes: object) -> CameraConfig:
    """The camera with KITTI's geometry, changed where `changes` say so."""
    return CameraConfig.model_validate({"preset": "kitti"} | changes)


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
    rate_hz: float = Field(50.0, gt=0.0, description="Poses a second, Hz.")


class LatencyConfig(_Section):
    """When a picture reaches the computer after its exposure, and how many never do."""

    camera_min_s: float = Field(0.05, ge=0.0, description="Least mean latency of a drive, s.")
    camera_max_s: float = Field(0.15, ge=0.0, description="Largest mean latency of a drive, s.")
    camera_drop_share: float = Field(
        0.002, ge=0.0, le=1.0, description="Share of pictures that never arrive."
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


class SimulateConfig(_Section):
    """Every setting of the simulator."""

    camera: CameraConfig = CameraConfig()
    render: RenderConfig = RenderConfig()
    odometry: OdometryConfig = OdometryConfig()
    gnss: GnssConfig = GnssConfig()
    reference: ReferenceConfig = ReferenceConfig()
    latency: LatencyConfig = LatencyConfig()
    detector: DetectorConfig = DetectorConfig()
    light: Literal["scenario", "dusk", "overcast"] = Field(
        "scenario", description="Time of day and weather; scenario is what the scenario says."
    )
    faults: tuple[Fault, ...] = Field(
        (), description="Faults to lay over the drive, one after the other; see faults.py."
    )
