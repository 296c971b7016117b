"""`polemap map`: build, update, compare and convert pole maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from drivelog.drive import Drive, open_drive
from drivelog.errors import InputError
from drivelog.samples import PoleScan
from polemap.build import BuiltMap, build_map
from polemap.io import check_writable, read_map, write_map
from polemap.landmark_map import PoleMap
from polemap.perception import scan_drive
from tools.progress import Advance, progress
from tools.settings import ConfigOption, SeedOption, SetOption, Settings, load_settings


def command(
    drives: Annotated[
        list[Path] | None, typer.Argument(help="Drives with reference poses, of any known kind.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Map to write: .gpkg, .geojson or .parquet.")
    ] = None,
    lap: Annotated[str | None, typer.Option("--lap", help="Keep to this row of laps.csv.")] = None,
    update: Annotated[
        Path | None, typer.Option("--update", help="A map to bring up to date with the drives.")
    ] = None,
    align: Annotated[
        bool, typer.Option("--align", help="Lay drives onto each other before merging.")
    ] = False,
    seed: SeedOption = 0,
    config: ConfigOption = None,
    set_values: SetOption = None,
) -> None:
    """Build one pole map from one or many drives that have reference poses.

    Examples:
        polemap map drives/monday --out campus.gpkg
        polemap map drives/park --lap map --out park.geojson
        polemap map drives/tuesday drives/friday --update campus.gpkg --align --out campus.gpkg

    The ending of --out chooses the format. Poles that were seen too seldom for how often they were
    in view are left out; `docs/maps.md` has the rules and the columns.
    """
    settings = load_settings(config, set_values)
    if not drives:
        raise InputError("no drive is given: polemap map DRIVE... --out MAP")
    if out is None:
        raise InputError("--out is missing: it names the map to write, such as campus.gpkg")
    check_writable(out)
    opened = [_open(path, lap, seed) for path in drives]
    old = read_map(update, opened[0].frame, allow_empty=True) if update is not None else None
    built = _build(opened, settings, old, align)
    if not len(built.pole_map):
        raise InputError(
            f"no pole was found in {len(opened)} drives, {out} was not written; try a lower "
            "--set polemap.mapping.observations_min"
        )
    write_map(built.pole_map, out)
    _say(built, opened, out)


def _open(path: Path, lap: str | None, seed: int) -> Drive:
    drive = open_drive(path, seed=seed)
    return drive.lap(lap) if lap is not None else drive


def _build(drives: list[Drive], settings: Settings, old: PoleMap | None, align: bool) -> BuiltMap:
    total = sum(len(d.frame_stamps_s) if d.has_frames else len(d.scans) for d in drives)
    with progress(total, "looking for poles") as advance:
        return build_map(
            drives,
            settings.polemap,
            lambda drive: _scan(drive, settings, advance),
            update=old,
            align=align,
        )


def _scan(drive: Drive, settings: Settings, advance: Advance) -> Sequence[PoleScan]:
    """Poles in the images; poles that were detected elsewhere go to the building as they are.

    The building joins sightings over whole passes with the reference, which is stronger than any
    tracking on odometry: a tracker before it would only lose some.
    """
    if drive.has_frames:
        return scan_drive(drive, settings.polemap, advance, stereo=settings.stereo)
    if not drive.scans:
        raise InputError(f"drive {drive.name}: it has neither images nor poles.csv")
    advance(len(drive.scans))
    return drive.scans


def _say(built: BuiltMap, drives: list[Drive], out: Path) -> None:
    for drive in drives:
        for note in drive.notes:
            typer.echo(f"note: {drive.name}: {note}")
        for problem, count in drive.problems.items():
            typer.echo(f"note: {drive.name}: {count} x {problem.replace('_', ' ')}")
    for report in built.reports:
        typer.echo(f"note: {report}")
    if len(built.removed):
        typer.echo(f"{len(built.removed)} poles of the old map are gone")
    typer.echo(f"{out}: {len(built.pole_map)} poles in {built.pole_map.frame}")
