"""The tree of coordinate frames that /tf and /tf_static span, as far as it does not move."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# a mounting that is published again and again differs by rounding alone
_SAME_M, _SAME_QUATERNION = 1e-3, 1e-3


def transforms_of(message: Any) -> Iterator[tuple[str, str, Floats, Floats]]:
    """Parent, child, translation `(3,)` and quaternion `(4,)` x y z w of a message."""
    several = getattr(message, "transforms", None)
    for one in several if several is not None else (message,):
        part = getattr(one, "transform", one)
        header = getattr(one, "header", None)
        parent = header.frame_id if header is not None else one.parent_frame_id
        child = one.child_frame_id if hasattr(one, "child_frame_id") else ""
        t, q = part.translation, part.rotation
        yield (
            str(parent).lstrip("/"),
            str(child).lstrip("/"),
            np.array([t.x, t.y, t.z], dtype=np.float64),
            np.array([q.x, q.y, q.z, q.w], dtype=np.float64),
        )


class TransformTree:
    """First transform of every pair of frames; pairs that move are known and not used."""

    def __init__(self) -> None:
        self.pairs: dict[tuple[str, str], tuple[Floats, Floats]] = {}
        self.moving: set[tuple[str, str]] = set()

    def add(self, transforms: Iterator[tuple[str, str, Floats, Floats]]) -> None:
        """Take up the transforms of a message."""
        for parent, child, translation, quaternion in transforms:
            size = float(np.linalg.norm(quaternion))
            if not (np.isfinite(translation).all() and np.isfinite(size) and size > 0.5):
                continue
            quaternion = quaternion / size
            known = self.pairs.get((parent, child))
            if known is None:
                self.pairs[parent, child] = translation, quaternion
            elif (parent, child) not in self.moving:
                apart = np.abs(known[0] - translation).max()
                turned = 1.0 - abs(float(known[1] @ quaternion))
                if apart > _SAME_M or turned > _SAME_QUATERNION:
                    self.moving.add((parent, child))

    @property
    def frames(self) -> set[str]:
        """Every frame that is named."""
        return {name for pair in self.pairs for name in pair}

    def fixed(self, target: str, source: str) -> Floats | None:
        """`(4, 4)` target from source over transforms that do not move; None without such a way."""
        if target == source:
            return np.eye(4)
        seen = {target}
        todo: deque[tuple[str, Floats]] = deque([(target, np.eye(4))])
        while todo:
            name, matrix = todo.popleft()
            for (parent, child), (translation, quaternion) in self.pairs.items():
                if (parent, child) in self.moving or name not in (parent, child):
                    continue
                step = rigid_from_quaternion(translation, quaternion)
                other = child if name == parent else parent
                if other in seen:
                    continue
                way = matrix @ (step if name == parent else np.linalg.inv(step))
                if other == source:
                    return np.asarray(way, dtype=np.float64)
                seen.add(other)
                todo.append((other, way))
        return None


def rotation_from_quaternion(quaternion: Floats) -> Floats:
    """Rotation matrices `(..., 3, 3)` of unit quaternions `(..., 4)` x y z w."""
    x, y, z, w = np.moveaxis(np.asarray(quaternion, dtype=np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rigid_from_quaternion(translation: Floats, quaternion: Floats) -> Floats:
    """`(4, 4)` of a translation and a unit quaternion x y z w."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_quaternion(quaternion)
    matrix[:3, 3] = translation
    return matrix
