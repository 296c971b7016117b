"""The stated height of the camera against the road."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.calibration.height_check import height_findings
from polemap.drivelog.drive import Drive
from polemap.drivelog.readers.registry import open_drive
from polemap.tools.plausible import find
from tests.calibration.street import TRUE, write_street


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return open_drive(write_street(tmp_path_factory.mktemp("s") / "d", stated=TRUE, frames=12))


def _at(drive: Drive, height_m: float) -> Drive:
    mount = replace(drive.rig.vehicle_from_camera, z_m=height_m)
    return replace(drive, rig=replace(drive.rig, vehicle_from_camera=mount))


@pytest.mark.parametrize(
    ("factor", "severity"), [(0.5, "error"), (0.75, "warning"), (1.0, None), (2.0, "error")]
)
def test_a_height_that_the_road_contradicts(
    street: Drive, factor: float, severity: str | None
) -> None:
    found = height_findings(_at(street, factor * TRUE.z_m))
    assert [f.severity for f in found] == ([severity] if severity else [])
    if severity:
        assert f"the road lies {TRUE.z_m:.2f}"[:-1] in found[0].value
        assert f"{factor * TRUE.z_m:g} m" in found[0].expected
        assert [f.kind for f in find(_at(street, factor * TRUE.z_m))] == ["camera_height"]


def test_no_road_and_no_pictures_say_nothing(street: Drive) -> None:
    assert height_findings(replace(street, images=None)) == []
    assert height_findings(replace(street, rig=None)) == []

    class Grey:
        def load(self, row: int) -> tuple[np.ndarray, np.ndarray]:
            grey = np.full((street.rig.height_px, street.rig.width_px), 90, dtype=np.uint8)
            return grey, grey

        def keep(self, rows: np.ndarray) -> Grey:
            return self

    assert height_findings(replace(street, images=Grey())) == []
