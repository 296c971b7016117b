"""Rays through the pixels of a picture, and what they hit: half of it is cast, half follows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.simulate.camera_mounting import CameraPose
from polemap.simulate.raycast import Caster, Hits
from polemap.stereo.rig import StereoRig

Floats32 = NDArray[np.float32]


def rays_through(pixels: Floats32, rig: StereoRig, pose: CameraPose) -> Floats32:
    """Rays `(n, 6)` (origin, direction) through places `(n, 2)` of the picture, column and row."""
    turn = pose.rotation.astype(np.float32)
    across = (pixels[:, 0] - np.float32(rig.cx_px)) * np.float32(1 / rig.focal_px)
    down = (pixels[:, 1] - np.float32(rig.cy_px)) * np.float32(1 / rig.focal_px)
    rays = np.empty((len(pixels), 6), dtype=np.float32)
    rays[:, :3] = pose.position_m
    # spelled out: a matrix product of this slim shape is ten times slower
    for axis in range(3):
        rays[:, 3 + axis] = across * turn[axis, 0] + down * turn[axis, 1] + turn[axis, 2]
    return rays


def picture_rays(rig: StereoRig, pose: CameraPose) -> Floats32:
    """`rays_through` every pixel, row by row: the sum of a part by column and a part by row."""
    turn = pose.rotation.astype(np.float32)
    across = (np.arange(rig.width_px, dtype=np.float32) - np.float32(rig.cx_px)) / rig.focal_px
    down = (np.arange(rig.height_px, dtype=np.float32) - np.float32(rig.cy_px)) / rig.focal_px
    rays = np.empty((rig.height_px, rig.width_px, 6), dtype=np.float32)
    rays[..., :3] = pose.position_m
    for axis in range(3):
        column = (across * turn[axis, 0]).astype(np.float32)
        row = (down * turn[axis, 1] + turn[axis, 2]).astype(np.float32)
        np.add(row[:, None], column[None], out=rays[..., 3 + axis])
    return rays.reshape(-1, 6)


def cast_picture(caster: Caster, rays: Floats32, rig: StereoRig) -> Hits:
    """Hits of the rays of a whole picture; every second row is cast, the others mostly follow.

    Along an image column inverse depth, and barycentric coordinates times it, are linear on a
    plane, so the row between is their mean. Only things less than a row high can be missed.
    """
    height, width = rig.height_px, rig.width_px
    rows = rays.reshape(height, width, 6)
    even = caster.cast(np.ascontiguousarray(rows[::2]).reshape(-1, 6))
    odd_rows = height // 2
    shape = (-1, width)
    inverse = (1.0 / even.depth).reshape(shape)
    triangle = even.triangle.reshape(shape)
    bary = even.bary.reshape(-1, width, 2)
    normal = even.normal.reshape(-1, width, 3)
    below = np.minimum(np.arange(odd_rows) + 1, len(triangle) - 1)
    same = (triangle[:odd_rows] == triangle[below]) & (
        (inverse[:odd_rows] > 0) == (inverse[below] > 0)
    )
    same[below == np.arange(odd_rows)] = False
    out = Hits(
        np.empty(height * width, np.float32),
        np.empty(height * width, np.uint32),
        np.empty((height * width, 2), np.float32),
        np.empty((height * width, 3), np.float32),
    )
    grids = (
        out.depth.reshape(height, width),
        out.triangle.reshape(height, width),
        out.bary.reshape(height, width, 2),
        out.normal.reshape(height, width, 3),
    )
    grids[0][::2], grids[1][::2] = even.depth.reshape(shape), triangle
    grids[2][::2], grids[3][::2] = bary, normal
    middle = 0.5 * (inverse[:odd_rows] + inverse[below])
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (1.0 / middle).astype(np.float32)
        between = (
            0.5
            * (
                bary[:odd_rows] * inverse[:odd_rows, :, None]
                + bary[below] * inverse[below][..., None]
            )
            * depth[..., None]
        )
    grids[0][1::2], grids[1][1::2] = depth, triangle[:odd_rows]
    grids[2][1::2], grids[3][1::2] = between, normal[:odd_rows]
    ask = np.flatnonzero(~same.ravel())
    found = caster.cast(rows[1::2].reshape(-1, 6)[ask])
    at = ask + (ask // width + 1) * width
    out.depth[at], out.triangle[at] = found.depth, found.triangle
    out.bary[at], out.normal[at] = found.bary, found.normal
    return out
