from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from benchmarks.localize import city_growth, reliability, structures
from benchmarks.localize.cities import City, changed, make_city, motion_along, route
from benchmarks.localize.places import Start, drive_through, one_start, show
from tests.localize.place.town import drive_in, index_of, town


@pytest.mark.parametrize("poles", [300, 5000])
def test_a_city_is_that_of_its_seed_and_about_as_large_as_asked(poles: int) -> None:
    one, same, other = make_city(poles, 3), make_city(poles, 3), make_city(poles, 4)
    np.testing.assert_array_equal(one.points_m, same.points_m)
    assert len(one.points_m) != len(other.points_m) or not np.allclose(one.points_m, other.points_m)
    assert 0.6 * poles < len(one) < 1.6 * poles
    assert (np.diff(one.points_m[:, 1]) >= 0.0).all()


def test_a_route_keeps_to_the_streets_and_bends_as_a_car_can() -> None:
    city = town(0)
    poses = route(city, 200.0, np.random.default_rng(1))
    assert len(poses) == 401
    step = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    np.testing.assert_allclose(step, 0.5, atol=0.06)
    turn = np.abs(np.diff(np.unwrap(poses[:, 2])))
    assert turn.max() < 0.4
    away = np.hypot(*(poses[:, np.newaxis, :2] - city.points_m).transpose(2, 0, 1)).min(axis=1)
    assert away.min() > 0.4
    motion = motion_along(poses, 10.0)
    np.testing.assert_allclose(motion.at(motion.stamp_s[-1])[0, :2], poses[-1, :2], atol=0.1)


def test_a_city_that_has_changed_has_lost_and_gained_as_many() -> None:
    city = make_city(20_000, 0)
    later = changed(city, 0.1, np.random.default_rng(2))
    kept = len(np.intersect1d(later.points_m[:, 0], city.points_m[:, 0]))
    assert kept == pytest.approx(0.95 * len(city), rel=0.02)
    assert len(later) == pytest.approx(len(city), rel=0.02)


def test_what_came_of_starts_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    drive, motion = drive_in(0, 1)
    assert drive.odometry is not None
    start = one_start(index_of(), drive.scans, drive.odometry, lambda s: motion.at(s)[0], 1)
    assert start.found
    wrong = Start(2, True, 30.0, 80.0, 3.0, 1e-4, (9.0,))
    assert not wrong.found
    show("town", [start, wrong])
    told = capsys.readouterr().out
    assert "town: 2 starts, 1 found, 1 claimed wrongly [(2, 80.0, 3.0)]" in told
    scans, odometry, _ = drive_through(town(0), 5)
    assert len(scans) > 100
    assert len(odometry) > 900


def test_claims_are_the_first_search_of_a_drive_that_is_accepted(tmp_path: Path) -> None:
    def row(start: int, after_m: float, bound: float, off_m: float | None) -> reliability.Row:
        return reliability.Row("orchard", 1, start, off_m is not None, after_m, bound, off_m)

    rows = [row(1, 20.0, 0.5, 9.0), row(1, 25.0, 0.05, 9.0), row(1, 30.0, 2e-4, 0.1),
            row(2, 20.0, 0.02, None)]  # fmt: skip
    assert [one.bound for one in reliability.claims(rows, 0.1)] == [0.05, 0.02]
    assert [one.wrong for one in reliability.claims(rows, 0.1)] == [True, True]
    assert [one.wrong for one in reliability.claims(rows, 1e-3)] == [False]
    told = reliability.table(rows).splitlines()
    assert told[2].startswith("| 0.001 | 0 of 0 |")
    assert told[2].endswith("| 0 of 1, 0.0002 |")
    assert told[-1].endswith("| 2 of 2, 0.035 |")
    assert reliability.known(tmp_path / "none.jsonl") == []
    (tmp_path / "rows.jsonl").write_text("".join(json.dumps(asdict(one)) + "\n" for one in rows))
    assert reliability.known(tmp_path / "rows.jsonl") == rows


@pytest.mark.parametrize("made", [structures.estates, structures.lattice, structures.orchard])
def test_cities_of_other_structures_have_streets_between_their_poles(
    made: Callable[[int, int], City],
) -> None:
    city = made(3000, 3)
    assert len(city) == pytest.approx(3000, rel=0.3)
    np.testing.assert_array_equal(city.points_m, made(3000, 3).points_m)
    for street in (city.nodes_m, city.nodes_m.swapaxes(0, 1)):
        middle = 0.5 * (street[:, 1:] + street[:, :-1]).reshape(-1, 2)
        free = KDTree(city.points_m).query(middle)[0] > 2.0
        assert free.mean() > 0.97  # of poles


def test_growth_keeps_its_figures_by_size_and_draws_them(tmp_path: Path) -> None:
    names = [*city_growth.COLUMNS, "asked"]
    rows = {size: dict.fromkeys(names, 1.5 * size) | {"asked": size} for size in (1000, 10)}
    figures = tmp_path / "figures.jsonl"
    assert city_growth.kept(figures) == {}
    city_growth.keep(rows, figures)
    assert city_growth.kept(figures) == rows
    assert list(city_growth.kept(figures)) == [10, 1000]
    for name in ("one.svg", "two.svg"):
        city_growth.draw(list(rows.values()), tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()


def test_growth_of_the_docs_is_that_of_the_figures() -> None:
    rows = city_growth.kept(city_growth.FIGURES)
    docs = Path(__file__).parents[3] / "docs"
    text = (docs / "city.md").read_text(encoding="utf-8")
    assert docs / "pictures" / "city_growth.svg" == city_growth.PICTURE
    for row in rows.values():
        assert f"| {row['poles']:,.0f} |" in text
