"""A frame is matched while the one before is looked at; nothing else changes."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from polemap.config import PolemapConfig
from polemap.drivelog.errors import InputError
from polemap.drivelog.samples import OdometrySample, StereoFrame
from polemap.matching_ahead import MatchedFrame, match_ahead
from polemap.perception import PolePerception
from polemap.stereo.config import StereoConfig
from tests.polemap.street import RIG, Thing, street


def frames(count):
    image = np.zeros((4, 4), dtype=np.uint8)
    for k in range(count):
        yield OdometrySample(k - 0.5, k - 0.5, 1.0, 0.0)
        yield StereoFrame(float(k), float(k), k, image, image)


def matched(frame):
    return MatchedFrame(*(getattr(frame, n) for n in ("stamp_s", "arrival_s", "index")),
                        frame.left, frame.right, f"maps {frame.index}")  # fmt: skip


def test_the_samples_come_in_their_order_with_their_maps():
    got = list(match_ahead(frames(5), matched))
    assert [s.stamp_s for s in got] == [s.stamp_s for s in frames(5)]
    assert [s.disparity for s in got[1::2]] == [f"maps {k}" for k in range(5)]


def test_one_frame_ahead_and_no_more():
    done = []

    def match(frame):
        done.append(frame.index)
        return matched(frame)

    for sample in match_ahead(frames(6), match):
        if isinstance(sample, MatchedFrame):
            time.sleep(0.05)
            assert done[-1] == min(sample.index + 1, 5)


def test_not_the_whole_of_a_long_drive_is_read_ahead():
    read = []

    def reading():
        for k in range(5000):
            read.append(k)
            yield OdometrySample(float(k), float(k), 1.0, 0.0)

    got = match_ahead(reading(), matched)
    next(got)
    time.sleep(0.3)
    assert len(read) < 300
    assert sum(1 for _ in got) == 4999


@pytest.mark.parametrize("where", ["reading", "matching"])
def test_an_error_comes_at_its_samples_turn(where):
    def reading():
        for sample in frames(4):
            if where == "reading" and sample.stamp_s == 2.0:
                raise InputError("frame 2 is damaged")
            yield sample

    def match(frame):
        if where == "matching" and frame.index == 2:
            raise InputError("frame 2 is damaged")
        return matched(frame)

    seen = []
    with pytest.raises(InputError, match="frame 2"):
        seen.extend(s.stamp_s for s in match_ahead(reading(), match))
    before = threading.active_count()
    got = match_ahead(reading(), match)
    for _ in range(3):
        next(got)
    got.close()
    assert threading.active_count() == before


def test_the_scans_are_those_of_one_frame_after_the_other():
    rng = np.random.default_rng(3)
    views = [street([Thing(14.0 - x, 2.5, 0.2, 4.0)], rng, 1.0)[:2] for x in range(4)]
    pairs = [StereoFrame(0.1 * k, 0.1 * k, k, *pair) for k, pair in enumerate(views)]
    config = StereoConfig(disparities=96)
    plain, ahead = (PolePerception(RIG, PolemapConfig(), stereo=config) for _ in range(2))
    expected = [plain.perceive(pair) for pair in pairs]
    got = [ahead.perceive(sample) for sample in match_ahead(pairs, ahead.matched)]
    for one, other in zip(expected, got, strict=True):
        np.testing.assert_array_equal(one.disparity.left, other.disparity.left)
        np.testing.assert_array_equal(one.scan.points_vehicle_m, other.scan.points_vehicle_m)
        np.testing.assert_array_equal(one.view.detections.covariance_m2,
                                      other.view.detections.covariance_m2)  # fmt: skip
