"""Recordings as files, and opened as drives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from polemap.drivelog.drive import Drive
from polemap.drivelog.readers.registry import open_drive
from tests.drivelog.bags.recordings import Ros, Said, write_mcap
from tests.drivelog.bags.streams import (
    ROS,
)


@pytest.fixture
def log(tmp_path: Path) -> Callable[..., Path]:
    def write(*parts: list[Said], ros: Ros = ROS) -> Path:
        said = sorted((one for part in parts for one in part), key=lambda one: one.log_ns)
        return write_mcap(tmp_path / "log.mcap", said, ros)

    return write


@pytest.fixture
def opened(log: Callable[..., Path], tmp_path: Path) -> Callable[..., Drive]:
    def read(*parts: list[Said], ros: Ros = ROS, **mapping: Any) -> Drive:
        path = log(*parts, ros=ros)
        if not mapping:
            return open_drive(path)
        told = tmp_path / "topics.yaml"
        told.write_text(yaml.safe_dump({"format_version": 1, **mapping}))
        return open_drive(path, topics=told)

    return read
