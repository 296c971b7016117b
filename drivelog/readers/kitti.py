"""What both KITTI layouts share: the car, calibration files, number lists and rigid motions.

Source: the KITTI car as measured by its makers (wheelbase 2.71 m; left grey camera 1.03 m ahead
of the rear axle and 1.65 m above the road; OXTS 0.05 m behind the rear axle, 0.93 m above the
road). They give no sideways offset: the rear axle's centre is taken to lie straight behind the
left grey camera.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.parsing import text as parsing
from polemap.parsing.errors import named
from polemap.stereo.rig import Mounting, StereoRig

Floats = NDArray[np.float64]

WHEELBASE_M = 2.71
CAMERA_AHEAD_M = 1.03
CAMERA_ABOVE_M = 1.65
OXTS_BEHIND_M = 0.05


def rigid(rotation: Floats, translation: Floats) -> Floats:
    """A `(4, 4)` motion of a rotation `(3, 3)` and a translation `(3,)`."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, translation
    return motion


def read_text(path: Path) -> str:
    """The text of a file.

    Raises:
        InputError: it cannot be read.
    """
    with named(path, InputError):
        return parsing.read_text(path, 1000 * parsing.MEGABYTE)


def read_calibration(path: Path) -> dict[str, Floats]:
    """The entries `name: numbers` of a calibration file; entries that are no numbers are left."""
    entries = {}
    for line in read_text(path).splitlines():
        name, colon, rest = line.partition(":")
        try:
            values = np.array([float(word) for word in rest.split()])
        except ValueError:
            continue
        if colon and len(values):
            entries[name.strip()] = values
    return entries


def entry(calibration: dict[str, Floats], name: str, shape: tuple[int, ...], path: Path) -> Floats:
    """One entry in its shape.

    Raises:
        InputError: absent, of another size, or not finite.
    """
    if name not in calibration:
        raise InputError(f"{path}: entry '{name}:' is missing")
    values = calibration[name]
    if values.size != np.prod(shape) or not np.isfinite(values).all():
        raise InputError(f"{path}: entry '{name}:' must hold {np.prod(shape)} finite numbers")
    return values.reshape(shape)


def read_numbers(path: Path, width: int) -> Floats:
    """A file of `width` numbers a line, `(n, width)`; blank lines are passed over.

    Raises:
        InputError: a line with another count, or with something that is no finite number.
    """
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise InputError(
                f"{path}, line {number}: '{line[:40]}' is not {width} numbers"
            ) from None
        if len(values) != width or not np.isfinite(values).all():
            raise InputError(f"{path}, line {number}: '{line[:40]}' is not {width} finite numbers")
        rows.append(values)
    return np.array(rows, dtype=np.float64).reshape(-1, width)


def rig_of(
    left: Floats, right: Floats, size_px: tuple[int, int], mount: Mounting, path: Path
) -> StereoRig:
    """The rectified rig of two `(3, 4)` projections; `size_px` is width, height.

    Raises:
        InputError: the right camera does not stand to the right of the left one.
    """
    focal = float(left[0, 0])
    baseline = float((left[0, 3] - right[0, 3]) / focal)
    if not baseline > 0:
        raise InputError(f"{path}: the baseline of the two cameras is {baseline:.4f} m")
    return StereoRig(
        size_px[0], size_px[1], focal, float(left[0, 2]), float(left[1, 2]), baseline, mount
    )
