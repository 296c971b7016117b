"""Scenario files: what they may say, what they are told when wrong, what a world is made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from polemap.drivelog.errors import ConfigError, InputError
from polemap.simulate.route import make_route
from polemap.simulate.scenario import Scenario, load_scenario, scenario_names
from polemap.simulate.world import KINDS, World, make_world


@pytest.mark.parametrize("name", scenario_names())
def test_every_world_of_the_package_can_be_drawn(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    route = make_route(
        scenario.route.corners_m, scenario.route.corner_radius_m, scenario.route.closed
    )
    assert 200 < route.length_m < 2000
    assert all(row.kind in KINDS for row in scenario.rows)


def test_the_worlds_are_there() -> None:
    assert {"suburb", "avenue", "boulevard", "park_loop"} <= set(scenario_names())


def test_a_file_of_ones_own(tmp_path: Path, street: Scenario) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(street.model_dump(mode="json")))
    assert load_scenario(path) == street


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("name: [", InputError, r"mine.yaml: not YAML \(line \d+"),
        ("- 1", InputError, "expected a mapping"),
        ("name: x", ConfigError, "route: Field required"),
        (
            "name: x\nroute: {corners_m: [[0, 0], [9, 9]], curner: 3}",
            ConfigError,
            r"route.curner: Extra inputs are not permitted \(got 3\)",
        ),
        (
            "name: x\nroute: {corners_m: [[0, 0], [9, 9]]}\nlight: {sun: -1}",
            ConfigError,
            r"light.sun: .* \(got -1\)",
        ),
    ],
)
def test_what_is_wrong_is_named(
    tmp_path: Path, text: str, error: type[Exception], message: str
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(error, match=message):
        load_scenario(path)


def test_an_unknown_world_is_told_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"'mars' is neither a file nor .*park_loop"):
        load_scenario("mars")


def test_an_unknown_kind_is_told_the_known_ones(street: Scenario) -> None:
    row = street.rows[0].model_copy(update={"kind": "maypole"})
    with pytest.raises(ConfigError, match=r"rows.0.kind is 'maypole'; known kinds: .*lamp"):
        make_world(street.model_copy(update={"rows": [row]}), 1)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_kind_stands_on_the_ground_and_is_as_thick_as_it_says(kind: str) -> None:
    from polemap.simulate.objects import Wish

    for seed in range(3):
        made = KINDS[kind](np.random.default_rng(seed), Wish())
        vertices = made.mesh.vertices_m
        assert vertices[:, 2].min() == pytest.approx(0.0, abs=0.25)
        assert np.isfinite(vertices).all()
        if made.pole:
            low = vertices[(vertices[:, 2] > -0.2) & (vertices[:, 2] < 0.3)]
            near = np.hypot(low[:, 0], low[:, 1])
            assert near.min() <= made.width_m * 0.75
            assert 0.04 <= made.width_m <= 0.7


def test_poles_stand_where_the_map_says(world: World) -> None:
    poles = world.poles()
    assert len(poles) > 5
    for pole in poles:
        own = world.mesh.owner == pole.owner
        corners = world.mesh.vertices_m[world.mesh.triangles[own].ravel()]
        low = corners[corners[:, 2] < corners[:, 2].min() + 0.3]
        assert low[:, 0].mean() == pytest.approx(pole.x_m, abs=0.12)
        assert low[:, 1].mean() == pytest.approx(pole.y_m, abs=0.12)


def test_removing_a_pole_moves_no_other(street: Scenario, world: World) -> None:
    gone = world.poles()[2]
    without = make_world(street, 5, frozenset({gone.owner}))
    assert set(world.objects) - set(without.objects) == {gone}
    assert (without.mesh.owner == gone.owner).sum() == 0
    kept = world.mesh.owner != gone.owner
    assert np.array_equal(without.mesh.surface, world.mesh.surface[kept])


def test_the_light_can_be_changed(street: Scenario) -> None:
    assert street.lit("dusk").light.sun == 0
    assert street.lit("scenario") == street


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match=r"mine.yaml: is not UTF-8 text"):
        load_scenario(path)
