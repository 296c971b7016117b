"""Stakes round a sapling, seen from a car that passes: one landmark of scans and of maps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.build.assemble import assemble_map
from polemap.build.config import MappingConfig
from polemap.build.drive_observations import observe_drive
from polemap.config import PolemapConfig
from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import OdometrySample
from polemap.drivelog.streams import ReferenceStream
from polemap.map.pole_map import PoleMap
from polemap.perception import PolePerception
from polemap.track.config import TrackingConfig
from tests.pole_maps import plain_scan

Floats = NDArray[np.float64]
FRAME = EarthFrame("utm", 32632)
MIDDLE = np.array([14.0, 4.0])
STAKES = MIDDLE + 0.42 * np.array([[1.0, 0.0], [-0.5, 0.866], [-0.5, -0.866]])
LAMP_AND_SIGN = np.array([[20.0, -4.0], [20.5, -5.4]])
ROW = np.array([[26.0, 4.0], [27.0, 4.05], [28.0, 4.0], [29.0, 4.0]])  # bollards along the kerb
PLACES = np.concatenate([STAKES, LAMP_AND_SIGN, ROW])
WIDTH = np.array([0.08] * 3 + [0.15, 0.07] + [0.12] * 4)
HEIGHT = np.array([1.9, 2.0, 1.8, 3.2, 2.3] + [1.0] * 4)
SPEED_MPS, FRAMES = 4.0, 60


def _scans(seed: int, *, seen: float = 0.8) -> list[Detections]:
    """Raw detections a tenth of a second apart; each pole is missed now and then."""
    rng = np.random.default_rng(seed)
    scans = []
    for number in range(FRAMES):
        at = PLACES - [SPEED_MPS * 0.1 * number, 0.0]
        shown = (at[:, 0] > 2.0) & (at[:, 0] < 16.0) & (rng.uniform(size=len(at)) < seen)
        places = at[shown] + rng.normal(0.0, 0.03, (np.count_nonzero(shown), 2))
        scan = plain_scan(0.1 * number, places, variance_m2=0.03**2).with_columns(
            width_m=WIDTH[shown], height_m=HEIGHT[shown], probability=np.full(len(places), 0.9)
        )
        view = VisibleRegion(np.zeros(2), -1.2, 1.2, 1.0, np.array([30.0]))
        scans.append(replace(scan, view=view))
    return scans


def _tracked(scans: list[Detections], *, grouped: bool) -> list[Detections]:
    config = PolemapConfig(tracking=TrackingConfig(group_stakes=grouped))
    perception = PolePerception(None, config)
    out = []
    for number, scan in enumerate(scans):
        perception.record_odometry(OdometrySample(0.1 * number, 0.1 * number, SPEED_MPS, 0.0))
        out.append(perception.track_scan(scan))
    return out


def _map(scans: list[Detections], *, grouped: bool) -> PoleMap:
    stamps = 0.1 * np.arange(FRAMES)
    poses = np.column_stack([SPEED_MPS * stamps, 0 * stamps, 0 * stamps])
    reference = ReferenceStream(stamp_s=stamps, poses=poses, sd_m=np.full(FRAMES, 0.02))
    config = MappingConfig(group_stakes=grouped)
    part = observe_drive("one", FRAME, scans, reference, config, FRAME)
    return assemble_map([part], config, FRAME).pole_map


def test_a_scan_holds_the_stakes_as_one_and_leaves_all_others() -> None:
    scans = _scans(3)
    plain, grouped = _tracked(scans, grouped=False), _tracked(scans, grouped=True)
    whole = [scan.take(scan.parts > 1) for scan in grouped]
    assert sum(map(len, whole)) > 20
    error = []
    for number, (one, two, group) in enumerate(zip(plain, grouped, whole, strict=True)):
        moved = np.array([SPEED_MPS * 0.1 * number, 0.0])
        assert len(group) <= 1
        away = np.hypot(*(one.points_vehicle_m + moved - MIDDLE).T) > 1.0
        others = two.take(two.parts == 1)
        far = np.hypot(*(others.points_vehicle_m + moved - MIDDLE).T) > 1.0
        np.testing.assert_array_equal(
            one.take(away).points_vehicle_m, others.take(far).points_vehicle_m
        )
        if len(group):
            assert group.parts[0] == 3
            assert len(others) == np.count_nonzero(far)
            assert 0.6 < group.width_m[0] < 1.0
            off = group.points_vehicle_m[0] + moved - MIDDLE
            error.append(off @ np.linalg.solve(group.covariance_m2[0], off) / 2.0)
    # it does not jump when a stake is missed; the middle's own deviation is not drawn here
    assert np.mean(error) < 1.0


@pytest.mark.parametrize("scans_grouped", [False, True], ids=["single", "grouped"])
def test_a_map_holds_the_stakes_as_one(scans_grouped: bool) -> None:
    scans = _tracked(_scans(4), grouped=scans_grouped)
    pole_map = _map(scans, grouped=True)
    parts = pole_map.extra["parts"]
    assert sorted(parts.tolist()) == [1] * 6 + [3]
    group = int(np.argmax(parts))
    assert np.hypot(*(pole_map.points_m[group] - MIDDLE)) < 0.1
    assert 0.6 < pole_map.width_m[group] < 1.0
    gap = np.hypot(*np.moveaxis(pole_map.points_m[:, None] - PLACES[3:], 2, 0))
    assert (gap.min(axis=0) < 0.15).all()


def test_without_the_setting_every_stake_is_a_pole_and_the_map_has_no_such_column() -> None:
    pole_map = _map(_tracked(_scans(4), grouped=False), grouped=False)
    assert len(pole_map) == len(PLACES)
    assert "parts" not in pole_map.extra
