"""Votes of sensors that tell the same quantity: who stands alone is at fault.

Each voter gives a number and the largest error it has in order; two contradict each other where
they differ by more than both errors together. The largest group without contradiction is right if
no other group is as large; a voter that contradicts it is accused.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple


class Vote(NamedTuple):
    """What a sensor says and how far that may be off."""

    value: float
    tolerance: float


def contradict(one: Vote, other: Vote) -> bool:
    """Whether two votes cannot both be right."""
    return abs(one.value - other.value) > one.tolerance + other.tolerance


def accused(votes: dict[str, Vote]) -> tuple[set[str], set[str]]:
    """Who is accused, and who contradict each other without a majority.

    A minority of one against one, or of two against two, accuses nobody.
    """
    names = list(votes)
    values = list(votes.values())
    if not any(contradict(one, other) for one, other in combinations(values, 2)):
        return set(), set()
    against = {
        name: {other for other in names if contradict(votes[name], votes[other])}
        for name in names
    }  # fmt: skip
    disputed = {name for name in names if against[name]}
    for size in range(len(names) - 1, 1, -1):
        groups = [
            set(group)
            for group in combinations(names, size)
            if not any(against[name] & set(group) for name in group)
        ]
        if not groups:
            continue
        if len(groups) > 1:
            return set(), disputed
        # who contradicts only some of the group may merely be the least sure
        out = {name for name in disputed - groups[0] if len(against[name] & groups[0]) >= 2}
        return out, disputed if not out else set()
    return set(), disputed
