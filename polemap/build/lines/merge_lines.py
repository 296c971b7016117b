"""What drives saw of lines to the lines of a map: one polyline a line, with deviation and evidence.

Neither the order of the drives nor of their pieces matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.build.config import MappingConfig
from polemap.build.drive_observations import DriveObservations
from polemap.build.georeference import ScanViews
from polemap.build.lines.ridges import ACROSS_M, Samples, sample
from polemap.build.lines.seen_lines import MapPieces, pieces_in_map, pieces_of_map
from polemap.build.lines.walk import walk
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LineStyle
from polemap.map.line_map import LineMap, join_lines
from polemap.vehicle.pose import inverse_transform_points

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_WINDOW_M = 2.5  # along, of what a vertex is fitted to
_LENGTH_MIN_M = 4.0
_BEND_VERTICES = 4  # to either side, of what tells the curvature
# what the pieces of one drive share at a place beyond its reference: ground, pitch, calibration
_LASTING_SHARE = 0.5
# a look at a line that is there shows it this often, one at a place without any shows one so often
_DETECTION, _FALSE = 0.5, 0.05
_EVIDENCE_LIMIT = 5.0  # log-odds: the say of one drive, whose looks share what misleads them


def merge_lines(
    ordered: Sequence[DriveObservations],
    config: MappingConfig,
    frame: EarthFrame,
    update: LineMap | None = None,
) -> LineMap | None:
    """The lines of a map; None where no drive looks for lines and no map had any.

    Args:
        ordered: the drives in an order of their own (`DriveObservations.order`).
        update: lines of the map that is brought up to date.
    """
    parts = [
        pieces_in_map(number, part.lines, part.detections.views.poses)
        for number, part in enumerate(ordered)
        if part.lines is not None
    ]
    if update is not None and len(update):
        parts.append(pieces_of_map(update))
    if not parts:
        return update
    every = MapPieces.concatenate(parts)
    views = {
        number: part.detections.views
        for number, part in enumerate(ordered)
        if part.lines is not None
    }
    made = [
        _lines_of_kind(every.take(every.kind == kind), int(kind), views, config, frame)
        for kind in np.unique(every.kind)
    ]
    lines = join_lines([LineMap.empty(frame), *made])
    lines = lines.take(lines.existence >= config.existence_min)
    first = lines.vertices_m[np.cumsum(lines.count) - lines.count]
    lines = lines.take(np.lexsort((*first.T[::-1], lines.kind)))
    return lines.with_columns(ids=_ids(lines, update))


def _lines_of_kind(
    pieces: MapPieces,
    kind: int,
    views: dict[int, ScanViews],
    config: MappingConfig,
    frame: EarthFrame,
) -> LineMap:
    samples = sample(pieces)
    fitted = [
        line
        for path in walk(samples, kind)
        if (line := _fitted(path, samples, pieces, config)) is not None
    ]
    if not fitted:
        return LineMap.empty(frame)
    reach = {number: _reach_m(pieces, number, view) for number, view in views.items()}
    old = [float(np.any(pieces.drive[line.pieces] < 0)) for line in fitted]
    evidence = [
        _log_odds(line, pieces, views, reach) + before * _EVIDENCE_LIMIT
        for line, before in zip(fitted, old, strict=True)
    ]
    return LineMap(
        frame=frame,
        vertices_m=np.concatenate([line.vertices_m for line in fitted]),
        vertex_sd_m=np.concatenate([line.sd_m for line in fitted]),
        ids=np.zeros(len(fitted), dtype=np.int64),
        kind=np.full(len(fitted), kind, dtype=np.int8),
        style=np.array([_style(pieces, line.pieces) for line in fitted], dtype=np.int8),
        count=np.array([len(line.vertices_m) for line in fitted]),
        observations=np.array(
            [int(np.ceil(pieces.weight[line.pieces].sum())) for line in fitted], dtype=np.int64
        ),
        drives=np.array(
            [len(np.unique(pieces.drive[line.pieces])) for line in fitted], dtype=np.int64
        ),
        existence=1.0 / (1.0 + np.exp(-np.array(evidence))),
    )


@dataclass(frozen=True, slots=True)
class _Line:
    """Vertices `(k, 2)`, their deviation across `(k,)`, and the rows of its pieces."""

    vertices_m: Floats
    sd_m: Floats
    pieces: Whole


def _fitted(
    path: Floats, samples: Samples, pieces: MapPieces, config: MappingConfig
) -> _Line | None:
    """A walked path laid through what was seen, or None where too little was."""
    box_low, box_high = path.min(axis=0) - _WINDOW_M, path.max(axis=0) + _WINDOW_M
    near = np.flatnonzero(((samples.seen_m > box_low) & (samples.seen_m < box_high)).all(axis=1))
    seen, owner = samples.seen_m[near], samples.piece[near]
    vertices, deviations, mine = [], [], np.zeros(len(near), dtype=bool)
    bend = _curvature_radpm(path)
    for number, place in enumerate(path):
        along = path[min(number + 1, len(path) - 1)] - path[max(number - 1, 0)]
        along = along / np.hypot(*along)
        normal = np.array([-along[1], along[0]])
        offset = seen - place
        ahead = offset @ along
        across = offset @ normal - 0.5 * bend[number] * ahead**2
        inside = (np.abs(ahead) <= _WINDOW_M) & (np.abs(across) < ACROSS_M)
        mine |= inside
        if not inside.any():
            continue
        shift, sd = _fused(ahead[inside], across[inside], pieces.take(owner[inside]))
        vertices.append(place + shift * normal)
        deviations.append(sd)
    rows = np.unique(owner[mine])
    known = bool(np.any(pieces.drive[rows] < 0))
    if len(vertices) < 2 or (not known and len(rows) < config.observations_min):
        return None
    line = np.array(vertices)
    if float(np.hypot(*np.diff(line, axis=0).T).sum()) < _LENGTH_MIN_M:
        return None
    return _Line(line, np.array(deviations), rows)


def _curvature_radpm(path: Floats) -> Floats:
    """Curvature `(k,)` of a path over the vertices around each, positive to the left."""
    turn = np.zeros(len(path))
    for number in range(1, len(path) - 1):
        reach = min(_BEND_VERTICES, number, len(path) - 1 - number)
        before = path[number] - path[number - reach]
        after = path[number + reach] - path[number]
        angle = np.arctan2(before[0] * after[1] - before[1] * after[0], before @ after)
        turn[number] = 2.0 * angle / (np.hypot(*before) + np.hypot(*after))
    if len(path) > 2:
        turn[0], turn[-1] = turn[1], turn[-2]
    return turn


def _fused(ahead: Floats, across: Floats, pieces: MapPieces) -> tuple[float, float]:
    """Where the line lies across at a vertex, and its deviation: drives are fused by what each one
    knows, and by more than that where they disagree (Birge's ratio)."""
    places, variances = [], []
    for drive in np.unique(pieces.drive):
        of = pieces.drive == drive
        weight = pieces.weight[of] / pieces.sd_m[of] ** 2
        middle, offset = ahead[of], across[of]
        for _ in range(3):
            total = weight.sum()
            place = float(weight @ offset / total)
            spread = float(weight @ (middle - weight @ middle / total) ** 2)
            lean = 0.0
            if spread / total > 0.25:
                centre = weight @ middle / total
                lean = float(weight @ ((middle - centre) * (offset - place)) / spread)
                place -= lean * float(centre)
            error = np.abs(offset - place - lean * middle) / pieces.sd_m[of]
            weight = pieces.weight[of] / pieces.sd_m[of] ** 2 / np.maximum(error / 2.0, 1.0)
        own = float(np.median(pieces.sd_m[of])) ** 2
        shared = float(np.median(pieces.shared_sd_m[of])) ** 2
        free = (1.0 - _LASTING_SHARE) / max(float(pieces.weight[of].sum()), 1.0)
        places.append(place)
        variances.append(shared + own * (_LASTING_SHARE + free))
    found, variance = np.array(places), np.array(variances)
    information = float((1.0 / variance).sum())
    mean = float((found / variance).sum() / information)
    birge = float(((found - mean) ** 2 / variance).sum()) / max(len(found) - 1, 1)
    return mean, float(np.sqrt(max(birge, 1.0) / information))


def _reach_m(pieces: MapPieces, drive: int, views: ScanViews) -> float:
    """How far ahead a drive sees lines of the kind: what nine of ten pieces begin within."""
    mine = pieces.drive == drive
    if not mine.any():
        return 8.0
    middle = 0.5 * (pieces.start_m[mine] + pieces.end_m[mine])
    distance = np.sqrt(
        ((middle[:, None] - views.poses[None, ::10, :2]) ** 2).sum(axis=2).min(axis=1)
    )
    return float(max(np.quantile(distance, 0.9), 6.0))


def _log_odds(
    line: _Line, pieces: MapPieces, views: dict[int, ScanViews], reach: dict[int, float]
) -> float:
    """Evidence for a line: of the looks along it, how many showed it; every drive has its say."""
    total = 0.0
    hit = float(np.log(_DETECTION / _FALSE))
    miss = float(np.log((1.0 - _DETECTION) / (1.0 - _FALSE)))
    for number, view in views.items():
        seen = float(pieces.weight[line.pieces[pieces.drive[line.pieces] == number]].sum())
        near = (
            np.sqrt(((view.poses[:, None, :2] - line.vertices_m[None, ::3]) ** 2).sum(axis=2))
            <= 2.0 * reach[number]
        )
        looks = 0
        for scan in np.flatnonzero(near.any(axis=1)):
            local = inverse_transform_points(view.poses[scan], line.vertices_m[::3][near[scan]])
            inside = (local[:, 0] > 3.0) & (local[:, 0] < 3.0 + reach[number])
            looks += bool((inside & (np.abs(local[:, 1]) < local[:, 0])).any())
        step = hit * seen + miss * max(looks - seen, 0.0)
        total += float(np.clip(step, -_EVIDENCE_LIMIT, _EVIDENCE_LIMIT))
    return total


def _style(pieces: MapPieces, rows: Whole) -> int:
    """What most of the pieces that say something say."""
    told = rows[pieces.style[rows] != LineStyle.UNKNOWN]
    if not len(told):
        return int(LineStyle.UNKNOWN)
    votes = np.bincount(pieces.style[told], pieces.weight[told])
    return int(np.argmax(votes))


def _ids(lines: LineMap, update: LineMap | None) -> Whole:
    """A line keeps the id of the old one that it lies on for the longest way; others are new."""
    fresh = np.arange(len(lines), dtype=np.int64)
    if update is None or not len(update):
        return fresh
    ids = np.full(len(lines), -1, dtype=np.int64)
    taken: set[int] = set()
    for row in range(len(lines)):
        votes: dict[int, int] = {}
        for vertex in lines.polyline_m(row):
            for segment in update.within(vertex, ACROSS_M):
                if update.segments.kind[segment] == lines.kind[row]:
                    name = int(update.ids[update.segments.line[segment]])
                    votes[name] = votes.get(name, 0) + 1
        for name in sorted(votes, key=lambda one: (-votes[one], one)):
            if name not in taken:
                ids[row] = name
                taken.add(name)
                break
    new = ids < 0
    ids[new] = int(update.ids.max()) + 1 + np.arange(np.count_nonzero(new))
    return ids
