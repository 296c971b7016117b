"""Lines that `polemap detect` found: rows of its lines.csv, and drawn into its pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.detect.lines.road_frame import road_frame
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.perception import PerceivedFrame
from polemap.stereo.rig import StereoRig

Picture = NDArray[np.uint8]

COLUMNS = (
    "frame", "stamp_s", "kind", "style", "x0_m", "y0_m", "x1_m", "y1_m", "offset_sd_m",
    "direction_sd_rad", "probability",
)  # fmt: skip
COLOURS = {
    LandmarkKind.LANE_MARKING: (0, 215, 255),
    LandmarkKind.KERB: (255, 90, 0),
    LandmarkKind.FACADE: (200, 60, 200),
}
_NAMES = {
    LandmarkKind.LANE_MARKING: "lane markings",
    LandmarkKind.KERB: "kerbs",
    LandmarkKind.FACADE: "facades",
}


def line_rows(perceived: PerceivedFrame) -> list[list[Any]]:
    """Rows of `COLUMNS`; none where no lines were looked for."""
    lines = perceived.view.lines
    if lines is None:
        return []
    return [
        [
            perceived.frame.index,
            f"{perceived.frame.stamp_s:.6f}",
            LandmarkKind(lines.kind[row]).name.lower(),
            LineStyle(lines.style[row]).name.lower(),
            *(f"{value:.4f}" for value in lines.start_vehicle_m[row]),
            *(f"{value:.4f}" for value in lines.end_vehicle_m[row]),
            f"{lines.offset_sd_m[row]:.4f}",
            f"{lines.direction_sd_rad[row]:.5f}",
            f"{lines.probability[row]:.4f}",
        ]
        for row in range(len(lines))
    ]


@dataclass(slots=True)
class CountedLines:
    """How many pieces all frames showed, of each kind."""

    frames: int = 0
    pieces: dict[LandmarkKind, int] = field(default_factory=dict)

    def add(self, perceived: PerceivedFrame) -> None:
        lines = perceived.view.lines
        self.frames += 1
        for kind in [] if lines is None else lines.kind.tolist():
            self.pieces[LandmarkKind(kind)] = self.pieces.get(LandmarkKind(kind), 0) + 1

    def told(self) -> str:
        """Such as `12 kerbs (1.2 a frame)`."""
        each = [
            f"{n} {_NAMES[kind]} ({n / max(self.frames, 1):.1f} a frame)"
            for kind, n in sorted(self.pieces.items())
        ]
        return "pieces of lines: " + (", ".join(each) or "none")


def draw_lines(picture: Picture, perceived: PerceivedFrame, rig: StereoRig) -> Picture:
    """Markings and kerbs in the left image, as if on the road's plane."""
    lines, view = perceived.view.lines, perceived.view
    if lines is None or not view.ground.fitted:
        return picture
    frame = road_frame(view.ground, rig)
    for kind, start, end in zip(
        lines.kind.tolist(), lines.start_vehicle_m, lines.end_vehicle_m, strict=True
    ):
        pixels = np.rint(frame.pixels(np.stack([start, end]))).astype(np.int32)
        cv2.polylines(picture, [pixels], False, COLOURS[LandmarkKind(kind)], 2, cv2.LINE_AA)
    return picture
