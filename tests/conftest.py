"""What all tests share: where the real recordings lie, and how a test skips without them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

# how long an example takes depends on the machine and its load; that is for benchmarks
settings.register_profile("polemap", deadline=None)
settings.load_profile("polemap")

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def recording() -> Callable[[str], Path]:
    """`recording("kitti_2015")` is the folder of that recording, or the test skips and says so."""

    def find(name: str) -> Path:
        path = SHARED_DATA / name
        if not path.exists():
            pytest.skip(f"the recording ../shared/data/{name} is not on this machine")
        return path

    return find
