"""Scenario and seed in, drive folder out: the room on one screen."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_folder, scratch_folder
from polemap.drivelog.drive import Lap
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.writers.folder import FolderWriter, folder_writer, write_drive
from polemap.extras import check_installed
from polemap.map.io import read_map, write_map
from polemap.simulate import sensors
from polemap.simulate.config import SimulateConfig
from polemap.simulate.detector import PoleDetector
from polemap.simulate.dynamics import CAR
from polemap.simulate.faults import age_map, apply_faults
from polemap.simulate.kind_scans import with_kinds
from polemap.simulate.route import make_route
from polemap.simulate.scenario import Scenario, load_scenario
from polemap.simulate.studio import Plan, make_plan, shots
from polemap.simulate.truth import (
    carry_truth,
    write_lane_truth,
    write_truth,
    write_truth_pictures,
)
from polemap.simulate.world import World, make_world
from polemap.simulate.world_lines import world_truth

Floats = NDArray[np.float64]


def count_frames(
    scenario: Scenario | str | Path, laps: int, seed: int, config: SimulateConfig
) -> int:
    """How many pairs `simulate_drive` will write; takes a moment only."""
    chosen = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    spec = chosen.route
    route = make_route(spec.corners_m, spec.corner_radius_m, spec.closed)
    return len(make_plan(route, chosen, laps, seed, config).frame_stamps_s)


def simulate_drive(
    scenario: Scenario | str | Path,
    out: Path,
    laps: int = 1,
    seed: int = 0,
    config: SimulateConfig | None = None,
    *,
    objects: bool = False,
    images: bool = True,
    scans: bool = False,
    advance: Callable[[int], None] | None = None,
) -> Path:
    """Writes a simulated drive as a plain drive folder.

    Args:
        scenario: a loaded scenario, the name of a world or a YAML file.
        out: the folder that appears.
        laps: rounds of a closed route.
        objects: also write the true poles (`objects.geojson`), all standing things
            (`standing.csv`), the true motion (`truth.csv`), inertial signals (`signals.csv`) and,
            with pictures, what a perfect lane camera would see (`lane_truth.csv`).
        images: without them the drive has odometry, GNSS and reference only.
        scans: also write what a detector reports (`poles.csv`, `scans.csv`).
        advance: called with 1 after every stereo pair.

    Raises:
        InputError, ConfigError: what the scenario or the target folder lacks.
        MissingExtraError: pictures need open3d, which is not installed.
    """
    config = config or SimulateConfig()
    if images:
        check_installed("open3d")  # the workers need it
    chosen = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    if config.faults:
        return _faulty(chosen, Path(out), laps, seed, config, objects, images, scans, advance)
    world = make_world(chosen.lit(config.light), seed)
    plan = make_plan(world.route, world.scenario, laps, seed, config)
    frame = EarthFrame("utm", epsg=chosen.epsg)
    antenna = np.array([config.gnss.antenna_x_m, config.gnss.antenna_y_m])
    notes = [f"simulated: world {chosen.name}, seed {seed}, {laps} laps"]
    draws = np.random.default_rng([seed, 23])
    seen = []
    if scans:
        poles = world.poles()
        detector = PoleDetector(
            np.array([[pole.x_m, pole.y_m] for pole in poles]).reshape(-1, 2),
            np.array([pole.width_m for pole in poles]),
            config.detector,
            draws,
        )
        seen = sensors.pole_scans(detector, plan.motion, config.detector.rate_hz)
        if config.further_kinds:
            seen = list(
                with_kinds(
                    seen, plan.motion, world_truth(world), config.detector,
                    config.line_detector if "lines" in config.further_kinds else None,
                    config.corner_detector if "corners" in config.further_kinds else None,
                    np.random.default_rng([seed, 24]),
                )
            )  # fmt: skip
    with folder_writer(
        Path(out), name=f"{chosen.name}_{seed}", frame=frame, wheelbase_m=CAR.wheelbase_m,
        rig=config.camera.rig() if images else None, gnss_antenna_m=antenna, notes=notes,
        pole_view=seen[0].view if seen else None,
    ) as writer:  # fmt: skip
        if images:
            _write_shots(writer, plan, world, advance)
        if scans:
            writer.scans(seen)
        rng = np.random.default_rng([seed, 22])
        writer.odometry(sensors.odometry(plan.motion, config.odometry, rng))
        writer.gnss(sensors.gnss(plan.motion, plan.origin_m, config.gnss, rng, world.fronts))
        errors = sensors.REFERENCES[config.reference.kind]
        writer.reference(
            sensors.reference(plan.motion, plan.origin_m, errors, sensors.REFERENCE_RATE_HZ, rng)
        )
        writer.laps(
            Lap(f"lap_{k + 1}", float(a), float(b))
            for k, (a, b) in enumerate(pairwise(plan.motion.lap_starts_s))
        )
        if objects:
            write_truth(writer.folder, frame, world, plan.motion, plan.origin_m)
            if images:
                write_lane_truth(writer.folder, world, plan.motion, plan.frame_stamps_s)
    return Path(out)


def _write_shots(
    writer: FolderWriter, plan: Plan, world: World, advance: Callable[[int], None] | None
) -> None:
    for number, shot in enumerate(shots(plan, world)):
        stamp, arrival = plan.frame_stamps_s[number], plan.frame_arrivals_s[number]
        writer.frame(float(stamp), float(arrival), shot.left, shot.right)
        if shot.truth is not None:
            write_truth_pictures(writer.folder, number, *shot.truth)
        if advance is not None:
            advance(1)


def _faulty(
    scenario: Scenario, out: Path, laps: int, seed: int, config: SimulateConfig,
    objects: bool, images: bool, scans: bool,
    advance: Callable[[int], None] | None,
) -> Path:  # fmt: skip
    """The drive without faults in a temporary place, and from there with them to its own."""
    sound = config.model_copy(update={"faults": ()})
    with scratch_folder() as place:
        base = simulate_drive(
            scenario, place / "sound", laps, seed, sound,
            objects=objects, images=images, scans=scans, advance=advance,
        )  # fmt: skip
        broken = place / "broken"
        faulty = apply_faults(open_drive(base), config.faults, seed)
        write_drive(faulty, broken)
        carry_truth(base, broken, faulty.frame_numbers)
        if objects:
            true = read_map(base / "objects.geojson", faulty.frame)
            aged = age_map(true, config.faults, seed)
            if aged is not true:
                write_map(aged, broken / "mapped.geojson")
        with atomic_folder(out, "drive") as folder:
            shutil.copytree(broken, folder, dirs_exist_ok=True)
    return out
