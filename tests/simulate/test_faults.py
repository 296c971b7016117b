"""Faults: each does what it says between its times, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from polemap.drivelog.drive import Drive, GnssStream, OdometryStream
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.samples import Image
from polemap.simulate import map_faults, picture_faults
from polemap.simulate.drive_fault import DriveFault
from polemap.simulate.faults import Fault, age_map, apply_faults
from polemap.simulate.frame_faults import (
    BlurredFrames,
    DirtyLens,
    DroppedFrames,
    FrozenFrames,
    Miscalibration,
    OverExposed,
    SwappedCameras,
)
from polemap.simulate.stream_faults import (
    ClockJump,
    GnssDropout,
    GnssOffset,
    NotANumber,
    OdometryDropout,
)
from polemap.stereo.rig import StereoRig
from tests.pole_maps import plain_map

RIG = StereoRig(80, 60, 90.0, 39.5, 29.5, 0.3)


class Numbered:
    """Frames whose grey level tells their number; left is even, right odd."""

    def __init__(self, rows: NDArray[np.int64]) -> None:
        self.rows = rows

    def load(self, row: int) -> tuple[Image, Image]:
        level = 2 * int(self.rows[row]) + 20
        texture = (np.arange(60)[:, None] * 7 + np.arange(80)[None] * 3) % 40
        left = (texture + level).astype(np.uint8)
        return left, (left + 1).astype(np.uint8)

    def keep(self, rows: NDArray[np.int64]) -> Numbered:
        return Numbered(self.rows[rows])


@pytest.fixture
def drive() -> Drive:
    stamps, ticks = np.arange(0, 10, 0.5), np.arange(0, 10, 0.02)
    fixes = np.arange(0, 10, 1.0)
    return Drive(
        name="d", path=Path("d"), frame=EarthFrame("local", name="d"), wheelbase_m=2.7, rig=RIG,
        frame_stamps_s=stamps, frame_arrivals_s=stamps + 0.1,
        frame_numbers=np.arange(len(stamps)), images=Numbered(np.arange(len(stamps))),
        odometry=OdometryStream(ticks, ticks, np.full(500, 5.0), np.zeros(500)),
        gnss=GnssStream(fixes, fixes, np.full(10, 3.0), np.full(10, 4.0), np.ones(10)),
    )  # fmt: skip


def one(drive: Drive, fault: DriveFault) -> Drive:
    return apply_faults(drive, [fault], 1)


def levels(drive: Drive) -> list[tuple[int, int]]:
    pairs = [drive.read_frame(row) for row in range(len(drive.frame_stamps_s))]
    return [(int(p.left[0, 0]), int(p.right[0, 0])) for p in pairs]


def test_dropped_frames_leave_the_others_alone(drive: Drive) -> None:
    broken = one(drive, DroppedFrames(from_s=2, until_s=4))
    assert set(drive.frame_stamps_s) - set(broken.frame_stamps_s) == {2.0, 2.5, 3.0, 3.5}
    kept = [n for n, s in enumerate(drive.frame_stamps_s) if not 2 <= s < 4]
    assert levels(broken) == [levels(drive)[n] for n in kept]
    half = one(drive, DroppedFrames(share=0.5))
    assert 3 <= len(half.frame_stamps_s) <= 17


def test_frozen_frames_repeat_the_last_good_one(drive: Drive) -> None:
    broken = one(drive, FrozenFrames(from_s=2, until_s=4))
    assert np.array_equal(broken.frame_stamps_s, drive.frame_stamps_s)
    expected = levels(drive)
    expected[4:8] = [expected[3]] * 4
    assert levels(broken) == expected


def test_swapped_cameras(drive: Drive) -> None:
    broken = one(drive, SwappedCameras(from_s=1, until_s=2))
    expected = [(b, a) if 2 <= n < 4 else (a, b) for n, (a, b) in enumerate(levels(drive))]
    assert levels(broken) == expected


def test_over_exposure_whitens_within_its_time(drive: Drive) -> None:
    broken = one(drive, OverExposed(factor=20, from_s=5))
    assert (broken.read_frame(9).left == drive.read_frame(9).left).all()
    assert (broken.read_frame(10).left == 255).all()
    assert (broken.read_frame(10).right == 255).all()


def test_blur_takes_contrast(drive: Drive) -> None:
    broken = one(drive, BlurredFrames(sigma_px=4))
    assert broken.read_frame(0).left.std() < 0.5 * drive.read_frame(0).left.std()


def test_dirt_stays_at_its_place_on_one_lens(drive: Drive) -> None:
    broken = one(drive, DirtyLens(camera="right", spots=4, radius_px=6))
    changed = []
    for row in (0, 7):
        good, bad = drive.read_frame(row), broken.read_frame(row)
        assert np.array_equal(good.left, bad.left)
        difference = np.abs(good.right.astype(int) - bad.right)
        changed.append(difference > 6)
    assert 0.01 < changed[0].mean() < 0.7
    assert (changed[0] & changed[1]).sum() > 0.5 * changed[0].sum()


@pytest.mark.parametrize(
    ("fault", "shift"),
    [
        (Miscalibration(pitch_deg=0.5), (0.0, 1)),
        (Miscalibration(yaw_deg=0.5), (1, 0.0)),
    ],
)
def test_miscalibration_moves_the_right_picture(
    drive: Drive, fault: Miscalibration, shift: tuple[float, float]
) -> None:
    moved = picture_faults.turning(RIG, fault.pitch_deg, fault.yaw_deg, 0.0)
    centre = moved @ [RIG.cx_px, RIG.cy_px, 1]
    centre = centre[:2] / centre[2] - [RIG.cx_px, RIG.cy_px]
    amount = RIG.focal_px * np.tan(np.deg2rad(0.5))
    assert np.abs(centre) == pytest.approx(np.abs(np.array(shift)) * amount, abs=1e-6)
    broken = one(drive, fault)
    assert np.array_equal(broken.read_frame(1).left, drive.read_frame(1).left)
    assert not np.array_equal(broken.read_frame(1).right, drive.read_frame(1).right)


def test_values_that_are_no_numbers(drive: Drive) -> None:
    broken = one(drive, NotANumber(share=0.3, from_s=5))
    assert broken.odometry is not None
    bad = np.isnan(broken.odometry.speed_mps)
    assert not bad[:250].any()
    assert bad[250:].mean() == pytest.approx(0.3, abs=4 * np.sqrt(0.21 / 250))
    fixes = one(drive, NotANumber(stream="gnss", share=1.0)).gnss
    assert fixes is not None
    assert np.isnan(fixes.east_m).all()


@pytest.mark.parametrize("stream", ["frames", "odometry", "gnss"])
def test_a_clock_jumps_and_comes_back(drive: Drive, stream: str) -> None:
    fault = ClockJump(stream=stream, by_s=1.0, from_s=4, until_s=6)  # type: ignore[arg-type]
    broken = one(drive, fault)

    def stamps(d: Drive) -> NDArray[np.float64]:
        return d.frame_stamps_s if stream == "frames" else getattr(d, stream).stamp_s

    jump = stamps(broken) - stamps(drive)
    inside = (stamps(drive) >= 4) & (stamps(drive) < 6)
    assert np.allclose(jump, inside * 1.0)


def test_dropouts_and_offsets(drive: Drive) -> None:
    quiet = one(drive, OdometryDropout(from_s=1, until_s=3)).odometry
    assert quiet is not None
    assert len(quiet) == 400
    gone = one(drive, GnssDropout(from_s=2)).gnss
    assert gone is not None
    assert len(gone) == 2
    moved = one(drive, GnssOffset(east_m=10, north_m=-2, from_s=5)).gnss
    assert moved is not None
    assert list(moved.east_m) == [3.0] * 5 + [13.0] * 5
    assert list(moved.north_m) == [4.0] * 5 + [2.0] * 5


def test_faults_add_up_in_order_and_repeat(drive: Drive) -> None:
    chain = [
        DroppedFrames(share=0.3),
        SwappedCameras(from_s=3),
        NotANumber(share=0.1),
    ]
    first, again, other = (apply_faults(drive, chain, seed) for seed in (1, 1, 2))
    assert levels(first) == levels(again)
    assert not np.array_equal(first.frame_stamps_s, other.frame_stamps_s)
    part = first.between(2, 5)
    assert levels(part) == [
        pair
        for pair, stamp in zip(levels(first), first.frame_stamps_s, strict=True)
        if 2 <= stamp < 5
    ]


def test_a_drive_without_the_sensor_stays_as_it_is(drive: Drive) -> None:
    bare = replace(drive, images=None, rig=None, odometry=None, gnss=None)
    every = [
        FrozenFrames(), BlurredFrames(), Miscalibration(yaw_deg=1),
        NotANumber(), NotANumber(stream="gnss"), ClockJump(),
        OdometryDropout(), GnssDropout(), GnssOffset(),
    ]  # fmt: skip
    assert apply_faults(bare, every, 0) == bare


def test_unknown_faults_are_refused() -> None:
    adapter: TypeAdapter[Fault] = TypeAdapter(Fault)
    assert adapter.validate_python({"kind": "gnss_offset"}) == GnssOffset()
    with pytest.raises(ValidationError, match="union_tag_invalid"):
        adapter.validate_python({"kind": "flat_tyre"})


def test_maps_that_are_out_of_date() -> None:
    count = 200
    rng = np.random.default_rng(0)
    pole_map = plain_map(rng.uniform(0, 500, (count, 2)), height_m=3.0)
    fewer = map_faults.without_poles(pole_map, 0.3, rng)
    assert len(fewer) == pytest.approx(140, abs=4 * np.sqrt(count * 0.21))
    assert set(fewer.ids) <= set(pole_map.ids)
    more = map_faults.with_extra_poles(pole_map, 0.25, rng)
    assert len(more) == 250
    assert len(set(more.ids)) == 250
    assert np.array_equal(more.points_m[:count], pole_map.points_m)
    nearest = np.hypot(*(more.points_m[count:, None] - pole_map.points_m[None]).transpose(2, 0, 1))
    assert nearest.min(axis=1).max() <= 12.0
    aged = [map_faults.PolesAdded(share=0.3), map_faults.PolesRemoved(share=0.25)]
    both, again, other = (age_map(pole_map, aged, seed) for seed in (1, 1, 2))
    assert np.array_equal(both.points_m, again.points_m)
    assert not np.array_equal(both.ids, other.ids)
    stands = len(set(map(tuple, both.points_m)) & set(map(tuple, pole_map.points_m)))
    assert stands == pytest.approx(140, abs=4 * np.sqrt(count * 0.21))
    assert len(both) == stands + round(0.25 * stands)
