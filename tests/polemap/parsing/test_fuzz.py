"""Damaged files of every kind: a reader returns or raises an error for the user, nothing else."""

from __future__ import annotations

import random
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.campaign.corpus import Kind, make_corpus
from benchmarks.campaign.readers import _alarm, attempt, mutated


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Kind]]:
    pytest.importorskip("osmium")
    before = signal.signal(signal.SIGALRM, _alarm)
    yield make_corpus(tmp_path_factory.mktemp("corpus"))
    signal.signal(signal.SIGALRM, before)


@pytest.mark.filterwarnings("ignore")
@settings(
    max_examples=150, deadline=None, derandomize=True, database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
@given(which=st.integers(0, 10_000), seed=st.integers(0, 2**32))
def test_a_few_changes_break_no_reader(corpus: list[Kind], which: int, seed: int) -> None:
    kind = corpus[which % len(corpus)]
    data = mutated(kind.seed, random.Random(seed))
    try:
        assert attempt(kind, data) is None, (kind.name, data[:500])
    finally:
        kind.file.write_bytes(kind.seed)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "data", [b"", b"\0" * 100, b"\xff" * 100, b"[" * 3000, b"9" * 5000], ids=lambda d: str(d[:4])
)
def test_what_is_no_document_at_all_is_named(corpus: list[Kind], data: bytes) -> None:
    for kind in corpus:
        assert attempt(kind, data) is None, kind.name
        kind.file.write_bytes(kind.seed)


def test_what_breaks_a_reader_is_found(tmp_path: Path) -> None:
    def broken() -> None:
        raise ZeroDivisionError("a bug")

    kind = Kind("broken", tmp_path / "x", b"x", broken)
    assert "ZeroDivisionError at test_fuzz.py" in str(attempt(kind, b"y"))
