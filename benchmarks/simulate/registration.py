"""Where windows of the left picture lie in the right one, by least squares instead of a matcher.

A second opinion on sub-pixel disparity: it tells a matcher's error from that of the truth it is
held against (a LiDAR's, say), and it sees rows that are apart, which no matcher reports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.matching import Image

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_HALF_PX, _STEP_PX = 7, 7
_TRUTH_POINTS = 15
_PLANE_RMS_PX = 0.35
_FAR_OFF_PX = 3.0
_CORNER_STRENGTH = 6.0
_LARGEST_RESIDUAL = 0.5
_ROUNDS = 12
_PLACES = np.stack(
    np.meshgrid(*2 * [np.arange(-_HALF_PX, _HALF_PX + 1)]), axis=-1
).reshape(-1, 2)  # fmt: skip
_PLANE = np.column_stack([_PLACES, np.ones(len(_PLACES))]).astype(np.float64)


@dataclass(frozen=True, slots=True)
class Windows:
    """One entry a window that is plane, has corners and was found again, in pixels.

    Attributes:
        found_px, truth_px: disparity of the planes through the matcher's and the true values.
        registered_px: disparity by least squares.
        rows_px: how far down, the same way, the window lies in the right picture.
    """

    found_px: Floats
    truth_px: Floats
    registered_px: Floats
    rows_px: Floats

    def figures(self) -> dict[str, float]:
        """Medians over the windows."""
        return {
            "windows": float(len(self.found_px)),
            "found_truth_px": _middle(self.found_px - self.truth_px),
            "registered_truth_px": _middle(self.registered_px - self.truth_px),
            "found_registered_px": _middle(self.found_px - self.registered_px),
            "rows_apart_px": _middle(self.rows_px),
        }


def together(parts: Sequence[Windows]) -> Windows:
    """The windows of several pairs."""
    names = ("found_px", "truth_px", "registered_px", "rows_px")
    return Windows(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def register(
    left: Image,
    right: Image,
    found_px: Floats32,
    truth_px: Floats32,
    known: Mask,
) -> Windows:
    """Registers the windows of a pair; `known` says where the truth counts, all `(h, w)`.

    A window counts where found and true disparity are planes less than 3 px apart. It starts from
    the matcher's plane and shifts along and across the row until the grey values, brought to one
    mean and contrast, agree best (Gauss-Newton).
    """
    u, v = _grid(left.shape)
    keep = (np.isfinite(found_px)[v, u].mean(axis=1) > 0.9) & (
        known[v, u].sum(axis=1) >= _TRUTH_POINTS
    )
    u, v = u[keep], v[keep]
    found, found_rms = _planes(found_px[v, u], np.isfinite(found_px)[v, u])
    truth, truth_rms = _planes(truth_px[v, u], known[v, u])
    keep = (found_rms < _PLANE_RMS_PX) & (truth_rms < _PLANE_RMS_PX)
    keep &= np.abs(found[:, 2] - truth[:, 2]) < _FAR_OFF_PX
    keep &= _corner_strength(left.astype(np.float32), u, v) > _CORNER_STRENGTH
    u, v, found, truth = u[keep], v[keep], found[keep], truth[keep]
    shift, residual = _shifts(left.astype(np.float32), right.astype(np.float32), u, v, found)
    good = (np.abs(shift).max(axis=1, initial=0) < 2.0) & (residual < _LARGEST_RESIDUAL)
    registered = found[:, 2] - shift[:, 0]
    return Windows(found[good, 2], truth[good, 2], registered[good], shift[good, 1])


def _middle(differences: Floats) -> float:
    return float(np.median(np.abs(differences)))


def _grid(shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows `(n, k)` of the pixels of all windows."""
    edge = _HALF_PX + 3
    v, u = np.mgrid[edge : shape[0] - edge : _STEP_PX, edge : shape[1] - edge : _STEP_PX]
    return u.reshape(-1, 1) + _PLACES[:, 0], v.reshape(-1, 1) + _PLACES[:, 1]


def _planes(values: Floats32, use: Mask) -> tuple[Floats, Floats]:
    """Robust planes `(n, 3)` (slopes and middle) through windows, and their spread `(n,)`."""
    z = np.where(use, values, 0.0).astype(np.float64)
    weight = use.astype(np.float64)
    for _ in range(4):
        normals = np.einsum("nk,ki,kj->nij", weight, _PLANE, _PLANE) + 1e-6 * np.eye(3)
        sums = np.einsum("nk,ki->ni", weight * z, _PLANE)
        plane = np.linalg.solve(normals, sums[..., None])[..., 0]
        off = z - plane @ _PLANE.T
        weight = use / (1 + (off / 0.5) ** 2)
    spread = (np.minimum(off**2, 4.0) * use).sum(axis=1) / np.maximum(use.sum(axis=1), 1)
    return plane, np.sqrt(spread)


def _corner_strength(
    image: Floats32, u: NDArray[np.int64], v: NDArray[np.int64]
) -> NDArray[np.floating]:
    """Smaller eigenvalue `(n,)` of the structure tensor: texture both ways."""
    x, y = (step[v, u] for step in _slopes(image))
    xx, yy, xy = (x * x).mean(axis=1), (y * y).mean(axis=1), (x * y).mean(axis=1)
    return np.asarray((xx + yy) / 2 - np.sqrt(((xx - yy) / 2) ** 2 + xy**2))


def _slopes(image: Floats32) -> tuple[Floats32, Floats32]:
    """Derivatives of the grey value along rows and columns."""
    x, y = (cv2.Sobel(image, cv2.CV_32F, a, 1 - a, scale=1 / 8) for a in (1, 0))
    return np.asarray(x, np.float32), np.asarray(y, np.float32)


def _sample(image: Floats32, x: Floats, y: Floats) -> Floats:
    """Grey values between pixels."""
    place = (x.astype(np.float32), y.astype(np.float32))
    return np.asarray(cv2.remap(image, *place, cv2.INTER_LANCZOS4), dtype=np.float64)


def _shifts(
    left: Floats32,
    right: Floats32,
    u: NDArray[np.int64],
    v: NDArray[np.int64],
    planes: Floats,
) -> tuple[Floats, Floats]:
    """Shifts `(n, 2)` in the right picture from where the planes put the windows; residuals."""
    along, down = _slopes(right)
    seen = _normal(left[v, u].astype(np.float64))
    shift = np.zeros((len(u), 2))
    columns = u - planes @ _PLANE.T
    for _ in range(_ROUNDS):
        x, y = columns + shift[:, :1], v + shift[:, 1:]
        there = _sample(right, x, y)
        error = seen * there.std(axis=1, keepdims=True) - _centred(there)
        a, b = (_centred(_sample(slope, x, y)) for slope in (along, down))
        aa, bb, ab = (a * a).sum(axis=1), (b * b).sum(axis=1), (a * b).sum(axis=1)
        ae, be = (a * error).sum(axis=1), (b * error).sum(axis=1)
        step = np.column_stack([bb * ae - ab * be, aa * be - ab * ae])
        step /= (aa * bb - ab * ab + 1e-6)[:, None]
        shift += np.clip(step, -0.5, 0.5)
    there = _normal(_sample(right, columns + shift[:, :1], v + shift[:, 1:]))
    return shift, np.sqrt(((there - seen) ** 2).mean(axis=1))


def _centred(windows: Floats) -> Floats:
    return np.asarray(windows - windows.mean(axis=1, keepdims=True))


def _normal(windows: Floats) -> Floats:
    return np.asarray(_centred(windows) / (windows.std(axis=1, keepdims=True) + 1e-6))
