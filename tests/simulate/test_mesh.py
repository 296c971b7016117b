"""Meshes: areas, closed surfaces, placing and owners."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.simulate.mesh import Mesh, box, cards, cylinder, join, panel

sizes = st.floats(0.1, 20.0)
angles = st.floats(-np.pi, np.pi)


def areas(mesh: Mesh) -> np.ndarray:
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]].astype(np.float64) for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def volume(mesh: Mesh) -> float:
    """By the divergence theorem; right only if the surface is closed and turned outwards."""
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]].astype(np.float64) for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


@given(sizes, sizes, sizes)
def test_a_box_is_closed(x: float, y: float, z: float) -> None:
    mesh = box((1.0, -2.0, 0.5), (x, y, z), 1)
    assert areas(mesh).sum() == pytest.approx(2 * (x * y + y * z + z * x), rel=1e-4)
    assert volume(mesh) == pytest.approx(x * y * z, rel=1e-3)


def test_a_fine_cylinder_has_the_surface_of_a_round_one() -> None:
    mesh = cylinder((0, 0, 0), (0.4, 0, 3.0), 0.2, 0.2, 1, sides=200, cap=False)
    length = np.hypot(0.4, 3.0)
    assert areas(mesh).sum() == pytest.approx(2 * np.pi * 0.2 * length, rel=1e-3)


@given(st.floats(-50, 50), st.floats(-50, 50), angles, st.floats(0.3, 3.0))
def test_placing_scales_areas_and_keeps_heights(x: float, y: float, turn: float, s: float) -> None:
    mesh = box((0, 0, 1), (1, 2, 2), 3)
    moved = mesh.placed(x, y, 4.0, turn, s)
    assert np.allclose(areas(moved), areas(mesh) * s**2, rtol=1e-3)
    assert moved.vertices_m[:, 2].min() == pytest.approx(4.0, abs=1e-4)
    assert moved.vertices_m[:, 2].max() == pytest.approx(4.0 + 2 * s, abs=1e-3)


def test_joining_keeps_every_triangle_and_owner() -> None:
    first = box((0, 0, 0), (1, 1, 1), 1).owned_by(7, 0.5)
    second = panel((0, 0, 0), (1, 0, 0), (0, 0, 1), 2).owned_by(9)
    both = join([first, second])
    assert len(both) == len(first) + len(second)
    assert areas(both).sum() == pytest.approx(areas(first).sum() + areas(second).sum())
    assert set(both.owner[:12]) == {7}
    assert set(both.owner[12:]) == {9}
    assert np.allclose(both.surface[:12, 6], 0.5)
    assert len(join([])) == 0


def test_cards_lie_where_they_are_asked_to() -> None:
    rng = np.random.default_rng(0)
    centres = rng.uniform(-5, 5, (400, 3))
    mesh = cards(centres, 0.2, 4, 1.0, 1.0, rng)
    middle = mesh.vertices_m.reshape(-1, 3, 3).mean(axis=1)
    assert np.abs(middle - centres).max() < 0.2
