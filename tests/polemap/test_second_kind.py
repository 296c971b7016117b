"""A made-up second class of landmarks, from the detections through the map to the filter."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.build.assemble import assemble_map
from polemap.build.config import MappingConfig
from polemap.build.drive_observations import DriveObservations, observe_drive
from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import OdometrySample
from polemap.drivelog.streams import ReferenceStream
from polemap.localize.config import LocalizeConfig
from polemap.localize.particle_filter.filter import ParticleFilter
from polemap.localize.particle_filter.pole_weigher import PoleWeigher
from polemap.map.io import read_map, write_map
from polemap.map.pole_map import KIND_COLUMN, PoleMap, join_maps
from polemap.vehicle.pose import inverse_transform_points
from tests.pole_maps import plain_map, plain_scan

Floats = NDArray[np.float64]

POLE, SIGN = 0, 1
CONFIG = MappingConfig()
FRAME = EarthFrame("utm", 32632)
ORIGIN = np.array([458000.0, 5_430_000.0])
VIEW = VisibleRegion(np.zeros(2), -1.2, 1.2, 1.0, np.array([45.0]))
# a sign hangs at every other pole, so near that two poles there would be taken for one
POLES = ORIGIN + np.array([[10.0, 5.0], [20.0, -5.0], [30.0, 5.0], [40.0, -5.0]])
SIGNS = POLES[::2] + np.array([0.3, 0.1])
PLACES = np.concatenate([POLES, SIGNS])
KINDS = np.array([POLE] * 4 + [SIGN] * 2, dtype=np.int8)


def scan_from(pose: Floats, stamp_s: float, shown: NDArray[np.bool_]) -> Detections:
    """What of the shown landmarks is in view."""
    seen = inverse_transform_points(pose, PLACES)
    chosen = shown & VIEW.contains(seen)
    scan = plain_scan(stamp_s, seen[chosen], variance_m2=0.03**2).with_columns(kind=KINDS[chosen])
    return replace(scan, view=VIEW)


def drive(name: str, start_s: float) -> DriveObservations:
    """Past all of them; kinds are seen in turn, so that seeing both at once forbids nothing."""
    stamps = start_s + 0.1 * np.arange(160)
    poses = np.column_stack([ORIGIN[0] + 0.3 * np.arange(160), np.full(160, ORIGIN[1]), 0 * stamps])
    scans = [
        scan_from(pose, stamp, number % 2 == KINDS)
        for number, (pose, stamp) in enumerate(zip(poses, stamps.tolist(), strict=True))
    ]
    reference = ReferenceStream(stamp_s=stamps, poses=poses, sd_m=np.full(160, 0.02))
    return observe_drive(name, FRAME, scans, reference, CONFIG, FRAME)


@pytest.fixture(scope="module")
def built() -> PoleMap:
    return assemble_map([drive("monday", 0.0), drive("friday", 1e5)], CONFIG, FRAME).pole_map


def places(pole_map: PoleMap, kind: int) -> Floats:
    found = pole_map.points_m[pole_map.kind == kind]
    return found[np.argsort(found[:, 0])]


def test_the_map_has_a_landmark_of_each_kind_where_both_stand(built: PoleMap) -> None:
    np.testing.assert_allclose(places(built, POLE), POLES, atol=0.05)
    np.testing.assert_allclose(places(built, SIGN), SIGNS, atol=0.05)


@pytest.mark.parametrize("name", ["map.geojson", "map.gpkg", "map.parquet"])
def test_files_keep_the_kinds_and_an_update_goes_on_with_them(
    built: PoleMap, tmp_path: Path, name: str
) -> None:
    write_map(built, tmp_path / name)
    again = read_map(tmp_path / name)
    np.testing.assert_array_equal(again.kind, built.kind)
    assert again.kind.dtype == np.int8
    updated = assemble_map([drive("sunday", 2e5)], CONFIG, FRAME, update=again).pole_map
    np.testing.assert_allclose(places(updated, SIGN), SIGNS, atol=0.05)
    assert len(updated) == len(PLACES)


def test_a_map_of_poles_alone_does_not_speak_of_kinds(built: PoleMap) -> None:
    poles = plain_map(POLES)
    assert KIND_COLUMN not in poles.extra
    assert poles.kind.tolist() == [POLE] * 4
    both = join_maps(poles, replace(poles, extra={KIND_COLUMN: np.full(4, SIGN)}))
    assert both.kind.tolist() == [POLE] * 4 + [SIGN] * 4


@pytest.mark.parametrize("value", [-1, 128, 0.5, np.nan])
def test_a_kind_that_is_none_is_refused(value: float) -> None:
    column = np.array([0, 1, value, 0])
    with pytest.raises(InputError, match=r"pole 2 has the landmark_kind .* not a whole number"):
        replace(plain_map(POLES), extra={KIND_COLUMN: column})


def test_the_filter_matches_within_a_kind(built: PoleMap) -> None:
    weigher = PoleWeigher(built, LocalizeConfig())
    pose = np.array([[*ORIGIN, 0.0]])
    scan = scan_from(pose[0], 0.0, np.ones(6, dtype=bool))
    right = weigher.weigh(pose, scan)
    assert right.matched.tolist() == [6]
    apart = [weigher.weigh(pose, scan_from(pose[0], 0.0, k == KINDS)) for k in (POLE, SIGN)]
    # each kind pays for the other's misses once more where it is weighed alone
    assert right.log_likelihood[0] > apart[0].log_likelihood[0] + apart[1].log_likelihood[0]
    swapped = scan.with_columns(kind=(1 - scan.kind).astype(np.int8))
    wrong = weigher.weigh(pose, swapped)
    # a pole stands within reach of a sign at two places, but four poles seen as signs fit nothing
    assert wrong.matched[0] < 4
    assert wrong.log_likelihood[0] < right.log_likelihood[0] - 5.0


def test_the_filter_leaves_out_what_its_map_holds_none_of(built: PoleMap) -> None:
    poses = {}
    for name, shown in (("poles alone", KINDS == POLE), ("with signs", np.ones(6, dtype=bool))):
        rng = np.random.default_rng(0)
        pf = ParticleFilter(plain_map(POLES), LocalizeConfig(particles=100), 2.7, rng)
        pf.set_pose(0.0, np.array([*ORIGIN, 0.0]), np.diag([0.1, 0.1, 0.001]))
        pf.add_odometry(OdometrySample(0.0, 0.0, 0.0, 0.0))
        pf.add_odometry(OdometrySample(0.1, 0.1, 0.0, 0.0))
        found = pf.process_scan(scan_from(np.array([*ORIGIN, 0.0]), 0.1, shown))
        assert found is not None
        poses[name] = (found.pose.tolist(), found.health.seen)
    assert poses["with signs"] == poses["poles alone"]
