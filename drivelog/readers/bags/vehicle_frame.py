"""Where things are mounted: TF frames against the vehicle frame at the rear axle, on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.readers.bags.mapping import VehiclePart
from polemap.drivelog.readers.bags.transforms import TransformTree

Floats = NDArray[np.float64]

# what recordings call the car; the first that TF knows is taken
_REAR_AXLE = ("rear_axle", "rear_axle_link", "rear_axle_center", "base_link_rear_axle")
_BASE = ("base_link", "base_footprint", "vehicle", "ego_vehicle", "car", "chassis", "base")
_FOOTPRINT = "base_footprint"


@dataclass(frozen=True, slots=True)
class VehicleFrame:
    """The car in the tree of frames.

    Attributes:
        base: the frame that is taken for the car, None where TF has none.
        vehicle_from_base: `(4, 4)`.
        notes: what was assumed.
    """

    base: str | None
    vehicle_from_base: Floats
    tree: TransformTree
    notes: tuple[str, ...]

    def vehicle_from(self, frame: str) -> Floats | None:
        """`(4, 4)` vehicle from a frame of the car; None where no fixed transforms lead there."""
        if self.base is None or not frame:
            return None
        way = self.tree.fixed(self.base, frame)
        return None if way is None else np.asarray(self.vehicle_from_base @ way)


def vehicle_frame(tree: TransformTree, told: VehiclePart, child_frames: set[str]) -> VehicleFrame:
    """The car's frame as the mapping says, or by its name.

    Args:
        tree: of the recording.
        told: what a mapping says.
        child_frames: what odometry and reference call that of which they are poses.
    """
    notes: list[str] = []
    base = told.base_frame
    if base is None:
        known = tree.frames | child_frames
        base = next((name for name in (*_REAR_AXLE, *_BASE) if name in known), None)
        if (
            base is not None
            and base not in _REAR_AXLE
            and "rear_axle_x_m" not in (told.model_fields_set)
        ):
            notes.append(
                f"'{base}' is taken to be at the rear axle; vehicle.rear_axle_x_m of a mapping "
                "moves it"
            )
    height = told.base_above_ground_m
    if height is None:
        footprint = tree.fixed(_FOOTPRINT, base) if base is not None else None
        height = float(footprint[2, 3]) if footprint is not None else 0.0
    motion = np.eye(4)
    motion[:3, 3] = (-told.rear_axle_x_m, 0.0, height)
    return VehicleFrame(base, motion, tree, tuple(notes))
