"""The road of one frame seen from above: brightness and height over its plane on one grid.

With the plane d = c0 + c1 u + c2 v of `ground.py`, n = (c1 f, c2 f, c0 + c1 cx + c2 cy) holds
n . P = f b for every camera point P of the road: n is its normal (downward), f b / |n| the camera's
height over it. What stands h above the plane on the same ray has the disparity d such that
h = height (1 - c / d) with c the plane's own, and lies at (1 - h / height) times the place of the
plane that the ray meets, as seen from the camera's foot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.detect.ground import Ground
from polemap.drivelog.samples import Image
from polemap.extras import kernel
from polemap.stereo.depth_edges import UprightMaps
from polemap.stereo.rig import StereoRig
from polemap.vehicle.pose import rotate, rotate_back

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

NEAR_M, FAR_M = 4.0, 24.0  # ahead of the camera
ASIDE_M = 7.0
STEP_AHEAD_M, STEP_ASIDE_M = 0.2, 0.05
GROUND_BOX = (7, 5)  # columns, rows
LEAST_MATCHED = 0.6  # of a box
ROWS = round((FAR_M - NEAR_M) / STEP_AHEAD_M)
COLUMNS = round(2.0 * ASIDE_M / STEP_ASIDE_M)
# cells to road points (x ahead, y left of the camera's foot): row 0 is near, column 0 right
_ROAD_FROM_CELL = np.array(
    [
        [0.0, STEP_AHEAD_M, NEAR_M + 0.5 * STEP_AHEAD_M],
        [STEP_ASIDE_M, 0.0, -ASIDE_M + 0.5 * STEP_ASIDE_M],
        [0.0, 0.0, 1.0],
    ]
)


def ahead_m(row: Floats) -> Floats:
    """Metres ahead of the camera's foot of rows of the grid."""
    return np.asarray(NEAR_M + (row + 0.5) * STEP_AHEAD_M)


def left_m(column: Floats) -> Floats:
    """Metres left of the camera's foot of columns of the grid."""
    return np.asarray(-ASIDE_M + (column + 0.5) * STEP_ASIDE_M)


@dataclass(frozen=True, slots=True)
class RoadFrame:
    """Axes of the road plane under the camera: where its points stand in image and vehicle.

    Attributes:
        height_m: of the camera over the plane.
        pixel_from_road: `(3, 3)`, homogeneous, of the left image.
    """

    rig: StereoRig
    height_m: float
    pixel_from_road: Floats

    def vehicle_points(self, points_m: Floats) -> Floats:
        """Road points `(..., 2)`, x ahead and y left of the camera's foot, in the vehicle frame."""
        mount = self.rig.vehicle_from_camera
        return np.asarray(rotate(points_m, mount.yaw_rad) + np.array([mount.x_m, mount.y_m]))

    def pixels(self, points_vehicle_m: Floats) -> Floats:
        """Where points `(n, 2)` of the vehicle frame stand in the image: `(n, 2)` column, row."""
        mount = self.rig.vehicle_from_camera
        road = rotate_back(points_vehicle_m - np.array([mount.x_m, mount.y_m]), mount.yaw_rad)
        x, y, w = self.pixel_from_road @ np.column_stack([road, np.ones(len(road))]).T
        return np.stack([x / w, y / w], axis=1)


def road_frame(ground: Ground, rig: StereoRig) -> RoadFrame:
    """The axes of a fitted plane; see the module."""
    f, b = rig.focal_px, rig.baseline_m
    normal = np.array([
        ground.per_column * f, ground.per_row * f,
        ground.offset + ground.per_column * rig.cx_px + ground.per_row * rig.cy_px,
    ])  # fmt: skip
    length = float(np.linalg.norm(normal))
    down, height = normal / length, f * b / length
    ahead = np.array([0.0, 0.0, 1.0]) - down * down[2]
    ahead /= np.linalg.norm(ahead)
    left = np.cross(-down, ahead)
    camera = np.array([[f, 0.0, rig.cx_px], [0.0, f, rig.cy_px], [0.0, 0.0, 1.0]])
    return RoadFrame(rig, height, camera @ np.column_stack([ahead, left, height * down]))


@dataclass(frozen=True, slots=True)
class RoadView:
    """What the grid `(ROWS, COLUMNS)` shows.

    Attributes:
        frame: where its cells lie.
        light: brightness of the left image.
        inside: cells that the image shows.
        height_m: over the plane, 0 where `matched` is not.
        matched: cells with a disparity, 1 or 0.
        ground_m: mean height about each cell, NaN where too few are matched.
        disparity_px: `(ROWS,)` of the plane in the middle of each row.
        image_row: `(ROWS,)` row of the left image there; far rows of the grid share one.
    """

    frame: RoadFrame
    light: NDArray[np.uint8]
    inside: NDArray[np.bool_]
    height_m: Floats32
    matched: Floats32
    ground_m: Floats32
    disparity_px: Floats
    image_row: NDArray[np.int64]


def view_road(image: Image, maps: UprightMaps, ground: Ground, rig: StereoRig) -> RoadView:
    """The left image `(height, width)` and its disparities, laid onto the road plane.

    Heights are for the rest of the frame what the plane lacks: a road that is bent or has a kerb.
    """
    frame = road_frame(ground, rig)
    pixel_from_cell = frame.pixel_from_road @ _ROAD_FROM_CELL
    size = (COLUMNS, ROWS)
    plain = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    light = _bytes(cv2.warpPerspective(image, pixel_from_cell, size, flags=plain, borderValue=0))
    thin = np.diag([1.0, 1.0 / maps.row_step_px, 1.0]) @ pixel_from_cell
    nearest = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    disparity = cv2.warpPerspective(maps.left, thin, size, flags=nearest, borderValue=0)
    inside, height, matched, expected, image_row = _heights(
        disparity, pixel_from_cell, ground, frame, maps
    )
    return RoadView(
        frame, light, inside, height, matched, mean_height(height, matched, GROUND_BOX), expected,
        image_row,
    )  # fmt: skip


_Heights = tuple[NDArray[np.bool_], Floats32, Floats32, Floats, NDArray[np.int64]]


def _heights(
    disparity: Any, pixel_from_cell: Floats, ground: Ground, frame: RoadFrame, maps: UprightMaps
) -> _Heights:
    native = kernel("polemap.detect.native.road_kernel")
    if native is None:
        return plain_heights(disparity, pixel_from_cell, ground, frame, maps)
    plane = np.array([ground.offset, ground.per_column, ground.per_row])
    size = frame.rig.width_px, frame.rig.height_px
    found: _Heights = native.heights(
        disparity, pixel_from_cell, plane, frame.height_m, maps.row_step_px, *size
    )
    return found


def plain_heights(
    disparity: Any, pixel_from_cell: Floats, ground: Ground, frame: RoadFrame, maps: UprightMaps
) -> _Heights:
    """What the kernel does, in plain numpy: the tests' oracle.

    Args:
        disparity: `(ROWS, COLUMNS)` of the cells, 0 for none.

    Returns:
        `inside`, `height_m`, `matched`, `disparity_px`, `image_row` of the `RoadView`.
    """
    rig = frame.rig
    # the axis to the left is level in the image: a row of the grid has one depth
    depth = pixel_from_cell[2, 1] * np.arange(ROWS) + pixel_from_cell[2, 2]
    along = np.multiply.outer(pixel_from_cell[:2, 1], np.arange(ROWS)) + pixel_from_cell[:2, 2:]
    along /= depth
    u, v = (
        (np.multiply.outer(a / depth, np.arange(COLUMNS)) + beside[:, np.newaxis]).astype(
            np.float32
        )
        for a, beside in zip(pixel_from_cell[:2, 0], along, strict=True)
    )
    inside = (u > 1.0) & (u < rig.width_px - 2)
    middle = v[:, COLUMNS // 2]
    inside &= ((middle > 1.0) & (middle < rig.height_px - 2))[:, np.newaxis]
    # the disparity belongs to the middle of the pixel that was taken, not to the cell's
    expected = np.rint(v / np.float32(maps.row_step_px))
    expected *= np.float32(ground.per_row * maps.row_step_px)
    expected += np.float32(ground.per_column) * u + np.float32(ground.offset)
    matched = (disparity > 0.0).astype(np.float32)
    height = np.float32(frame.height_m) * (1.0 - expected / np.maximum(disparity, 0.1))
    height *= matched
    return (
        inside, height, matched, expected[:, COLUMNS // 2].astype(np.float64),
        np.rint(middle).astype(np.int64),
    )  # fmt: skip


def mean_height(height_m: Floats32, matched: Floats32, box: tuple[int, int]) -> Floats32:
    """Mean of the matched heights in a box about each cell; NaN where few are matched."""
    share = cv2.blur(matched, box)
    mean = cv2.blur(height_m, box)
    share[share < LEAST_MATCHED] = np.nan
    return np.asarray(mean / share, dtype=np.float32)


def _bytes(light: Any) -> NDArray[np.uint8]:
    """Brightness in 255 levels; that of deeper images up to what hardly a cell is above."""
    if light.dtype == np.uint8:
        return np.asarray(light)
    top = max(float(np.percentile(light[::4, ::4], 99.5)), 1e-6)
    return np.asarray(np.clip(light * (255.0 / top), 0, 255), dtype=np.uint8)
