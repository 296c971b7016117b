"""A small drive to read and to damage."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.drivelog.drives import write_small


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_small(tmp_path / "drive")
