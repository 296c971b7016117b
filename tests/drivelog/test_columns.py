"""Column tables: whatever their fields, rows stay together and arrays cannot be written to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.drivelog.columns import Columns, column_names
from polemap.drivelog.detections import Detections, pole_detections
from polemap.drivelog.errors import InputError
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.streams import GnssStream, OdometryStream, ReferenceStream


@dataclass(frozen=True, slots=True)
class Table(Columns):
    HEADER: ClassVar[frozenset[str]] = frozenset({"name"})

    name: str
    number: NDArray[np.int64]
    place_m: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Wider(Table):
    width_m: NDArray[np.float64]


def wider(n: int, name: str = "one") -> Wider:
    rng = np.random.default_rng(n)
    return Wider(name, np.arange(n), rng.random((n, 2)), rng.random(n))


@pytest.mark.parametrize(
    "rows", [np.array([3, 1, 1]), np.arange(5) % 2 == 0, slice(1, 4), np.empty(0, np.int64)]
)
def test_rows_are_taken_from_every_column_and_the_header_stays(rows) -> None:
    table = wider(5)
    taken = table.take(rows)
    assert type(taken) is Wider
    assert taken.name == "one"
    assert column_names(Wider) == ("number", "place_m", "width_m")
    for name, values in taken.arrays().items():
        np.testing.assert_array_equal(values, getattr(table, name)[rows])
    assert len(taken) == len(taken.number)


def test_parts_are_joined_under_the_first_header_and_come_back_from_arrays() -> None:
    parts = [wider(3), wider(0, "two"), wider(4, "three")]
    joined = Wider.concatenate(parts)
    assert (len(joined), joined.name) == (7, "one")
    np.testing.assert_array_equal(joined.take(slice(3, 7)).place_m, parts[2].place_m)
    again = Wider.from_arrays({**joined.arrays(), "more": np.zeros(2)}, name="four")
    assert again.name == "four"
    np.testing.assert_array_equal(again.width_m, joined.width_m)
    narrow = Table.concatenate(parts)
    assert column_names(type(narrow)) == ("number", "place_m")
    with pytest.raises(KeyError, match="width_m"):
        Wider.from_arrays({"number": joined.number, "place_m": joined.place_m}, name="five")


def test_arrays_are_read_only_and_the_givers_own_stay_as_they_were() -> None:
    place = np.zeros((2, 2))
    table = Table("one", np.arange(2), place)
    with pytest.raises(ValueError, match="read-only"):
        table.place_m[0] = 1.0
    place[0] = 1.0


@pytest.mark.parametrize("table", [Table, Wider])
def test_columns_of_unequal_length_are_refused_by_name(table) -> None:
    columns = {name: np.zeros((2, 2)) for name in column_names(table)}
    with pytest.raises(InputError, match=rf"{table.__name__}: column place_m has 3 rows, number 2"):
        table("one", **{**columns, "place_m": np.zeros((3, 2))})


@pytest.mark.parametrize("table", [OdometryStream, GnssStream, ReferenceStream, Detections])
def test_every_stream_of_a_drive_is_such_a_table(table) -> None:
    assert issubclass(table, Columns)


def test_a_filter_takes_the_kind_that_it_knows() -> None:
    poles = pole_detections(0.0, 0.1, np.ones((3, 2)), np.tile(np.eye(2), (3, 1, 1)))
    assert poles.of_kinds(LandmarkKind.POLE) is poles
    mixed = poles.with_columns(
        kind=np.array([0, 1, 0], dtype=np.int8), width_m=np.array([0.1, 0.2, 0.3])
    )
    chosen = mixed.of_kinds(LandmarkKind.POLE)
    assert chosen.width_m.tolist() == [0.1, 0.3]
    assert mixed.of_kinds(0, 1) is mixed
    assert chosen.arrival_s == 0.1


def test_what_a_detector_does_not_say_is_unknown() -> None:
    poles = pole_detections(0.0, 0.0, np.ones((2, 2)), np.tile(np.eye(2), (2, 1, 1)))
    assert np.isnan(poles.width_m).all()
    assert np.isnan(poles.height_m).all()
    assert poles.probability.tolist() == [1.0, 1.0]
    assert poles.track_id.tolist() == [-1, -1]
    with pytest.raises(InputError, match="width_m has 1 rows"):
        pole_detections(
            0.0, 0.0, np.ones((2, 2)), np.tile(np.eye(2), (2, 1, 1)), width_m=np.ones(1)
        )
