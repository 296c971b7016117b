"""What the mapped lines beside a car would tell of its pose in one look."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.localize.particle_filter.line_model import KIND_MODELS
from polemap.localize.particle_filter.line_weigher import SHARED
from polemap.map.line_map import LineMap
from polemap.vehicle.pose import inverse_transform_points, rotate_back, transform_points

Floats = NDArray[np.float64]
LineSds = Mapping[int, tuple[float, float]]

# pieces are seen about so far ahead of the rear axle
_AHEAD_M = 8.0
# across and of the direction, where a drive has no pieces that state it: our choice
_PIECE_SD = (0.05, 0.01)


def stated_sds(scans: Sequence[Detections]) -> LineSds:
    """Median deviations, across (m) and of the direction (rad), that pieces of a kind state."""
    found = [scan.lines for scan in scans if scan.lines is not None and len(scan.lines)]
    if not found:
        return {}
    kind = np.concatenate([lines.kind for lines in found])
    sds = np.stack(
        [
            np.concatenate([lines.offset_sd_m for lines in found]),
            np.concatenate([lines.direction_sd_rad for lines in found]),
        ]
    )
    return {
        one: (float(np.median(sds[0, kind == one])), float(np.median(sds[1, kind == one])))
        for one in np.unique(kind).tolist()
    }


def line_information(
    lines: LineMap, pose: Floats, stated: LineSds
) -> dict[LandmarkKind, tuple[Floats, float]]:
    """Information `(3, 3)` on place (along, aside) and yaw, and the lines expected, by kind.

    Of a line at a point p of the vehicle frame, with normal n, the offset tells `n` of the place
    and `p x n` of the yaw, its direction tells the yaw alone. Pieces of a scan share `SHARED` of
    their variance, so k of them count as `k / (1 + (k - 1) SHARED)`.

    Args:
        pose: `(3,)` of the rear axle in the map.
        stated: see `stated_sds`.
    """
    probe = transform_points(pose, np.array([[_AHEAD_M, 0.0]]))[0]
    reach_m = max(model.view_m for model in KIND_MODELS.values())
    rows = lines.within(probe, reach_m)
    parts = lines.segments
    start = inverse_transform_points(pose, parts.start_m[rows])
    way = rotate_back(parts.end_m[rows] - parts.start_m[rows], pose[2])
    length = np.maximum(np.hypot(*way.T), 1e-9)
    along = way / length[:, None]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    offset = np.array([_AHEAD_M, 0.0]) - start
    station, across = (offset * along).sum(axis=1), (offset * normal).sum(axis=1)
    beside = (station >= 0.0) & (station <= length)
    result: dict[LandmarkKind, tuple[Floats, float]] = {}
    for kind, model in KIND_MODELS.items():
        chosen = beside & (parts.kind[rows] == kind) & (np.abs(across) <= model.view_m)
        _, first = np.unique(parts.line[rows[chosen]], return_index=True)
        mine = np.flatnonzero(chosen)[first]
        if not len(mine):
            continue
        offset_sd, direction_sd = stated.get(kind, _PIECE_SD)
        weight = model.detection * parts.existence[rows[mine]]
        share = 1.0 / (1.0 + (max(float(weight.sum()), 1.0) - 1.0) * SHARED)
        place = np.array([_AHEAD_M, 0.0]) - across[mine, None] * normal[mine]
        lever = normal[mine, 1] * place[:, 0] - normal[mine, 0] * place[:, 1]
        jacobian = np.column_stack([normal[mine], lever])
        variance = offset_sd**2 + model.floor_m**2 + parts.sd_m[rows[mine]] ** 2
        told = (jacobian * (weight / variance)[:, None]).T @ jacobian
        told[2, 2] += weight.sum() / (direction_sd**2 + model.floor_rad**2)
        result[LandmarkKind(kind)] = share * told, float(weight.sum())
    return result
