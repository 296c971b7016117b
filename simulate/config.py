"""Settings of the simulator: cameras, sensors, latencies, faults; the world is the scenario's."""

from __future__ import annotations

from math import pi, tan
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from polemap.simulate.faults import Fault
from polemap.stereo.rig import Mounting, StereoRig

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]


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

    Image noise is given in electrons: `full_well_e` at the white level sets the shot noise. Light
    that an exposure of `largest_exposure` cannot gather is made up by gain, noise included.
    `calibration_error_deg` is the standard deviation about each axis: the rectified pairs of KITTI
    are 0.2 to 0.3 px out of true vertically, colour and grey.
    Without a frame rate the scenario's is used.
    """

    preset: Literal["paper", "kitti"] = "paper"
    width_px: int = Field(default=768, ge=32, le=4096)
    height_px: int = Field(default=480, ge=32, le=4096)
    focal_px: Positive = 384.0 / tan(25.0 * pi / 180.0)
    baseline_m: Positive = 0.30
    mount_x_m: float = 1.9
    mount_y_m: float = 0.15
    mount_z_m: Positive = 1.3
    mount_pitch_rad: float = 0.0
    frame_rate_hz: Positive | None = None
    bits: Literal[8, 12] = 8
    tone_exponent: Annotated[float, Field(gt=0.3, le=1.0)] = 0.9
    target_level: Annotated[float, Field(gt=0.02, lt=0.9)] = 0.36
    exposure_wander: NotNegative = 0.12
    full_well_e: Positive = 8000.0
    read_noise_e: NotNegative = 9.0
    fixed_pattern: NotNegative = 0.006
    blur_px: NotNegative = 0.55
    vignetting: Share = 0.18
    right_gain_sd: NotNegative = 0.06
    right_offset_sd: NotNegative = 0.006
    calibration_error_deg: NotNegative = 0.02
    largest_exposure: Positive = 6.0

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

    edge_rays: int = Field(default=2, ge=0, le=8)
    shadows: bool = True
    shadow_rays: bool = False
    workers: int = Field(default=0, ge=0, le=64)
    truth_images: bool = False


class OdometryConfig(_Section):
    """Wheel odometry and yaw gyro; a scale or bias is drawn once a drive."""

    rate_hz: Positive = 50.0
    speed_scale_sd: NotNegative = 0.006
    speed_noise_sd_mps: NotNegative = 0.03
    tick_m: NotNegative = 0.025
    slip_per_mps2: NotNegative = 0.002
    yaw_bias_sd_radps: NotNegative = 0.003
    yaw_bias_drift_radps_sqrt_s: NotNegative = 0.00004
    yaw_noise_sd_radps: NotNegative = 0.003
    yaw_scale_sd: NotNegative = 0.004
    latency_s: NotNegative = 0.012
    jitter_s: NotNegative = 0.002


class GnssConfig(_Section):
    """A cheap receiver: slowly wandering error, jumps near buildings, outages.

    `multipath_per_min` jumps a minute come beside the highest fronts, fewer beside lower ones and
    none where no house is near.
    """

    rate_hz: Positive = 2.0
    wander_sd_m: NotNegative = 1.8
    wander_time_s: Positive = 60.0
    noise_sd_m: NotNegative = 0.35
    multipath_sd_m: NotNegative = 2.5
    multipath_per_min: NotNegative = 5.0
    multipath_time_s: Positive = 6.0
    outages_per_min: NotNegative = 0.15
    outage_s: Positive = 8.0
    antenna_x_m: float = 0.4
    antenna_y_m: float = 0.0
    latency_s: NotNegative = 0.18
    jitter_s: NotNegative = 0.04


class ReferenceConfig(_Section):
    """The reference system: `good` like a coupled INS, `drifting` like the source paper's."""

    kind: Literal["good", "drifting"] = "good"
    rate_hz: Positive = 50.0
    good_sd_m: NotNegative = 0.02
    good_yaw_sd_rad: NotNegative = 0.0008
    drift_sd_m: NotNegative = 0.8
    drift_time_s: Positive = 120.0
    drift_yaw_sd_rad: NotNegative = 0.004


class LatencyConfig(_Section):
    """When a picture reaches the computer after its exposure, and how many never do."""

    camera_min_s: NotNegative = 0.05
    camera_max_s: NotNegative = 0.15
    camera_jitter_s: NotNegative = 0.008
    camera_drop_share: Share = 0.002


class DetectorConfig(_Section):
    """A pole detector without pictures: misses, clutter, errors of stereo that stay alike.

    Attributes:
        detected_share: of the poles in view, what a scan holds.
        clutter_share: of what a scan holds, what is no pole of the map.
        range_sd_per_m2: standard deviation of the range, times its square.
        bearing_sd_rad: across the line of sight.
        correlated_share: of the variance, what stays with a pole over the drive.
        latency_s: from looking to the scan's arrival.
    """

    rate_hz: Positive = 22.0
    half_view_rad: Annotated[float, Field(gt=0, le=pi)] = 0.44
    range_max_m: Annotated[float, Field(gt=3.0)] = 30.0
    detected_share: Share = 0.75
    clutter_share: Annotated[float, Field(ge=0, lt=1)] = 0.1
    range_sd_per_m2: NotNegative = 0.0008
    bearing_sd_rad: NotNegative = 0.002
    correlated_share: Share = 0.5
    latency_s: NotNegative = 0.1


class SimulateConfig(_Section):
    """Every setting of the simulator."""

    camera: CameraConfig = CameraConfig()
    render: RenderConfig = RenderConfig()
    odometry: OdometryConfig = OdometryConfig()
    gnss: GnssConfig = GnssConfig()
    reference: ReferenceConfig = ReferenceConfig()
    latency: LatencyConfig = LatencyConfig()
    detector: DetectorConfig = DetectorConfig()
    light: Literal["scenario", "dusk", "overcast"] = "scenario"
    faults: tuple[Fault, ...] = ()
