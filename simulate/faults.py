"""Faults that can be laid over any drive, one after the other: what breaks in the field.

Every fault is a frozen model with `apply(drive, rng) -> Drive`, or `age(map, rng) -> PoleMap`; a
list of them is a setting (`simulate.faults`) as well as a tool for tests.
`drivelog.writers.folder.write_drive` writes a faulty drive down.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from polemap.drivelog.drive import Drive
from polemap.map.pole_map import PoleMap
from polemap.simulate.drive_fault import DriveFault
from polemap.simulate.frame_faults import (
    BlurredFrames,
    DirtyLens,
    DroppedFrames,
    FrozenFrames,
    Miscalibration,
    OverExposed,
    SwappedCameras,
)
from polemap.simulate.map_faults import MapFault, PolesAdded, PolesRemoved
from polemap.simulate.stream_faults import (
    ClockJump,
    GnssDropout,
    GnssOffset,
    NotANumber,
    OdometryDropout,
)

Fault = Annotated[
    DroppedFrames | FrozenFrames | SwappedCameras | OverExposed | BlurredFrames | DirtyLens
    | Miscalibration | NotANumber | ClockJump | OdometryDropout | GnssDropout | GnssOffset
    | PolesAdded | PolesRemoved,
    Field(discriminator="kind"),
]  # fmt: skip


def apply_faults(drive: Drive, faults: Sequence[DriveFault | MapFault], seed: int) -> Drive:
    """The drive with all faults, in the order given; each draws from its own stream of the seed."""
    for index, fault in enumerate(faults):
        if isinstance(fault, DriveFault):
            drive = fault.apply(drive, _draws(seed, index))
    return drive


def age_map(pole_map: PoleMap, faults: Sequence[DriveFault | MapFault], seed: int) -> PoleMap:
    """The map with what the faults say of poles put up or taken away since it was made."""
    for index, fault in enumerate(faults):
        if isinstance(fault, MapFault):
            pole_map = fault.age(pole_map, _draws(seed, index))
    return pole_map


def _draws(seed: int, index: int) -> np.random.Generator:
    return np.random.default_rng([seed, 9000, index])
