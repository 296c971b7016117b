"""The mapping of topics to a drive: what `info --write-mapping` writes and `--topics` reads."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from polemap.drivelog.readers.drive_yaml_parts import AntennaPart, MountingPart

_Finite = Field(allow_inf_nan=False)
Topic = Annotated[str, Field(min_length=1, max_length=400)]

# factor to metres a second or radians a second
SPEED_UNITS = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "kn": 1852 / 3600}
TURN_UNITS = {
    "rad/s": 1.0,
    "deg/s": 0.017453292519943295,
    "rev/s": 6.283185307179586,
    "rev/min": 0.10471975511965977,
}
_UNITS = (*SPEED_UNITS, *TURN_UNITS)


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Mounting(MountingPart):
    """The left camera in the vehicle frame."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Antenna(AntennaPart):
    """The antenna in the vehicle frame."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class VehiclePart(_Part):
    """The car, and where its rear axle is in the frame that TF calls the car."""

    wheelbase_m: float | None = Field(None, gt=0.3, lt=20.0)
    base_frame: str | None = Field(None, min_length=1, max_length=200)
    rear_axle_x_m: float = Field(0.0, ge=-20.0, le=20.0)
    base_above_ground_m: float | None = Field(None, ge=-5.0, le=5.0)


class CameraSide(_Part):
    """One camera: its pictures and its calibration."""

    image: Topic
    info: Topic | None = None


class CameraPart(_Part):
    """The stereo pair.

    Attributes:
        rectified: whether the pictures are; None to tell it from calibration and names.
        baseline_m: where the calibrations do not say it.
        pair_tolerance_s: how far apart the stamps of left and right may be; None for half a
            frame, 5 ms at most.
    """

    left: CameraSide
    right: CameraSide
    rectified: bool | None = None
    baseline_m: float | None = Field(None, gt=0.0, lt=10.0)
    pair_tolerance_s: float | None = Field(None, ge=0.0, le=1.0)
    vehicle_from_camera: Mounting | None = None

    @model_validator(mode="after")
    def _two_cameras(self) -> CameraPart:
        if self.left.image == self.right.image:
            raise ValueError(f"left and right are one topic, {self.left.image[:60]}")
        return self


class Signal(_Part):
    """Where a number comes from.

    Attributes:
        topic: its topic.
        fields: dotted paths in the message; the mean of several. Not needed for the usual types.
        unit: of the numbers; rad/s, deg/s, rev/s and rev/min of a speed are those of a wheel.
        scale: multiplies them; -1 turns the sign.
    """

    topic: Topic
    fields: tuple[Annotated[str, Field(min_length=1, max_length=200)], ...] = Field(
        (), max_length=8
    )
    unit: str | None = None
    scale: float = Field(1.0, allow_inf_nan=False)

    @model_validator(mode="after")
    def _known(self) -> Signal:
        if self.unit is not None and self.unit not in _UNITS:
            raise ValueError(f"unit '{self.unit[:20]}' is unknown; known are {', '.join(_UNITS)}")
        if self.scale == 0.0:
            raise ValueError("scale is 0, every value would be")
        return self


class OdometryPart(_Part):
    """Speed and yaw rate, from one topic or from several.

    Attributes:
        right_wheel: the right wheel of an axle that is not steered, where `speed` is the left one:
            the speed is their mean.
        track_m: between these wheels; their difference is the yaw rate then.
    """

    speed: Signal
    right_wheel: Signal | None = None
    track_m: float | None = Field(None, gt=0.3, lt=5.0)
    yaw_rate: Signal | None = None
    wheel_radius_m: float | None = Field(None, gt=0.05, lt=2.0)

    @model_validator(mode="after")
    def _two_wheels(self) -> OdometryPart:
        right = self.right_wheel
        if right is None and self.track_m is not None:
            raise ValueError("track_m needs right_wheel, the topic of the other wheel")
        if self.track_m is not None and self.yaw_rate is not None:
            raise ValueError("track_m and yaw_rate both give the yaw rate; drop one of them")
        if right is not None and self.track_m is None and self.yaw_rate is None:
            raise ValueError("right_wheel needs track_m, or yaw_rate from another topic")
        if right is not None and right.topic == self.speed.topic:
            raise ValueError("speed and right_wheel are one topic; give both numbers as fields")
        return self

    @model_validator(mode="after")
    def _wheels_have_a_radius(self) -> OdometryPart:
        for signal in (self.speed, self.right_wheel):
            if signal is not None and signal.unit in TURN_UNITS and self.wheel_radius_m is None:
                raise ValueError(f"a speed in {signal.unit} needs wheel_radius_m")
        if self.yaw_rate is not None and self.yaw_rate.unit in SPEED_UNITS:
            raise ValueError(f"a yaw rate is not in {self.yaw_rate.unit}")
        return self


class GnssPart(_Part):
    """The receiver; `antenna` in the vehicle frame where TF lacks it."""

    topic: Topic
    antenna: Antenna | None = None


class OriginPart(_Part):
    """Pose of the local frame of reference poses in the drive's earth frame."""

    east_m: float = _Finite
    north_m: float = _Finite
    yaw_rad: float = Field(0.0, allow_inf_nan=False)


class ReferencePart(_Part):
    """Poses that are taken as true; `frame` is what they are poses of, where TF knows it."""

    topic: Topic
    frame: str | None = None
    sd_m: float | None = Field(None, gt=0.0, allow_inf_nan=False)
    origin: OriginPart | None = None


class FramePart(_Part):
    """Earth frame of fixes and reference."""

    kind: Literal["utm", "local"]
    epsg: int | None = None
    name: str | None = Field(None, min_length=1, max_length=200)


class LapPart(_Part):
    """A named part of the recording, in seconds of its stamps."""

    name: str = Field(min_length=1, max_length=200)
    start_s: float = _Finite
    end_s: float = _Finite

    @model_validator(mode="after")
    def _ends_after_it_starts(self) -> LapPart:
        if self.end_s <= self.start_s:
            raise ValueError(f"lap '{self.name[:60]}' ends before it starts; exchange the two")
        return self


class Mapping(_Part):
    """All of a mapping; a part that is left out is guessed, one that is null is not used."""

    format_version: Literal[1] = 1
    frame: FramePart | None = None
    vehicle: VehiclePart = VehiclePart()
    camera: CameraPart | None = None
    odometry: OdometryPart | None = None
    gnss: GnssPart | None = None
    reference: ReferencePart | None = None
    laps: tuple[LapPart, ...] = Field((), max_length=10_000)

    @model_validator(mode="after")
    def _laps_have_names_of_their_own(self) -> Mapping:
        names = [lap.name for lap in self.laps]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"laps: two are called '{twice[:60]}'; rename one")
        return self

    def fields(self) -> dict[str, tuple[str, ...]]:
        """Further fields that one pass has to keep, by topic."""
        if self.odometry is None:
            return {}
        found: dict[str, tuple[str, ...]] = {}
        part = self.odometry
        for signal in (part.speed, part.right_wheel, part.yaw_rate):
            if signal is not None and signal.fields:
                known = found.get(signal.topic, ())
                found[signal.topic] = (*known, *(f for f in signal.fields if f not in known))
        return found
