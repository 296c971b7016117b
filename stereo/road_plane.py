"""A camera above a flat road: pixel to road and back, and the bird's-eye picture."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, cos, sin, tan
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.rig import StereoRig
from polemap.vehicle.errors import VehicleError

Floats = NDArray[np.float64]
Grey = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class RoadCamera:
    """A pinhole camera over a plane road, pitched down, without roll or yaw.

    Attributes:
        width_px, height_px: of the image.
        half_width_rad, half_height_rad: half angles of view from the image's centre.
        height_m: over the road.
        pitch_rad: positive down.
    """

    width_px: int
    height_px: int
    half_width_rad: float
    half_height_rad: float
    height_m: float
    pitch_rad: float

    def __post_init__(self) -> None:
        angles = (self.half_width_rad, self.half_height_rad)
        if self.width_px < 8 or self.height_px < 8 or not self.height_m > 0.0:
            raise VehicleError(
                f"road camera: {self.width_px} x {self.height_px} px at {self.height_m} m"
            )
        if not all(0.0 < angle < 1.5 for angle in angles) or not -0.5 < self.pitch_rad < 1.0:
            raise VehicleError(f"road camera: angles {angles} and pitch {self.pitch_rad} rad")

    @classmethod
    def from_focal(
        cls, width_px: int, height_px: int, focal_px: float, height_m: float, pitch_rad: float
    ) -> RoadCamera:
        """From a focal length, the principal point in the image's centre."""
        return cls(
            width_px,
            height_px,
            atan(0.5 * (width_px - 1) / focal_px),
            atan(0.5 * (height_px - 1) / focal_px),
            height_m,
            pitch_rad,
        )

    @property
    def ahead_m(self) -> float:
        """Road points are counted from the camera."""
        return 0.0

    def road_to_pixel(self, points_m: Any) -> Floats:
        """Road points `(..., 2)`, x ahead of and y left of the camera, to `(row, column)` from 0.

        Source: W12 (7) with u the row, half angles of view, indices from 1 (errata.md); here 0.
        """
        p = np.asarray(points_m, dtype=np.float64)
        x, y, h = p[..., 0], p[..., 1], self.height_m
        t, s, c = tan(self.pitch_rad), sin(self.pitch_rad), cos(self.pitch_rad)
        down = (h - x * t) / (h * t + x) / tan(self.half_height_rad)
        left = y / (h * s + x * c) / tan(self.half_width_rad)
        row = 0.5 * (self.height_px - 1) * (1.0 + down)
        return np.stack([row, 0.5 * (self.width_px - 1) * (1.0 - left)], axis=-1)

    def pixel_to_road(self, pixels: Any) -> Floats:
        """`(row, column)` `(..., 2)` to road points; NaN at and above the horizon."""
        p = np.asarray(pixels, dtype=np.float64)
        rho = (2.0 * p[..., 0] / (self.height_px - 1) - 1.0) * tan(self.half_height_rad)
        t, s, c = tan(self.pitch_rad), sin(self.pitch_rad), cos(self.pitch_rad)
        below = rho + t > 1e-6
        x = np.where(below, self.height_m * (1.0 - rho * t) / np.where(below, rho + t, 1.0), np.nan)
        side = (2.0 * p[..., 1] / (self.width_px - 1) - 1.0) * tan(self.half_width_rad)
        return np.stack([x, -side * (self.height_m * s + x * c)], axis=-1)


class RoadView(Protocol):
    """A camera that knows where a point of the road stands in its picture."""

    @property
    def width_px(self) -> int: ...
    @property
    def height_px(self) -> int: ...
    @property
    def ahead_m(self) -> float:
        """Where the camera stands on the x axis of its road points."""
        ...

    def road_to_pixel(self, points_m: Any) -> Floats:
        """Road points `(..., 2)` to `(row, column)` from 0; NaN where there is no picture."""
        ...


@dataclass(frozen=True, slots=True)
class MountedCamera:
    """The left camera of a calibrated rig; road points stand in the vehicle frame, z = 0.

    Unlike `RoadCamera` it has a principal point anywhere, and all three angles of mounting.
    """

    rig: StereoRig

    @property
    def width_px(self) -> int:
        return self.rig.width_px

    @property
    def height_px(self) -> int:
        return self.rig.height_px

    @property
    def ahead_m(self) -> float:
        return self.rig.vehicle_from_camera.x_m

    def road_to_pixel(self, points_m: Any) -> Floats:
        """Points `(..., 2)`, x ahead of and y left of the rear axle, to `(row, column)`."""
        p = np.asarray(points_m, dtype=np.float64)
        ground = np.concatenate([p, np.zeros((*p.shape[:-1], 1))], axis=-1)
        return np.asarray(self.rig.project(ground)[..., 1::-1])


@dataclass(frozen=True, slots=True)
class RoadGrid:
    """The piece of road that the bird's-eye picture shows: row 0 is far, column 0 is left."""

    near_m: float = 6.0
    far_m: float = 30.0
    half_width_m: float = 6.0
    along_m: float = 0.1
    across_m: float = 0.04

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows = round((self.far_m - self.near_m) / self.along_m)
        return rows, round(2.0 * self.half_width_m / self.across_m)

    def to_road(self, rows: Any, columns: Any) -> Floats:
        """Grid indices to road points `(..., 2)`."""
        x = self.far_m - (np.asarray(rows) + 0.5) * self.along_m
        y = self.half_width_m - (np.asarray(columns) + 0.5) * self.across_m
        return np.stack([x, y], axis=-1)


class BirdsEye:
    """Warps images of one camera to one grid; where to look is computed once."""

    def __init__(self, camera: RoadView, grid: RoadGrid) -> None:
        self.camera, self.grid = camera, grid
        rows, columns = np.indices(grid.shape)
        pixels = camera.road_to_pixel(grid.to_road(rows, columns)).astype(np.float32)
        pixels = np.where(np.isfinite(pixels), pixels, np.float32(-1.0))
        self._row, self._column = (
            np.ascontiguousarray(pixels[..., 0]),
            np.ascontiguousarray(pixels[..., 1]),
        )
        self._maps = cv2.convertMaps(self._column, self._row, cv2.CV_16SC2)
        # what lies behind the camera has no pixel: a corner of the picture that is masked out
        inside = (self._row >= 0) & (self._row <= camera.height_px - 1)
        self.seen = inside & (self._column >= 0) & (self._column <= camera.width_px - 1)

    def warp(self, image: Grey) -> Grey:
        """The road from above, `grid.shape`.

        Raises:
            VehicleError: an image of another size, or not grey.
        """
        size = (self.camera.height_px, self.camera.width_px)
        if image.shape != size:
            raise VehicleError(f"image {image.shape}, a grey one of {size} is needed")
        return np.asarray(
            cv2.remap(image, self._maps[0], self._maps[1], cv2.INTER_LINEAR), dtype=np.uint8
        )
