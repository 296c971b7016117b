"""What the user of a recording calls its streams: files of a folder, topics of a bag."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True, slots=True)
class CalibrationNames:
    """Where a source states the numbers of car and camera, one by one: what to check there.

    Attributes:
        wheelbase: of the car.
        focal, centre_x, centre_y: of the rectified pictures.
        baseline: from left to right camera.
        height, pitch, yaw: of the left camera in the vehicle.
    """

    wheelbase: str = "the wheelbase"
    focal: str = "the focal length"
    centre_x: str = "the principal point's column"
    centre_y: str = "the principal point's row"
    baseline: str = "the baseline"
    height: str = "the camera's height"
    pitch: str = "its pitch"
    yaw: str = "its yaw"


@dataclass(frozen=True, slots=True)
class SourceNames:
    """The name of each stream of a drive in the source that it was read from.

    Findings and refusals speak of a stream by it, so that they name a thing that the user has.
    The name of a stream that the source lacks says what it would have to hold.

    Attributes:
        frames, odometry, gnss, reference, poles, lines, laps: the streams; no two have one name.
        head: where car, camera and earth frame are stated.
        calibration: the numbers of car and camera there.
    """

    frames: str = "frames"
    odometry: str = "odometry"
    gnss: str = "fixes"
    reference: str = "reference"
    poles: str = "poles"
    lines: str = "lines"
    laps: str = "laps"
    head: str = "description of the drive"
    calibration: CalibrationNames = CalibrationNames()

    def __post_init__(self) -> None:
        told = [getattr(self, one.name) for one in fields(self) if one.name != "calibration"]
        if len(set(told)) < len(told):
            raise ValueError(f"two streams have one name: {', '.join(told)}")

    @classmethod
    def distinct(cls, **told: str) -> SourceNames:
        """Names of which several may be the same topic: its role tells such streams apart."""
        names = {stream: name for stream, name in told.items() if name}
        twice = {name for name in names.values() if list(names.values()).count(name) > 1}
        return cls(**{s: f"{n} ({s})" if n in twice else n for s, n in names.items()})  # type: ignore[arg-type]


FOLDER = SourceNames(
    frames="frames.csv",
    odometry="odometry.csv",
    gnss="gnss.csv",
    reference="reference.csv",
    poles="poles.csv",
    lines="lines.csv",
    laps="laps.csv",
    head="drive.yaml",
    calibration=CalibrationNames(
        "wheelbase_m", "focal_px", "cx_px", "cy_px", "baseline_m", "z_m", "pitch_rad", "yaw_rad"
    ),
)
