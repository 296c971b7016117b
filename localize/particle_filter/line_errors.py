"""Errors of lines that last, in the covariance that is stated: see `persistent_errors.py`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.localize.particle_filter.line_weigher import SHARED, LineMatch, frame_share
from polemap.localize.particle_filter.persistent_errors import PersistentErrors
from polemap.vehicle.kalman import symmetric

Floats = NDArray[np.float64]

# of the mapped lines whose errors are kept, the last that were seen
_MOST = 16
# columns of what the camera errs by in all pieces: to the left, and in direction
_CAMERA = 2


def add_lines(
    errors: PersistentErrors,
    particles: Floats,
    match: LineMatch,
    yaw_rad: float,
    pieces: int,
    share: float,
) -> None:
    """Lines have moved particles of covariance `(3, 3)`, which is that before them.

    The offset of each mapped line lasts as long as the line is seen, and what the pieces of a frame
    have in common (`SHARED`) as long as the camera hangs as it does. The rest of a piece's error is
    new as often as the power of the frame says.

    Args:
        match: pieces that belong to mapped lines.
        yaw_rad: of the car.
        pieces: of the frame, whether they belong to a line or not.
        share: power that the frame's likelihood was raised to, besides `frame_share`.
    """
    if share <= 0.0 or not len(match):
        return
    count = len(match)
    jacobian = np.zeros((2 * count, 3))
    jacobian[:count] = match.jacobian
    jacobian[count:, 2] = 1.0
    seen = np.concatenate([match.seen_m2, match.seen_rad2])
    mapped = np.concatenate([match.mapped_m2, np.zeros(count)])
    used = share * frame_share(pieces)
    across = particles @ jacobian.T
    gain = np.linalg.solve(jacobian @ across + np.diag((seen + mapped) / used), across.T).T
    kept = np.eye(3) - gain @ jacobian
    column = _columns(errors, match.ids)
    lasting = np.zeros((2 * count, errors.lines.shape[1]))
    left = np.array([-np.sin(yaw_rad), np.cos(yaw_rad)])
    lasting[:count, 0] = np.sqrt(SHARED * match.seen_m2) * (match.normal @ left)
    lasting[count:, 1] = np.sqrt(SHARED * match.seen_rad2)
    lasting[np.arange(count), column] = np.sqrt(match.mapped_m2)
    moved = gain @ lasting
    led = kept @ errors.lines
    white = np.diag((1.0 - SHARED) / share * seen)
    errors.keep(kept)
    errors.covariance = symmetric(
        errors.covariance + gain @ white @ gain.T
        + moved @ moved.T - led @ moved.T - moved @ led.T
    )  # fmt: skip
    errors.lines = errors.lines - moved


def _columns(errors: PersistentErrors, ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Columns of the errors of mapped lines `(m,)`, new ones at the end."""
    if not errors.lines.shape[1]:
        errors.lines = np.zeros((3, _CAMERA))
    known = [line for line in errors.line_ids if line not in set(ids.tolist())]
    forgotten = set(known[: max(0, len(known) + len(np.unique(ids)) - _MOST)])
    stay = [i for i, line in enumerate(errors.line_ids) if line not in forgotten]
    kept = np.concatenate([np.arange(_CAMERA), _CAMERA + np.array(stay, dtype=np.int64)])
    names = [errors.line_ids[i] for i in stay]
    names += [line for line in np.unique(ids).tolist() if line not in set(names)]
    errors.lines = np.hstack(
        [errors.lines[:, kept], np.zeros((3, _CAMERA + len(names) - len(kept)))]
    )
    errors.line_ids = names
    order = {line: i for i, line in enumerate(names)}
    return _CAMERA + np.array([order[line] for line in ids.tolist()])
