"""`polemap simulate`: a drive through a simulated world."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from polemap.drivelog.atomic import check_folder, reserved, scratch_folder
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import ConfigError
from polemap.settings import Settings, load_settings
from polemap.simulate.scenario import scenario_names
from polemap.tools.option_types import ConfigOption, SeedOption, SetOption
from polemap.tools.progress import progress


def command(
    scenario: Annotated[str, typer.Argument(help="A world by its name, or a YAML file.")] = "",
    out: Annotated[Path | None, typer.Option("--out", help="Folder that appears.")] = None,
    laps: Annotated[int, typer.Option("--laps", min=1, help="Rounds of a closed route.")] = 1,
    seed: SeedOption = 0,
    objects: Annotated[
        bool, typer.Option("--objects", help="Also write the true poles and the true motion.")
    ] = False,
    images: Annotated[bool, typer.Option(help="Render the stereo pairs.")] = True,
    scans: Annotated[
        bool, typer.Option("--scans", help="Poles as a detector reports them, without pictures.")
    ] = False,
    layout: Annotated[
        str, typer.Option("--format", help="folder (default), kitti_odometry or kitti_raw.")
    ] = "folder",
    list_worlds: Annotated[bool, typer.Option("--list", help="Name the worlds.")] = False,
    config: ConfigOption = None,
    set_values: SetOption = None,
) -> None:
    """Write a simulated drive as a plain drive folder.

    Examples:
      polemap simulate park_loop --out drive --laps 3 --objects
      polemap simulate avenue --out avenue --seed 7 --set simulate.camera.frame_rate_hz=22
      polemap simulate my_street.yaml --out drive --no-images
      polemap simulate boulevard --out poles --scans --objects
      polemap simulate suburb --out dusk --set simulate.light=dusk --set simulate.camera.bits=12
      polemap simulate suburb --out blurred \\
        --set 'simulate.faults=[{kind: blurred_frames, from_s: 5, until_s: 9}]'
      polemap simulate suburb --out kitti --format kitti_odometry --objects
      polemap simulate suburb --out 2011_09_26 --format kitti_raw
      polemap simulate --list

    The same scenario, seed and settings give the same bytes. docs/simulator.md explains worlds,
    sensors and faults.
    """
    if list_worlds:
        typer.echo("\n".join(scenario_names()))
        return
    if not scenario or out is None:
        raise ConfigError("simulate: SCENARIO and --out are needed; --list names the worlds")
    if layout not in ("folder", "kitti_odometry", "kitti_raw"):
        raise ConfigError(
            f"simulate: --format {layout} is unknown; use folder, kitti_odometry or kitti_raw"
        )
    check_folder(out, "drive", (scenario, config))
    settings = load_settings(config, set_values)
    if layout != "folder" and settings.simulate.camera.bits != 8:
        raise ConfigError(
            f"simulate: --format {layout} has 8-bit pictures: set simulate.camera.bits=8"
        )
    if scans and layout != "folder":
        raise ConfigError(f"simulate: --format {layout} has no place for --scans; use folder")
    if settings.simulate.further_kinds and not scans:
        raise ConfigError(
            "simulate: simulate.further_kinds says what --scans hold, which is missing; add it, or "
            "leave the setting out (what pictures show is found by polemap.detection.kinds)"
        )
    _simulate(
        scenario,
        out,
        laps,
        seed,
        settings,
        layout,
        objects=objects,
        images=images and not scans,
        scans=scans,
    )


def _simulate(
    scenario: str,
    out: Path,
    laps: int,
    seed: int,
    settings: Settings,
    layout: str,
    *,
    objects: bool,
    images: bool,
    scans: bool,
) -> None:
    # not at the top, where --help would wait for them
    from polemap.drivelog.readers.registry import open_drive
    from polemap.drivelog.writers.kitti_odometry import write_kitti_odometry
    from polemap.map.io import read_map
    from polemap.simulate.drive import count_frames, simulate_drive
    from polemap.simulate.kitti_raw_layout import write_kitti_raw

    frames = count_frames(scenario, laps, seed, settings.simulate) if images else 0
    with progress(frames, f"simulating {scenario}") as advance:
        if layout == "folder":
            simulate_drive(
                scenario, out, laps, seed, settings.simulate,
                objects=objects, images=images, scans=scans, advance=advance,
            )  # fmt: skip
            typer.echo("\n".join(_summary(open_drive(out), out)))
            return
        # the place is held from the start: that it cannot be written is told before the work
        with reserved(out), scratch_folder() as place:
            made = simulate_drive(
                scenario, place / "drive", laps, seed, settings.simulate,
                objects=True, images=images, advance=advance,
            )  # fmt: skip
            drive = open_drive(made)
            poles = read_map(made / "objects.geojson", drive.frame) if objects else None
            if layout == "kitti_raw":
                written = write_kitti_raw(drive, out, poles)
            else:
                points_m = poles.points_m if poles else None
                written = write_kitti_odometry(drive, out, "00", points_m)
            typer.echo("\n".join(_summary(drive, written)))


def _summary(drive: Drive, place: Path) -> list[str]:
    """What was driven and seen, and what to do next with the drive at `place`."""
    streams = [
        (len(drive.frame_stamps_s), "stereo pairs"),
        (0 if drive.odometry is None else len(drive.odometry), "odometry samples"),
        (0 if drive.gnss is None else len(drive.gnss), "fixes"),
        (len(drive.scans), "pole scans"),
        (len(drive.laps), "laps"),
    ]
    counted = ", ".join(f"{count} {name}" for count, name in streams if count)
    way = ""
    if drive.reference is not None and len(drive.reference) > 1:
        steps = np.diff(drive.reference.poses[:, :2], axis=0)
        way = f", {np.hypot(*steps.T).sum():.0f} m"
    seeing = drive.has_frames or drive.scans
    follows = f"polemap map {place} --out poles.gpkg" if seeing else f"polemap info {place}"
    return [f"{drive.duration_s:.1f} s{way}: {counted}", f"wrote {place}", f"next: {follows}"]
