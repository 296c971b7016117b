"""What the drives of a map say about the poles that new drives add: seen, or looked at in vain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.existence import Evidence, existence
from polemap.build.history import OldMap

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

_NEIGHBOUR_M = 20.0
_SURE = 0.9  # existence by the new drives alone
_FEW = 10  # poles do not tell a share
# of the poles that stand where earlier drives looked: no street changes by so much between drives
_NEW_SHARE_MOST = 0.2


def earlier_drives(
    old: OldMap,
    cluster: Whole,
    points_m: Floats,
    new: Sequence[Evidence],
    stood: NDArray[np.bool_],
) -> tuple[list[tuple[str, float, Evidence]], str | None]:
    """What every drive of the old map counted at the poles of the new one, and what to say.

    At poles that the old map has, its drives' own counts. Where it has none, their scans are those
    at the nearest pole that it has: a drive that had that one in view would have seen this one
    too, had it stood there. That holds for a map that is whole. In one that lacks poles for
    another reason (thinned out, edited, a part of an export) a silence says nothing: where the new
    drives find far more poles between the mapped ones than a street gains, it counts for nothing.

    Args:
        old: the map, taken apart.
        cluster: `(len(old.landmarks),)` row of the new map that each of its traversals went to.
        points_m: poles of the new map `(n, 2)`.
        new: what each new drive counted at them.
        stood: `(len(old map),)` whether a pole stood in the old map.
    """
    n = len(points_m)
    successors = successors_of(old, cluster)
    fresh = np.setdiff1d(np.arange(n), successors[:, 1])
    beside, row = fresh[:0], fresh[:0]
    if len(fresh) and len(cluster) and old.evidence:
        distance, nearest = scipy.spatial.KDTree(old.landmarks.points_m).query(points_m[fresh])
        near = np.asarray(distance) <= _NEIGHBOUR_M
        beside, row = fresh[near], old.pole[np.asarray(nearest)[near]]
    said = None
    share, count = _share_of_new(beside, successors[stood[successors[:, 0]], 1], new)
    if share > _NEW_SHARE_MOST:
        said = (
            f"{count} poles, {share:.0%} of those that the new drives see where earlier drives "
            "looked, are not in the map: it has a part of its poles only, so that poles which it "
            "lacks are not held to be new there"
        )
        beside, row = beside[:0], row[:0]
    drives = []
    for name, when, counts in old.evidence:
        seen, views = np.zeros(n), np.zeros(n)
        np.add.at(seen, successors[:, 1], counts.detected[successors[:, 0]])
        np.add.at(views, successors[:, 1], counts.expected[successors[:, 0]])
        views[beside] = counts.expected[row]
        drives.append((name, when, Evidence(seen, views)))
    return drives, said


def _share_of_new(beside: Whole, confirmed: Whole, new: Sequence[Evidence]) -> tuple[float, int]:
    """Of the poles that the new drives are sure of, the share that the map lacks; their number."""
    if not new or not len(beside):
        return 0.0, 0
    sure = existence(list(new), np.zeros(len(new[0].detected))) >= _SURE
    lacking = int(np.count_nonzero(sure[beside]))
    total = lacking + int(np.count_nonzero(sure[np.unique(confirmed)]))
    return (lacking / total if total >= _FEW else 0.0), lacking


def successors_of(old: OldMap, cluster: Whole) -> Whole:
    """Pairs `(pole of the old map, cluster)`: where most of its detections went.

    Stray traversals that now stand alone inherit nothing.
    """
    width = int(cluster.max(initial=0)) + 1
    links, row = np.unique(old.pole * width + cluster, return_inverse=True)
    weight = np.bincount(row, old.landmarks.observations)
    pole = links // width
    order = np.lexsort((links, -weight, pole))
    _, first = np.unique(pole[order], return_index=True)
    chosen = links[order][first]
    return np.stack([chosen // width, chosen % width], axis=1)
