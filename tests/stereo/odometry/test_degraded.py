"""Real pictures made bad: what shows the motion is measured, of the rest nothing is claimed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.drivelog.readers.registry import open_drive
from polemap.stereo.odometry.camera_odometry import CameraMotion, CameraOdometry
from polemap.stereo.rig import StereoRig

Grey = NDArray[np.uint8]
Pairs = list[tuple[float, Grey, Grey]]
Worsen = Callable[[Grey], Grey]
RNG = np.random.default_rng(3)
# pairs that are made bad, of those that are read
BAD = range(8, 12)


@pytest.fixture(scope="module")
def street(recording: Callable[[str], Path]) -> tuple[StereoRig, Pairs]:
    drive = open_drive(recording("kitti_odometry") / "sequences" / "03")
    assert drive.rig is not None
    frames = [drive.read_frame(row) for row in range(18)]
    pairs = [
        (f.stamp_s, np.asarray(f.left, np.uint8), np.asarray(f.right, np.uint8)) for f in frames
    ]
    return drive.rig, pairs


def _follow(rig: StereoRig, pairs: Pairs) -> list[CameraMotion]:
    odometry = CameraOdometry(rig)
    return [odometry.advance(*pair) for pair in pairs]


def _steps(motions: list[CameraMotion]) -> NDArray[np.float64]:
    return np.array([m.current_from_previous[2, 3] for m in motions])


def _noisy(view: NDArray[np.generic], sd: float) -> Grey:
    noisy = view.astype(np.float64) + sd * RNG.standard_normal(view.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def _covered(view: Grey) -> Grey:
    covered = view.copy()
    covered[:, : int(0.95 * view.shape[1])] = 90
    return covered


def _worsened(pairs: Pairs, worsen: Worsen) -> Pairs:
    """The pairs `BAD` made worse."""
    return [
        (s, worsen(left), worsen(right)) if row in BAD else (s, left, right)
        for row, (s, left, right) in enumerate(pairs)
    ]


@pytest.mark.parametrize(
    ("worsen", "off_m"),
    [
        pytest.param(lambda v: cv2.GaussianBlur(v, (0, 0), 2.0), 0.03, id="out of focus"),
        pytest.param(lambda v: _noisy(0.1 * v, 1.0), 0.03, id="dusk"),
        pytest.param(lambda v: _noisy(0.4 * v, 1.0), 0.03, id="short exposure"),
        pytest.param(lambda v: cv2.convertScaleAbs(v, alpha=2.2), 0.03, id="burnt out"),
        pytest.param(lambda v: _noisy(v, 20.0), 0.03, id="noise"),
    ],
)
def test_motion_is_measured_through(
    street: tuple[StereoRig, Pairs], worsen: Worsen, off_m: float
) -> None:
    rig, pairs = street
    motions = _follow(rig, _worsened(pairs, worsen))
    assert all(m.known for m in motions[1:])
    assert _steps(motions) == pytest.approx(_steps(_follow(rig, pairs)), abs=off_m)


@pytest.mark.parametrize(
    "worsen",
    [
        pytest.param(np.zeros_like, id="black"),
        pytest.param(lambda v: _noisy(0.01 * v, 1.5), id="night"),
        pytest.param(lambda v: RNG.integers(0, 255, v.shape).astype(np.uint8), id="noise only"),
        pytest.param(_covered, id="covered"),
        pytest.param(lambda v: cv2.GaussianBlur(v, (0, 0), 40.0), id="fog"),
    ],
)
def test_nothing_is_claimed_and_it_comes_back(
    street: tuple[StereoRig, Pairs], worsen: Worsen
) -> None:
    rig, pairs = street
    motions = _follow(rig, _worsened(pairs, worsen))
    known = np.array([m.known for m in motions])
    # the first good pair has nothing before it
    assert not known[BAD.start : BAD.stop + 1].any()
    assert all(m.why for m in motions[BAD.start : BAD.stop + 1])
    after = slice(BAD.stop + 1, None)
    assert known[after].all()
    assert _steps(motions)[after] == pytest.approx(_steps(_follow(rig, pairs))[after], abs=0.03)


def test_exchanged_views_are_no_motion(street: tuple[StereoRig, Pairs]) -> None:
    rig, pairs = street
    assert not any(m.known for m in _follow(rig, [(s, r, left) for s, left, r in pairs[:6]]))


def test_pictures_that_repeat_stand_still(street: tuple[StereoRig, Pairs]) -> None:
    rig, pairs = street
    first = pairs[0]
    still = [(0.1 * k, _noisy(first[1], 2.0), _noisy(first[2], 2.0)) for k in range(8)]
    motions = _follow(rig, still)[1:]
    assert all(m.known for m in motions)
    assert np.abs(_steps(motions)).max() < 0.01
    turned = [np.linalg.norm(cv2.Rodrigues(m.current_from_previous[:3, :3])[0]) for m in motions]
    assert max(turned) < 0.001
