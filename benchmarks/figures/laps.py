"""Laps of a simulated route to localize in, as easy or as hard as one likes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluate.report_routes import short_world
from polemap.build.build_map import build_map
from polemap.drivelog.drive import Drive
from polemap.drivelog.readers.registry import open_drive
from polemap.evaluation.laps import Span, Stretch, find_stretches
from polemap.evaluation.repeatability import Guide, guides_of
from polemap.map.pole_map import PoleMap
from polemap.perception import scan_drive
from polemap.settings import Settings, read_tree
from polemap.simulate.config import SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.sensors import REFERENCES, gauss_markov
from polemap.vehicle.trajectory import Trajectory, interpolate_poses

Floats = NDArray[np.float64]

RATE_HZ = 22.0
"""Of the paper's camera."""
CONFIGURATIONS: dict[str, Callable[[], Settings]] = {
    "as printed": lambda: Settings.model_validate(read_tree(Path("papers/s16.yaml"))),
    "ours": Settings,
}


@dataclass(frozen=True, slots=True)
class Condition:
    """How hard the laps are.

    Attributes:
        sensors: settings of the simulator that differ from its own.
        map_share: of the mapped poles that stay, drawn once a route.
    """

    sensors: Mapping[str, Any] = field(default_factory=dict)
    map_share: float = 1.0


EASY, HARD = "as simulated", "harder"
CONDITIONS = {
    EASY: Condition(),
    HARD: Condition(
        {
            "detector": {"detected_share": 0.4, "clutter_share": 0.5},
        },
        map_share=0.5,
    ),
}  # fmt: skip
"""Harder: half of the poles mapped, 40 % of what is in view seen, half of what is seen no pole."""


@dataclass(frozen=True, slots=True)
class Laps:
    """What a run localizes in, and what it is measured by.

    Attributes:
        drive: the laps after the first, with what the detector reports at `RATE_HZ`.
        pole_map: of the first, by the configuration's own perception.
        truth: poses of the rear axle.
        reference: the truth with a drift as that of the paper's reference.
        stretch, guides: the laps on the true path.
    """

    drive: Drive
    pole_map: PoleMap
    truth: Trajectory
    reference: Trajectory
    stretch: Stretch
    guides: tuple[Guide, ...]


def drive_of(route: str, condition: str, laps: int, folder: Path) -> Path:
    """A simulated drive of the mapping lap and `laps` more; made once."""
    place = folder / f"{route} {condition} {laps}".replace(" ", "_")
    if not place.exists():
        tree: dict[str, Any] = {"detector": {"rate_hz": RATE_HZ}}
        for section, values in CONDITIONS[condition].sensors.items():
            tree[section] = {**tree.get(section, {}), **values}
        simulate_drive(
            short_world(route), place, laps + 1, 0, SimulateConfig.model_validate(tree),
            objects=True, images=False, scans=True,
        )  # fmt: skip
    return place


def laps_of(
    route: str, condition: str, laps: int, settings: Settings, easy: Path, hard: Path
) -> Laps:
    """The laps of a route.

    Args:
        route: of `short_world`.
        condition: of `CONDITIONS`.
        laps: to localize, after the one that is mapped.
        settings: whose perception makes the map.
        easy: drive in which the map is made: mapping is not what is made hard.
        hard: drive under the condition.
    """
    asked = CONDITIONS[condition]
    mapped = open_drive(easy)
    first = mapped.lap(mapped.laps[0].name)
    scans = scan_drive(first, settings.polemap)
    pole_map = build_map([first], settings.polemap, lambda _: scans).pole_map
    rng = np.random.default_rng([sum(route.encode()), 21])
    keep = np.sort(rng.permutation(len(pole_map))[: round(asked.map_share * len(pole_map))])
    whole = open_drive(hard)
    driven = whole.lap(f"{whole.laps[1].name}:{whole.laps[laps].name}")
    true = _truth(hard, driven)
    spans = [Span(0, lap.start_s, lap.end_s, lap.name) for lap in driven.laps]
    (stretch,) = find_stretches([true], spans)
    error = REFERENCES["drifting"]
    drift = np.column_stack(
        [
            gauss_markov(true.stamp_s, error.sd_m, error.time_s, rng, 2),
            gauss_markov(true.stamp_s, error.yaw_sd_rad, error.time_s, rng),
        ]
    )
    return Laps(
        driven,
        pole_map.rows(keep),
        true,
        Trajectory(true.stamp_s, true.poses + drift),
        stretch,
        tuple(guides_of(stretch, [true])),
    )


def _truth(folder: Path, driven: Drive) -> Trajectory:
    table = np.genfromtxt(folder / "truth.csv", delimiter=",", names=True)
    poses = np.column_stack([table["east_m"], table["north_m"], table["yaw_rad"]])
    stamps = np.arange(driven.laps[0].start_s, driven.laps[-1].end_s, 0.02)
    return Trajectory(stamps, interpolate_poses(table["stamp_s"], poses, stamps))
