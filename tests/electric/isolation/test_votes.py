"""Votes: the largest group without contradiction is right, and nobody is accused without one."""

from __future__ import annotations

import pytest

from polemap.electric.isolation.votes import Vote, accused


@pytest.mark.parametrize(
    ("values", "guilty", "disputed"),
    [
        ({"a": 1.0, "b": 1.1, "c": 1.2}, set(), set()),
        ({"a": 1.0, "b": 1.1, "c": 5.0}, {"c"}, {"a", "b", "c"}),
        ({"a": 1.0, "b": 1.1, "c": 5.0, "d": 1.2}, {"c"}, {"a", "b", "c", "d"}),
        ({"a": 1.0, "b": 5.0}, set(), {"a", "b"}),
        # a lies between: either neighbour may be the wrong one
        ({"a": 1.0, "b": 1.3, "c": 0.7}, set(), {"b", "c"}),
        ({"a": 1.0, "b": 1.1, "c": 5.0, "d": 5.1}, set(), {"a", "b", "c", "d"}),
        ({"a": 1.0}, set(), set()),
        ({}, set(), set()),
    ],
)
def test_the_one_against_a_majority_is_accused(
    values: dict[str, float], guilty: set[str], disputed: set[str]
) -> None:
    found, open_ones = accused({name: Vote(value, 0.2) for name, value in values.items()})
    assert found == guilty
    if not guilty:
        assert open_ones == disputed


def test_a_tolerant_voter_is_not_accused_by_one() -> None:
    """Who contradicts only the surest of the group may merely lie between."""
    votes = {"a": Vote(0.0, 0.01), "b": Vote(0.1, 0.5), "c": Vote(0.3, 0.2)}
    assert accused(votes)[0] == set()
