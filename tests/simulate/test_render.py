"""Rendering against geometry: planes, poles, disparity; shortcuts against the plain way."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from polemap.simulate.camera_mounting import CameraPose, camera_poses
from polemap.simulate.materials import TILES
from polemap.simulate.mesh import box, cylinder, join, quads
from polemap.simulate.picture_rays import cast_picture, picture_rays, rays_through
from polemap.simulate.raycast import Caster
from polemap.simulate.render import Renderer, RenderOptions
from polemap.simulate.shading import SKY_OWNER
from polemap.simulate.world import World
from polemap.stereo.rig import Mounting, StereoRig, rotation_from_angles

RIG = StereoRig(161, 121, 150.0, 80.0, 60.0, 0.4, Mounting(1.5, 0.2, 1.4))
NOTHING = join([])


def plain(world: World) -> World:
    """A flat ground of 200 m and one post of 30 cm, 10 m ahead and 1 m to the left."""
    corner = np.array([[[-100, -100, 0], [100, -100, 0], [100, 100, 0], [-100, 100, 0]]])
    ground = quads(corner, corner[..., :2] * 0.3, TILES["grass"], 1.0, 0.3)
    post = cylinder((10, 1, 0), (10, 1, 3), 0.15, 0.15, TILES["metal"], sides=64).owned_by(7)
    return replace(world, mesh=join([ground, post]))


@pytest.fixture(scope="module")
def renderer(world: World) -> Renderer:
    return Renderer(plain(world), RIG, RenderOptions(shadows=False, edge_rays=0))


@pytest.fixture(scope="module")
def poses() -> tuple[CameraPose, CameraPose]:
    return camera_poses(RIG, np.zeros(3), np.eye(3))


def test_the_ground_has_the_disparity_of_a_plane(
    renderer: Renderer, poses: tuple[CameraPose, CameraPose]
) -> None:
    left, right = renderer.pair(poses, NOTHING)
    below = np.arange(70, 121)
    expected = RIG.baseline_m / 1.4 * (below - RIG.cy_px)
    for view in (left, right):
        found = renderer.true_disparity(view)[70:, 5]
        assert np.allclose(found, expected, rtol=1e-4)
    assert (left.owner[:50, :30] == SKY_OWNER).all()
    assert np.isinf(left.depth_m[:50, :30]).all()


def test_a_post_stands_where_the_rig_projects_it(
    renderer: Renderer, poses: tuple[CameraPose, CameraPose]
) -> None:
    left, right = renderer.pair(poses, NOTHING)
    u, v, disparity = RIG.project(np.array([10.0, 1.0, 1.4]))
    for view, column in ((left, u), (right, u - disparity)):
        seen = np.flatnonzero(view.owner[int(v)] == 7)
        assert (seen[0] + seen[-1]) / 2 == pytest.approx(column, abs=0.75)
        width = 0.3 * RIG.focal_px / 8.5
        assert len(seen) == pytest.approx(width, abs=1.5)


@pytest.mark.parametrize(("axis", "moved"), [(0, (0.0, 1.0)), (1, (-1.0, 0.0))])
def test_a_right_camera_out_of_true_sees_things_shifted(
    renderer: Renderer, axis: int, moved: tuple[float, float]
) -> None:
    angle = np.deg2rad(4.0)
    tilt = cv2.Rodrigues(angle * np.eye(3)[axis])[0]
    centres = []
    for right_tilt in (None, tilt):
        left, right = renderer.pair(
            camera_poses(RIG, np.zeros(3), np.eye(3), right_tilt), NOTHING
        )  # fmt: skip
        rows, columns = np.nonzero(right.owner == 7)
        # the post's foot: its top leaves the picture
        foot = rows.max()
        centres.append((columns[rows == foot - 2].mean(), float(foot)))
        assert (left.owner == 7).any()
    shift = np.subtract(centres[1], centres[0])
    assert shift == pytest.approx(np.array(moved) * RIG.focal_px * np.tan(angle), abs=1.6)


def test_left_and_right_agree_where_both_see(
    renderer: Renderer, poses: tuple[CameraPose, CameraPose]
) -> None:
    left, right = renderer.pair(poses, NOTHING)
    disparity, other = renderer.true_disparity(left), renderer.true_disparity(right)
    v, u = np.nonzero((left.owner == 0) & (disparity > 0.5))
    partner = u - disparity[v, u]
    inside = partner >= 0
    v, u, partner = v[inside], u[inside], partner[inside]
    near = np.rint(partner).astype(int)
    same = right.owner[v, near] == 0
    assert same.mean() > 0.95
    assert np.abs(other[v, near] - disparity[v, u])[same].max() < 0.05


def test_rays_of_the_picture_go_through_its_pixels() -> None:
    pose, _ = camera_poses(RIG, np.array([1.0, 2.0, 0.0]), rotation_from_angles(0.7, 0.02, 0.03))
    u, v = np.meshgrid(np.arange(RIG.width_px), np.arange(RIG.height_px))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32)
    through = rays_through(pixels, RIG, pose)
    assert np.allclose(picture_rays(RIG, pose), through, atol=1e-6)
    seen = (through[:, 3:] @ pose.rotation) * RIG.focal_px
    assert np.allclose(seen[:, :2] + [RIG.cx_px, RIG.cy_px], pixels, atol=1e-3)


def test_skipping_rows_equals_casting_them_all(world: World) -> None:
    start = world.route.at(np.array(5.0), -1.65)
    turn = rotation_from_angles(float(start[2]), 0.02, 0.03)
    pose, _ = camera_poses(RIG, np.array([start[0], start[1], 0.0]), turn)
    rays = picture_rays(RIG, pose)
    caster = Caster(world.mesh)
    fast, slow = cast_picture(caster, rays, RIG), caster.cast(rays)
    same = fast.triangle == slow.triangle
    # leaves and leaf gaps below a pixel may differ
    assert same.mean() > 0.985
    seen = same & np.isfinite(slow.depth)
    assert np.allclose(fast.depth[seen], slow.depth[seen], rtol=2e-4)
    assert np.allclose(fast.bary[seen], slow.bary[seen], atol=5e-3)


def test_moving_things_cover_what_is_behind_and_hide_behind_what_is_before(
    renderer: Renderer, poses: tuple[CameraPose, CameraPose]
) -> None:
    before = box((6, -0.5, 1), (0.5, 1.0, 2), TILES["paint"]).owned_by(100)
    behind = box((16, 1.5, 1.4), (0.5, 0.4, 0.4), TILES["paint"]).owned_by(101)
    left, _ = renderer.pair(poses, join([before, behind]))
    alone, _ = renderer.pair(poses, NOTHING)
    assert (left.owner == 100).sum() > 300
    assert (left.depth_m[left.owner == 100] < 6.5).all()
    post_row = np.flatnonzero(alone.owner[60] == 7)
    assert (left.owner[60, post_row] == 7).all()
    rest = (left.owner != 100) & (left.owner != 101)
    assert np.array_equal(left.depth_m[rest], alone.depth_m[rest])


def test_extra_rays_free_thin_posts_from_the_pixel_grid(world: World) -> None:
    """The centre of darkness of a post against its true column, at many sub-pixel places."""
    corner = np.array([[[41, -60, -60], [41, -60, 60], [41, 60, 60], [41, 60, -60]]])
    wall = quads(corner, corner[..., 1:] * 0, TILES["marking"], 1.0, 0.0)
    sides = np.linspace(-3.0, 3.0, 13) + np.linspace(0, 0.055, 13)
    posts = [
        cylinder((10, y, -5), (10, y, 9), 0.08, 0.08, TILES["cloth"], 0.05).owned_by(3)
        for y in sides
    ]
    scene = replace(world, mesh=join([wall, *posts]))
    pose = camera_poses(RIG, np.zeros(3), np.eye(3))
    spread = []
    for rays in (0, 4):
        options = RenderOptions(shadows=False, edge_rays=rays)
        row = Renderer(scene, RIG, options).pair(pose, NOTHING)[0].irradiance[60]
        errors = []
        for y in sides:
            truth = RIG.project(np.array([10.0, y, 1.4]))[0]
            columns = np.arange(round(truth) - 4, round(truth) + 5)
            dark = 1 - row[columns] / row[columns[[0, -1]]].mean()
            dark[dark < 0.1] = 0
            errors.append((dark * columns).sum() / dark.sum() - truth)
        spread.append(np.std(errors))
    assert spread[1] < 0.6 * spread[0]
    assert spread[1] < 0.25


def test_shadows_from_the_map_equal_shadows_from_rays(world: World) -> None:
    start = world.route.at(np.array(30.0), -1.65)
    poses = camera_poses(
        RIG, np.array([start[0], start[1], 0.0]), rotation_from_angles(float(start[2]), 0, 0)
    )
    views = {
        by_rays: Renderer(
            world, RIG, RenderOptions(shadows=True, shadow_rays=by_rays, edge_rays=0)
        ).pair(poses, NOTHING)[0]
        for by_rays in (False, True)
    }
    lit = Renderer(world, RIG, RenderOptions(shadows=False, edge_rays=0)).pair(poses, NOTHING)[0]
    dark = {k: v.irradiance < 0.97 * lit.irradiance for k, v in views.items()}
    assert dark[True].mean() > 0.01
    assert (dark[True] != dark[False]).mean() < 0.03


def test_no_mesh_no_hits() -> None:
    caster = Caster(NOTHING)
    rays = np.zeros((4, 6), np.float32)
    assert np.isinf(caster.cast(rays).depth).all()
    assert not caster.blocked(rays).any()
