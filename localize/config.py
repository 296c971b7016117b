"""Settings of the localizer: the paper's parameters by their names, and groups for the rest.

What no user should turn stands as a named constant beside the code that uses it.
"""

from __future__ import annotations

from math import pi
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from polemap.drivelog.errors import ConfigError
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.localize.output_filter.config import OutputConfig
from polemap.vehicle.parameters import Car

# between the cars of vehicle/cars: 0.0052 a RAV4, 0.0057 the identified 250 LM, 0.0076 a Passat
ANY_SLIP_RAD_PER_MPS2 = 0.006
# three degrees at 1 m/s^2: no tyre on a road is so soft
SLIP_MAX_RAD_PER_MPS2 = 0.05

KindName = Literal["pole", "corner", "lane_marking", "kerb", "facade"]

_FROZEN = ConfigDict(frozen=True, extra="forbid")


class KldConfig(BaseModel):
    """KLD sampling: a number of particles that follows how far they spread (Fox 2003)."""

    model_config = _FROZEN

    adaptive: bool = Field(False, description="Choose the number of particles after every scan.")
    particles_min: int = Field(50, ge=10, le=100_000, description="Fewest particles.")
    particles_max: int = Field(2000, ge=10, le=100_000, description="Most particles.")

    @model_validator(mode="after")
    def _ordered(self) -> KldConfig:
        if self.particles_min > self.particles_max:
            raise ValueError(
                f"particles_min {self.particles_min} is above particles_max {self.particles_max}"
            )
        return self


class OdometryConfig(BaseModel):
    """What the odometry gets wrong, and whether that is learned on the way."""

    model_config = _FROZEN

    learn_offsets: bool = Field(
        True, description="Learn the offsets and scales of speed and yaw rate from the poles."
    )
    learn_from_poses: bool = Field(
        True, description="Off: only the yaw rate's offset is learned, where the car stands (S16)."
    )
    learn_noise: bool = Field(
        True, description="Scale the motion noise to what the poles' corrections show."
    )
    yaw_rate_offset_sd_radps: float = Field(
        0.005, ge=0.0, le=0.1, description="Offset of the yaw rate before it is learned, sd, rad/s."
    )
    speed_scale_sd: float = Field(
        0.02, ge=0.0, le=0.5, description="Relative error of the speed before it is learned, sd."
    )
    slip_rad_per_mps2: float | None = Field(
        None,
        ge=0.0,
        le=SLIP_MAX_RAD_PER_MPS2,
        description="Outward slip of the rear axle per lateral acceleration, rad per m/s^2. Left "
        "out it is m l_f / (2 C_r l) of the car that the drive names, 0.006 where it names none.",
    )
    slip_sd_rad_per_mps2: float = Field(
        0.0015,
        ge=0.0,
        le=SLIP_MAX_RAD_PER_MPS2,
        description="How the slip differs from car to car, sd: every particle guesses its own. "
        "Those of vehicle/cars lie within 1.1 of it.",
    )
    faults: bool = Field(
        True,
        description="Some particles hold the odometry for wrong, the more the harder the car "
        "drives; off: none (S16).",
    )
    doubts: bool = Field(
        True,
        description="Odometry that is silent, or that itself, poles or fixes contradict, is not "
        "followed; off: it always is (S16).",
    )

    @property
    def rear_slip_rad_per_mps2(self) -> float:
        """The setting, or what any car has."""
        return ANY_SLIP_RAD_PER_MPS2 if self.slip_rad_per_mps2 is None else self.slip_rad_per_mps2


class PolesConfig(BaseModel):
    """How seen poles relate to those of the map, beyond the paper's parameters."""

    model_config = _FROZEN

    width_sd_m: float = Field(
        0.15, gt=0.0, le=5.0, description="Seen width less mapped width, standard deviation, m."
    )
    position_floor_m: float = Field(
        0.03,
        ge=0.0,
        le=2.0,
        description="Standard deviation added to every seen position, m: calibration, and trunks "
        "that are no lines.",
    )
    correlation_m: float = Field(
        2.0, gt=0.0, le=100.0, description="Way over which errors of seen poles stay alike, m."
    )
    correlation_s: float = Field(
        1.0, gt=0.0, le=100.0, description="Time over which errors of seen poles stay alike, s."
    )
    scan_errors: Literal["shared", "independent"] = Field(
        "shared",
        description="Shared: of a scan's likelihood the share counts that the two settings above "
        "call new. Independent: every scan counts in full, equation (8) as printed.",
    )
    effective_share_min: float = Field(
        0.03,
        ge=0.0,
        le=0.5,
        description="Share of the particles that must stay effective; where a scan would leave "
        "fewer, less of it counts. 0: it always counts in full (S16).",
    )
    map_covariance: bool = Field(
        True,
        description="Mapped poles are as uncertain as the map says; off: they are exact, equation "
        "(7) as printed.",
    )
    existence: bool = Field(
        True,
        description="Seen and mapped poles count by the probability that they exist; off: all do.",
    )
    view_range_m: float = Field(
        25.0, gt=0.0, le=500.0, description="Range of a sensor that does not say where it looks, m."
    )
    view_half_angle_rad: float = Field(
        pi / 3, gt=0.0, le=pi, description="Half the opening angle of such a sensor, rad."
    )


class GnssConfig(BaseModel):
    """The receiver, for both filters."""

    model_config = _FROZEN

    sd_m: float = Field(
        2.5,
        gt=0.0,
        le=1000.0,
        description="Standard deviation of a fix at HDOP 1, an axis, m.",
    )
    correlation_s: float = Field(
        60.0, ge=0.0, le=3600.0, description="Time over which the receiver's error wanders, s."
    )
    outlier_share: float = Field(
        0.1, gt=0.0, lt=1.0, description="Share of fixes that may be wrong altogether."
    )
    particles: bool = Field(
        True, description="Fixes weigh the particles; off: they only start them (S16)."
    )
    output: bool = Field(
        True,
        description="Fixes start and bound the output filter; off: poses and odometry alone (S16).",
    )


class RecoveryConfig(BaseModel):
    """When the filter looks elsewhere or starts anew."""

    model_config = _FROZEN

    lost_sd_m: float = Field(
        15.0, gt=0.0, le=1000.0, description="A particle set wider than this starts anew, m (S16)."
    )
    lost_after_s: float = Field(
        3.0, gt=0.0, le=600.0, description="How long too few poles, or no fix, may fit, s."
    )
    restart: Literal["evidence", "spread"] = Field(
        "evidence",
        description="Evidence: poles that do not fit, fixes far away and a better place also start "
        "the filter anew, and send particles around. Spread: `lost_sd_m` alone (S16).",
    )
    places: Literal["constellations", "gnss"] = Field(
        "constellations",
        description="Where particles start and explore: where the poles of the last metres fit, or "
        "around the fixes alone (S16).",
    )
    exploration: Literal["bounded", "classic"] = Field(
        "bounded",
        description="Bounded: a fifth of the particles at most, once the likelihood is well below "
        "its long-term average, weighed by the scan. Classic: Augmented MCL, a share of one less "
        "the ratio of the two, weighed as the others.",
    )


class HealthConfig(BaseModel):
    """When a pose may be used."""

    model_config = _FROZEN

    sd_max_m: float = Field(
        1.0,
        gt=0.0,
        le=100.0,
        description="Largest major position sd of a healthy pose, m: a pose that may be more than "
        "3 m off is of no use.",
    )


class LocalizeConfig(BaseModel):
    """Every setting of the localizer; the names of the paper where it has one.

    The noise figures `alpha1 ... alpha4` are standard deviations for one odometry step of 20 ms,
    the paper's 50 Hz; for other steps they are scaled so that the spread per second stays.

    Source: Spangenberg (2016), section IV.
    """

    model_config = _FROZEN

    particles: int = Field(1000, ge=10, le=100_000, description="Number of particles.")
    threads: int = Field(1, ge=1, le=64, description="Threads that weigh the particles.")
    p_detection: float = Field(
        0.7, gt=0.0, lt=1.0, description="Chance that a map pole in view is detected."
    )
    beta_p: float = Field(
        1.0, gt=0.0, le=100.0, description="Weight of the position term, equation (7)."
    )
    clutter_per_m2: float = Field(
        1e-3, gt=0.0, le=10.0, description="False poles per square metre of ground."
    )
    alpha1_speed_mps: float = Field(
        0.2, ge=0.0, le=20.0, description="Noise of the speed, sd, m/s in a step of 20 ms."
    )
    alpha1_relative: float = Field(
        0.07, ge=0.0, le=2.0, description="Noise of the speed in proportion to it, sd."
    )
    alpha2_yaw_rate_radps: float = Field(
        0.03, ge=0.0, le=5.0, description="Noise of the yaw rate, sd, rad/s in a step of 20 ms."
    )
    alpha3_rotation_s: float = Field(
        0.01, ge=0.0, le=5.0, description="Additional turn in proportion to the yaw rate, sd, s."
    )
    alpha4_rotation_rad: float = Field(
        0.003, ge=0.0, le=1.0, description="Largest additional turn of a step, sd, rad."
    )
    alpha5_slip_m_per_sqrt_m: float = Field(
        0.015,
        ge=0.0,
        le=1.0,
        description="Drift aside of the heading, sd, m per square root of a metre driven; not in "
        "the paper.",
    )
    tight_turn_factor: float = Field(
        1.4,
        ge=0.0,
        le=20.0,
        description="Additional turn where the car turns on 5 m, in that of alpha3 and without "
        "the bound of alpha4; not in the paper.",
    )
    kinds: tuple[KindName, ...] | None = Field(
        None,
        min_length=1,
        description="Landmarks that count: pole, corner, lane_marking, kerb, facade. Left out: all "
        "that the map holds.",
    )
    estimate: Literal["mean", "best_mode"] = Field(
        "best_mode", description="The pose: mean of all particles, or of their heaviest mode."
    )
    covariance: Literal["lasting_errors", "particles"] = Field(
        "lasting_errors",
        description="Of the pose: no less than what errors that last leave unknown, or that of "
        "the particles (S16).",
    )
    kld: KldConfig = KldConfig()
    odometry: OdometryConfig = OdometryConfig()
    poles: PolesConfig = PolesConfig()
    gnss: GnssConfig = GnssConfig()
    recovery: RecoveryConfig = RecoveryConfig()
    health: HealthConfig = HealthConfig()
    output: OutputConfig = OutputConfig()

    @property
    def chosen_kinds(self) -> frozenset[LandmarkKind]:
        """Of `kinds`; all where they are left out."""
        names = [kind.name.lower() for kind in LandmarkKind] if self.kinds is None else self.kinds
        return frozenset(LandmarkKind[name.upper()] for name in names)


def for_car(config: LocalizeConfig, car: Car | None) -> LocalizeConfig:
    """The settings with what was left open told by a car file, or by what any car has.

    Raises:
        ConfigError: a car whose rear axle slips as no tyre does.
    """
    if config.odometry.slip_rad_per_mps2 is not None:
        return config
    slip = ANY_SLIP_RAD_PER_MPS2 if car is None else car.rear_slip_rad_per_mps2
    if car is not None and slip > SLIP_MAX_RAD_PER_MPS2:
        raise ConfigError(
            f"car {car.name}: its rear axle slips {slip:.3f} rad per m/s^2, m l_f / (2 C_r l); "
            f"{SLIP_MAX_RAD_PER_MPS2} at most. rear_stiffness_nprad is of one tyre, in N/rad"
        )
    odometry = config.odometry.model_copy(update={"slip_rad_per_mps2": slip})
    return config.model_copy(update={"odometry": odometry})
