"""What a scenario file may say: the street, what stands beside it, light, traffic, the drive."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from polemap.drivelog.errors import ConfigError, InputError
from polemap.parsing.errors import named
from polemap.parsing.text import read_text
from polemap.parsing.yaml_text import LARGEST_BYTES, parse_yaml

# from the rear axle's path to the kerb: half a car and a hand's breadth
_BESIDE_AXLE_M = 1.1
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Side = Literal["left", "right", "both"]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class RouteSpec(_Part):
    """The centre line: corners in local metres joined by arcs."""

    corners_m: list[tuple[float, float]] = Field(min_length=2)
    corner_radius_m: Positive = 14.0
    closed: bool = False


class PavingSpec(_Part):
    """A stretch of the road with another surface."""

    from_m: NotNegative
    to_m: Positive
    surface: str = "cobble"


class SideStreetSpec(_Part):
    """A street that joins from the side; houses, walls and furniture leave its mouth free."""

    at_m: NotNegative
    side: Literal["left", "right"] = "right"
    width_m: Positive = 6.0
    length_m: Positive = 45.0


class SectionSpec(_Part):
    """The cross-section, mirrored about the centre line unless a median is asked for."""

    road_half_width_m: Positive = 3.3
    crossfall: Annotated[float, Field(ge=-0.08, le=0.08)] = 0.022
    surface: str = "asphalt"
    gutter: bool = True
    parking_width_m: NotNegative = 0.0
    parking_surface: str = "cobble"
    kerb_height_m: Annotated[float, Field(ge=0, le=0.3)] = 0.11
    verge_width_m: NotNegative = 0.0
    verge_surface: str = "grass"
    sidewalk_width_m: NotNegative = 1.9
    sidewalk_surface: str = "slabs"
    border_width_m: NotNegative = 6.0
    border_surface: str = "grass"
    median_width_m: NotNegative = 0.0
    paving: list[PavingSpec] = Field(default_factory=list)
    centre_line: Literal["none", "dashed", "solid"] = "dashed"
    edge_line: bool = False
    lane_width_m: Positive = 3.2


class RowSpec(_Part):
    """Objects of one kind along the street, at regular or irregular distances.

    `offset_m` is measured outwards from the kerb (negative: on the road, as parked cars are).
    """

    kind: str
    side: Side = "both"
    spacing_m: Positive = 25.0
    irregular: Share = 0.2
    offset_m: float = 0.6
    offset_jitter_m: NotNegative = 0.1
    keep: Share = 1.0
    from_m: float = 0.0
    to_m: float | None = None
    lean_deg: NotNegative = 0.0
    height_m: tuple[Positive, Positive] | None = None
    radius_m: tuple[Positive, Positive] | None = None


class HousesSpec(_Part):
    """A line of houses behind the pavement."""

    side: Side = "both"
    setback_m: NotNegative = 5.5
    width_m: tuple[Positive, Positive] = (9.0, 15.0)
    gap_m: tuple[NotNegative, NotNegative] = (2.0, 7.0)
    storeys: tuple[int, int] = (2, 3)
    keep: Share = 1.0


class LightSpec(_Part):
    """Sun and sky; irradiances relative to a white card facing the sun at noon."""

    sun_elevation_deg: Annotated[float, Field(ge=2, le=89)] = 42.0
    sun_azimuth_deg: float = 210.0
    sun: NotNegative = 1.0
    sky: NotNegative = 0.19
    clouds: Share = 0.4
    dusk: bool = False


class TrafficSpec(_Part):
    """How many things move: each drives or walks along the street, anew in every lap."""

    oncoming_per_km: NotNegative = 12.0
    ahead_per_km: NotNegative = 3.0
    beside_per_km: NotNegative = 0.0
    cyclists_per_km: NotNegative = 4.0
    pedestrians_per_km: NotNegative = 14.0


class UTurnSpec(_Part):
    """A turn on the street, the way back in the other lane, and another turn: on it goes."""

    at_m: Positive
    back_to_m: Positive
    radius_m: Annotated[float, Field(ge=4.3, le=15.0)] = 4.6

    @model_validator(mode="after")
    def _has_room(self) -> UTurnSpec:
        if self.back_to_m > self.at_m - 40.0:
            raise ValueError("a U-turn must lead back by 40 m at least: lower back_to_m")
        return self


class DriveSpec(_Part):
    """How the car is driven: lane, speeds, stops and what the driver does besides."""

    lane_offset_m: float = -1.65
    speed_mps: Positive = 10.0
    lateral_acceleration_mps2: Positive = 2.2
    acceleration_mps2: Positive = 1.5
    standstill_s: NotNegative = 2.5
    frame_rate_hz: Positive = 11.0
    stops_m: list[float] = Field(default_factory=list)
    wander_sd_m: tuple[NotNegative, NotNegative] = (0.10, 0.27)
    evasions: NotNegative = 0.0
    u_turns: list[UTurnSpec] = Field(default_factory=list)


class Scenario(_Part):
    """One world and the drive through it."""

    name: str
    description: str = ""
    epsg: int = 32633
    origin_east_m: float = 388500.0
    origin_north_m: float = 5819500.0
    route: RouteSpec
    section: SectionSpec = Field(default_factory=SectionSpec)
    side_streets: list[SideStreetSpec] = Field(default_factory=list)
    houses: list[HousesSpec] = Field(default_factory=list)
    rows: list[RowSpec] = Field(default_factory=list)
    light: LightSpec = Field(default_factory=LightSpec)
    traffic: TrafficSpec = Field(default_factory=TrafficSpec)
    drive: DriveSpec = Field(default_factory=DriveSpec)
    backdrop: bool = True

    @model_validator(mode="after")
    def _turns_fit_the_street(self) -> Scenario:
        room = self.section.road_half_width_m + self.section.parking_width_m - _BESIDE_AXLE_M
        for turn in self.drive.u_turns:
            if turn.radius_m > room:
                raise ValueError(
                    f"drive.u_turns: radius_m {turn.radius_m:g} is too wide for this street, whose "
                    f"kerbs leave {room:.1f} m; widen road_half_width_m or parking_width_m"
                )
        return self

    def in_u_turn(self, station_m: float) -> bool:
        """Whether a car turns round there, so that nothing may be parked on the road."""
        return any(
            abs(station_m - place) < turn.radius_m + 16.0
            for turn in self.drive.u_turns
            for place in (turn.at_m, turn.back_to_m)
        )

    def lit(self, light: str) -> Scenario:
        """The same world at dusk or under clouds."""
        known: dict[str, dict[str, object]] = {
            "dusk": {"sun": 0.0, "sky": 0.018, "dusk": True},
            "overcast": {"sun": 0.05, "sky": 0.42, "clouds": 0.9},
        }
        changed = self.light.model_copy(update=known.get(light, {}))
        return self.model_copy(update={"light": changed})


def scenario_names() -> list[str]:
    """Names of the worlds that come with the package."""
    folder = resources.files("polemap.simulate") / "scenarios"
    return sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".yaml"))


def load_scenario(name_or_file: str | Path) -> Scenario:
    """A world by its name, or from a YAML file of one's own.

    Raises:
        InputError: no such world or file, or the file is not YAML.
        ConfigError: an unknown key or a value out of its range.
    """
    text_name = str(name_or_file)
    if text_name in scenario_names():
        text = (resources.files("polemap.simulate") / "scenarios" / f"{text_name}.yaml").read_text(
            "utf-8"
        )
    else:
        path = Path(name_or_file)
        if not path.is_file():
            raise InputError(
                f"scenario {text_name!r} is neither a file nor one of the worlds "
                f"{', '.join(scenario_names())}"
            )
        with named(f"scenario {text_name}", InputError, "scenario"):
            text = read_text(path, LARGEST_BYTES)
    with named(f"scenario {text_name}", InputError, "scenario"):
        content = parse_yaml(text)
    if not isinstance(content, dict):
        raise InputError(f"scenario {text_name}: expected a mapping with the keys name, route, ...")
    try:
        return Scenario.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place_text = ".".join(str(p) for p in first["loc"])
        given = str(first.get("input"))[:60]
        raise ConfigError(
            f"scenario {text_name}: {place_text}: {first['msg']} (got {given})"
        ) from error
