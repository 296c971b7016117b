"""Pictures of a lane: paint and fit on the image, and the road from above beside it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.samples import Image
from polemap.electric.lanes import eight_bits
from polemap.stereo.lane import SIDES, LaneFinder, LaneObservation

Picture = NDArray[np.uint8]
_LINE, _PAINT, _TEXT = (80, 220, 60), (60, 160, 255), (255, 255, 255)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


class LanePictures:
    """Writes a picture of each `every`-th row to a folder."""

    def __init__(self, folder: Path, finder: LaneFinder, every: int = 1) -> None:
        self._folder, self._finder, self._every = folder, finder, every
        self._count = 0

    def __call__(self, row: int, image: Image, seen: LaneObservation | None) -> None:
        """Called for each row in turn.

        Raises:
            InputError: the picture cannot be written.
        """
        wanted = self._count % self._every == 0
        self._count += 1
        if wanted:
            path = self._folder / f"{row:06d}.png"
            if not cv2.imwrite(str(path), overlay(self._finder, image, seen)):
                raise InputError(f"{path}: the picture cannot be written")


def overlay(finder: LaneFinder, image: Image, seen: LaneObservation | None) -> Picture:
    """`(height, width, 3)`, blue first: the image, and beside it the road from above."""
    grey = eight_bits(image)
    above = np.asarray(
        cv2.cvtColor(finder.birds_eye.warp(grey), cv2.COLOR_GRAY2BGR), dtype=np.uint8
    )
    picture = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    if seen is None:
        cv2.putText(picture, "no lane", (12, 28), _FONT, 0.7, (70, 70, 255), 2, cv2.LINE_AA)
    else:
        _draw(finder, picture, above, seen)
    scale = picture.shape[0] / above.shape[0]
    beside = cv2.resize(above, (max(1, round(above.shape[1] * scale)), picture.shape[0]))
    return np.asarray(np.hstack([picture, beside]), dtype=np.uint8)


def _draw(finder: LaneFinder, picture: Picture, above: Picture, seen: LaneObservation) -> None:
    grid, camera = finder.birds_eye.grid, finder.birds_eye.camera
    for paint in seen.points_m.values():
        columns, rows = _cells(finder, paint)
        for column, row in zip(columns, rows, strict=True):
            cv2.circle(above, (int(column), int(row)), 1, _PAINT, -1)
        for row, column in camera.road_to_pixel(paint[::3]):
            cv2.circle(picture, (round(column), round(row)), 2, _PAINT, -1)
    x = np.linspace(grid.near_m, grid.far_m, 60)
    for side in SIDES:
        line = np.column_stack([x, finder.line(seen.fit, side, x)])
        thickness = 2 if side in seen.points_m else 1
        pixels = np.rint(camera.road_to_pixel(line)[:, ::-1]).astype(np.int32)
        cv2.polylines(picture, [pixels], False, _LINE, thickness, cv2.LINE_AA)
        cells = np.rint(np.column_stack(_cells(finder, line))).astype(np.int32)
        cv2.polylines(above, [cells], False, _LINE, thickness)
    text = (
        f"heading {np.degrees(seen.heading_rad):+.2f} deg, offset {seen.lateral_offset_m:+.2f} m, "
        f"curvature {seen.curvature_per_m:+.4f} 1/m, width {seen.width_m:.2f} m"
    )
    cv2.rectangle(picture, (0, 0), (picture.shape[1], 22), (0, 0, 0), -1)
    cv2.putText(picture, text, (8, 16), _FONT, 0.45, _TEXT, 1, cv2.LINE_AA)


def _cells(finder: LaneFinder, points_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Columns and rows of road points in the view from above."""
    grid = finder.birds_eye.grid
    rows = (grid.far_m - points_m[:, 0]) / grid.along_m - 0.5
    return (grid.half_width_m - points_m[:, 1]) / grid.across_m - 0.5, rows
