"""A start is believed when a constellation says so, or when poles go on to stand where expected."""

from __future__ import annotations

import pytest

from polemap.localize.config import RecoveryConfig
from polemap.localize.particle_filter.health import StartProof
from polemap.localize.particle_filter.place_search import Verdict


def feed(
    proof: StartProof,
    scans: int,
    verdict: Verdict = "open",
    *,
    narrow: bool = True,
    matched: int = 1,
    possible: float = 1.0,
    moved_m: float = 1.0,
) -> None:
    for _ in range(scans):
        proof.add_verdict(
            verdict, narrow=narrow, matched=matched, possible=possible, moved_m=moved_m
        )


def test_a_constellation_proves_a_narrow_particle_set_only() -> None:
    proof = StartProof(RecoveryConfig())
    feed(proof, 5, "confirmed", narrow=False)
    assert not proof.proven
    feed(proof, 1, "confirmed")
    assert proof.proven
    feed(proof, 1, "open", narrow=False)
    assert proof.proven
    proof.begin()
    assert not proof.proven


def test_one_pole_beside_a_standing_car_proves_nothing() -> None:
    proof = StartProof(RecoveryConfig())
    feed(proof, 1000, moved_m=0.0)
    assert not proof.proven


def test_poles_found_where_expected_prove_in_time() -> None:
    proof = StartProof(RecoveryConfig())
    feed(proof, 24)
    # a street without poles in reach neither proves nor disproves
    feed(proof, 100, matched=0, possible=0.0)
    assert not proof.proven
    feed(proof, 1)
    assert proof.proven


@pytest.mark.parametrize("doubt", ["missing", "wide"])
def test_what_was_gained_is_lost_again(doubt: str) -> None:
    proof = StartProof(RecoveryConfig())
    feed(proof, 24)
    if doubt == "missing":
        feed(proof, 10, matched=0)
        feed(proof, 10)
    else:
        feed(proof, 1, narrow=False)
        feed(proof, 24)
    assert not proof.proven
    feed(proof, 1)
    assert proof.proven


def test_a_contradiction_holds_until_the_next_scan_and_belief_ends_it() -> None:
    proof = StartProof(RecoveryConfig())
    feed(proof, 1, "contradicted", narrow=False)
    assert proof.contradicted
    feed(proof, 1)
    assert not proof.contradicted
    feed(proof, 1, "contradicted")
    proof.believe()
    assert proof.proven
    assert not proof.contradicted


def test_a_proven_place_where_hardly_a_pole_fits_is_in_doubt() -> None:
    proof = StartProof(RecoveryConfig())
    proof.believe()
    for _ in range(200):
        proof.add_fit(matched=1, seen=2, elapsed_s=0.05)
        assert not proof.in_doubt
    for _ in range(200):
        # nothing seen says nothing
        proof.add_fit(matched=0, seen=0, elapsed_s=0.05)
        assert not proof.in_doubt
    for _ in range(200):
        proof.add_fit(matched=0, seen=3, elapsed_s=0.05)
    assert proof.in_doubt
    proof.begin()
    assert not proof.in_doubt
