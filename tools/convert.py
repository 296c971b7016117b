"""`polemap convert`: drives, runs and logs of other programs from one form into another.

A conversion is chosen by what the input is and what is to come out; `CONVERSIONS` names the module
and function of each, which is imported when it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import typer

from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.readers.registry import reader_of
from polemap.drivelog.results.targets import check_own_kind
from polemap.tools.option_types import ForceOption, SeedOption, TopicsOption

Source = Literal["drive", "run", "log"]

TRAJECTORIES = ("tum", "kitti-poses", "csv", "gpx", "geojson")
"""Poses alone: of a run, or the reference of a drive."""

CONVERSIONS: dict[tuple[Source, str], str] = {
    ("drive", "folder"): "polemap.tools.convert_drive:to_folder",
    ("drive", "kitti"): "polemap.tools.convert_drive:to_kitti",
    ("drive", "mcap"): "polemap.tools.convert_drive:to_mcap",
    **{
        ("drive", form): "polemap.tools.convert_run:reference_to_trajectory"
        for form in TRAJECTORIES
    },
    ("run", "mcap"): "polemap.tools.convert_run:to_recording",
    ("run", "rrd"): "polemap.tools.convert_run:to_recording",
    **{("run", form): "polemap.tools.convert_run:to_trajectory" for form in TRAJECTORIES},
    ("log", "folder"): "polemap.tools.convert_log:to_folder",
    ("log", "csv"): "polemap.tools.convert_log:to_csv",
}
"""What goes in and what comes out, to `module:function`, which takes a `Request`."""

FORM_OF_ENDING = {
    ".mcap": "mcap",
    ".rrd": "rrd",
    **{f".{form}": form for form in TRAJECTORIES},
    ".kitti": "kitti-poses",
}
"""What comes out by the ending of `--out`, where `--to` does not say; a folder otherwise."""

_RUN_FILES = ("config.yaml", "pf.tum")


@dataclass(frozen=True, slots=True)
class Request:
    """One call of `polemap convert`.

    Attributes:
        inputs: drives, runs or logs; at least one.
        out: the file or folder to write.
        seed: of what a reader derives.
        trajectory: of a run, `kf` or `pf`; None chooses.
        run: which of the runs of a folder with several.
        map_file, drive: what a run was made from, where it does not lead there or is to show it.
        topics: mapping of the topics of a bag.
    mapping: of a log, what its columns are.
    wheelbase_m: of the car of a log, where the mapping does not say it.
    day: on which a log begins that has times of day alone.
    force: write a drive that cannot be right.
    """

    inputs: tuple[Path, ...]
    out: Path
    seed: int = 0
    trajectory: str | None = None
    run: int = 0
    map_file: Path | None = None
    drive: Path | None = None
    topics: Path | None = None
    mapping: Path | None = None
    wheelbase_m: float | None = None
    day: str | None = None
    force: bool = False

    @property
    def input(self) -> Path:
        """The only input.

        Raises:
            ConfigError: there are several, and this conversion takes one.
        """
        if len(self.inputs) > 1:
            raise ConfigError(f"convert: {self.inputs[1]}: this conversion takes one input")
        return self.inputs[0]


def command(
    inputs: Annotated[
        list[Path], typer.Argument(metavar="INPUT...", help="A drive of any kind, a run, or logs.")
    ],
    out: Annotated[Path | None, typer.Option("--out", help="File or folder to write.")] = None,
    form: Annotated[
        str | None,
        typer.Option("--to", help="What to write; by the ending of --out where it is not said."),
    ] = None,
    trajectory: Annotated[
        str | None, typer.Option("--trajectory", help="Of a run: kf (100 Hz, default) or pf.")
    ] = None,
    run: Annotated[
        int, typer.Option("--run", min=0, help="Which run of a folder with several.")
    ] = 0,
    map_file: Annotated[
        Path | None, typer.Option("--map", help="The map of a run, where it has moved.")
    ] = None,
    drive: Annotated[
        Path | None, typer.Option("--drive", help="The drive of a run, for its pictures.")
    ] = None,
    topics: TopicsOption = None,
    mapping: Annotated[
        Path | None, typer.Option("--mapping", help="Of logs: YAML file, our columns to theirs.")
    ] = None,
    write_mapping: Annotated[
        Path | None, typer.Option("--write-mapping", help="Of logs: a mapping to complete.")
    ] = None,
    wheelbase_m: Annotated[
        float | None, typer.Option("--wheelbase", min=0.1, help="Of the car of logs, metres.")
    ] = None,
    day: Annotated[
        str | None, typer.Option("--date", help="Of NMEA logs without one, such as 2024-05-31.")
    ] = None,
    force: ForceOption = False,
    seed: SeedOption = 0,
) -> None:
    """Convert a drive, a run or a log into another form.

    Examples:
        polemap convert sequences/03 --out drives/kitti_03
        polemap convert drives/monday --out monday.mcap
        polemap convert drives/monday --out kitti --to kitti
        polemap convert drives/monday --out reference.tum
        polemap convert runs/lap_2 --out lap_2.gpx
        polemap convert runs/lap_2 --out lap_2_pf.kitti --trajectory pf
        polemap convert runs/lap_2 --drive drives/monday --out lap_2.mcap
        polemap convert can.csv gps.nmea --write-mapping names.yaml
        polemap convert can.csv gps.nmea --mapping names.yaml --out drives/tuesday
        polemap convert track.gpx --out gnss.csv
        polemap convert can.csv --mapping names.yaml --out signals.csv

    A drive becomes a plain drive folder, a KITTI odometry folder or an MCAP file of ROS 2 messages;
    the poses of a run, or the reference of a drive, become .tum, .kitti, .csv, .gpx or .geojson;
    a run becomes a recording for Foxglove (.mcap) or rerun (.rrd), see polemap view.
    What the new form has no place for is named. docs/viewers.md lists what reads what.
    Logs are CSV of any shape, NMEA and GPX; a mapping says what their columns are, in what units.
    docs/logs.md explains it.
    """
    source = kind_of(inputs[0])
    if write_mapping is not None:
        if source != "log":
            raise ConfigError(f"convert: {inputs[0]} is a {source} and needs no --write-mapping")
        write = import_module("polemap.tools.convert_log").write_mapping
        typer.echo("\n".join(write(inputs, write_mapping, mapping)))
        return
    if out is None:
        raise ConfigError("convert: --out is needed: the file or folder to write")
    request = Request(
        tuple(inputs), out, seed, trajectory, run, map_file, drive, topics,
        mapping=mapping, wheelbase_m=wheelbase_m, day=day, force=force,
    )  # fmt: skip
    target = form or FORM_OF_ENDING.get(out.suffix.lower(), "folder")
    check_own_kind(out, [ending for ending, made in FORM_OF_ENDING.items() if made == target])
    lines = _conversion(inputs[0], source, target)(request)
    typer.echo("\n".join(lines))


def _conversion(path: Path, source: Source, target: str) -> Callable[[Request], Sequence[str]]:
    """What turns one into the other; loaded when it is needed.

    Raises:
        ConfigError: nothing does.
    """
    place = CONVERSIONS.get((source, target))
    if place is None:
        known = ", ".join(form for kind, form in CONVERSIONS if kind == source)
        raise ConfigError(
            f"convert: {path} is a {source} and cannot become '{target}'; --to takes "
            f"{known or 'nothing'} for a {source}"
        )
    module, _, function = place.partition(":")
    found: Callable[[Request], Sequence[str]] = getattr(import_module(module), function)
    return found


def kind_of(path: Path) -> Source:
    """What an input is, without reading more than names and first lines.

    Raises:
        InputError: nothing that polemap knows.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if any(all((at / name).is_file() for name in _RUN_FILES) for at in (path, path / "000")):
        return "run"
    if reader_of(path) is not None:
        return "drive"
    if path.is_file():
        return "log"
    raise InputError(
        f"{path}: neither a drive nor a run; `polemap info --help` names the kinds of drive"
    )
