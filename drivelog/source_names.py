"""What the user of a recording calls its streams: files of a folder, topics of a bag."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace


@dataclass(frozen=True, slots=True)
class SourceNames:
    """The name of each stream of a drive in the source that it was read from.

    Findings and refusals speak of a stream by it, so that they name a thing that the user has.
    The name of a stream that the source lacks says what it would have to hold.

    Attributes:
        frames, odometry, gnss, reference, poles, laps: the streams; no two have the same name.
        head: where car, camera and earth frame are stated.
    """

    frames: str = "frames"
    odometry: str = "odometry"
    gnss: str = "fixes"
    reference: str = "reference"
    poles: str = "poles"
    laps: str = "laps"
    head: str = "description of the drive"

    def __post_init__(self) -> None:
        told = [getattr(self, stream.name) for stream in fields(self)]
        if len(set(told)) < len(told):
            raise ValueError(f"two streams have one name: {', '.join(told)}")

    @classmethod
    def distinct(cls, **told: str) -> SourceNames:
        """Names of which several may be the same topic: its role tells such streams apart."""
        names = {stream: name for stream, name in told.items() if name}
        twice = {name for name in names.values() if list(names.values()).count(name) > 1}
        return replace(cls(), **{s: f"{n} ({s})" if n in twice else n for s, n in names.items()})


FOLDER = SourceNames(
    **{
        name: f"{name}.csv" for name in ("frames", "odometry", "gnss", "reference", "poles", "laps")
    },
    head="drive.yaml",
)
