"""The road plane against the plain way of weighted least squares."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.detect import ground as module
from polemap.detect.ground import Ground, fit_ground, ground_from_mounting
from polemap.stereo.depth_edges import UprightMaps, upright_maps
from tests.polemap.street import RIG, Thing, street


def _plain(maps: UprightMaps) -> Ground:
    """One weight and one least-squares problem a band, by the book."""
    start = ground_from_mounting(RIG)
    prior = np.array([start.offset, start.per_column, start.per_row])
    thin = max(1, 4 // maps.row_step_px)
    rows, columns = np.nonzero(maps.left > 0)
    first = maps.left.shape[0] // 2
    use = (rows >= first) & ((rows - first) % thin == 0) & (columns % 8 == 0)
    rows, columns = rows[use], columns[use]
    d = maps.left[rows, columns].astype(float)
    design = np.stack([np.ones(len(d)), columns, rows * maps.row_step_px], axis=1)
    camera_m = RIG.vehicle_from_camera.z_m
    plane = prior
    for band_m in module._BANDS_M:
        expected = design @ plane
        height = camera_m * (d - expected) / d
        weight = np.clip(1.0 - (height / band_m) ** 2, 0.0, None) ** 2
        weight *= (expected > 1.0) * (camera_m / d) ** 2
        # the pull on the roll is one more row
        pull = np.sqrt(module._ROLL_PULL_PX2 * weight.sum())
        equations = np.vstack([design * np.sqrt(weight)[:, None], [0.0, pull, 0.0]])
        values = np.append(d * np.sqrt(weight), pull * prior[1])
        plane = np.linalg.lstsq(equations, values, rcond=None)[0]
    offset, per_column, per_row = plane.tolist()
    return Ground(offset, per_column, per_row, fitted=True)


@pytest.mark.parametrize("step", [1, 3, 5])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_plane_is_that_of_plain_least_squares(step: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    things = [Thing(float(x), float(y), 1.8, 1.5) for x, y in rng.uniform((6, -4), (20, 4), (4, 2))]
    maps = upright_maps(street(things, rng, 0.2)[2], step)
    ground, plain = fit_ground(maps, RIG), _plain(maps)
    assert ground.fitted
    u, d = np.array([50.0, 320.0, 600.0]), np.array([30.0, 15.0, 40.0])
    assert ground.row_px(u, d) == pytest.approx(plain.row_px(u, d), abs=1e-7)
    # what the road shows moves the plane by far more than the two ways differ
    moved = ground.row_px(u, d) - ground_from_mounting(RIG).row_px(u, d)
    assert np.abs(moved).max() > 1e-3
