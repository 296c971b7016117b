"""Stereo pairs that cannot be pairs; made of blobs at many depths that a car drives towards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive, OdometryStream
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.plausibility.camera_check import SeenMotion, camera_findings
from polemap.drivelog.plausibility.check import check_drive
from polemap.drivelog.plausibility.pictures import check_pictures
from polemap.drivelog.source_names import FOLDER
from polemap.drivelog.streams import ReferenceStream
from polemap.stereo.rig import Mounting, StereoRig

RIG = StereoRig(480, 240, 400.0, 239.5, 119.5, 0.4, Mounting(1.5, 0.2, 1.4))
Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]
FRAMES, PERIOD_S = 40, 0.1
FLOW_M = 0.9


def _scene(seed: int = 3) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    n = 900
    # x to the right, y down, z ahead of the first camera, which is 1.4 m above the road
    return np.column_stack(
        [rng.uniform(-30, 30, n), rng.uniform(-8, 1.4, n), rng.uniform(5, 80, n)]
    )


def _turns() -> NDArray[np.float64]:
    t = PERIOD_S * np.arange(FRAMES)
    return 0.25 * np.sin(2 * np.pi * t / 2.2)


def _camera(frame: int) -> tuple[float, float, float]:
    """Right of and ahead of the first camera, and its yaw, after `frame` steps of the rear axle."""
    yaw = np.concatenate([[0.0], np.cumsum(_turns() * PERIOD_S)])[: frame + 1]
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    mount = RIG.vehicle_from_camera
    c, s = np.cos(yaw[-1]), np.sin(yaw[-1])
    ahead = FLOW_M * np.cos(middle).sum() + c * mount.x_m - s * mount.y_m - mount.x_m
    left = FLOW_M * np.sin(middle).sum() + s * mount.x_m + c * mount.y_m - mount.y_m
    return -left, ahead, float(yaw[-1])


def _view(frame: int, right: bool) -> NDArray[np.uint8]:
    """What a camera sees after `frame` steps."""
    points = _scene()
    to_the_right, forward, yaw = _camera(frame)
    ahead = points - [to_the_right, 0.0, forward]
    c, s = np.cos(yaw), np.sin(yaw)
    # the car turns to the left by yaw: the scene turns to the right
    x = c * ahead[:, 0] + s * ahead[:, 2] - (RIG.baseline_m if right else 0.0)
    z = -s * ahead[:, 0] + c * ahead[:, 2]
    image = np.full((RIG.height_px, RIG.width_px), 90, dtype=np.uint8)
    rng = np.random.default_rng(5)
    shades, sizes = rng.integers(10, 245, len(points)), rng.uniform(0.1, 0.35, len(points))
    for k in np.argsort(-z):
        if z[k] < 3.0:
            continue
        u = RIG.cx_px + RIG.focal_px * x[k] / z[k]
        v = RIG.cy_px + RIG.focal_px * ahead[k, 1] / z[k]
        half = RIG.focal_px * sizes[k] / z[k]
        corner = np.array([[u - half, v - half], [u + half, v + half]])
        low, high = np.rint(corner * 16).astype(int)
        cv2.rectangle(image, low.tolist(), high.tolist(), int(shades[k]), -1, cv2.LINE_AA, shift=4)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.8), dtype=np.uint8)


@dataclass(frozen=True)
class Pictures:
    pairs: tuple[Pair, ...]

    def load(self, row: int) -> Pair:
        return self.pairs[row]

    def keep(self, rows: NDArray[np.int64]) -> Pictures:
        return Pictures(tuple(self.pairs[int(row)] for row in rows))


class Broken:
    def load(self, row: int) -> Pair:
        raise InputError(f"frame {row}: 10x10 pixels, but the camera of the drive has 480x240")

    def keep(self, rows: NDArray[np.int64]) -> Broken:
        return self


@pytest.fixture(scope="module")
def clean() -> Drive:
    pairs = tuple((_view(k, False), _view(k, True)) for k in range(FRAMES))
    stamps = PERIOD_S * np.arange(FRAMES)
    t = np.arange(-1.5, stamps[-1] + 1.5, 0.02)
    rate = 0.25 * np.sin(2 * np.pi * (t - 0.5 * PERIOD_S) / 2.2)
    return Drive(
        names=FOLDER,
        name="pictures",
        path=Path("pictures"),
        frame=EarthFrame("local", name="test"),
        wheelbase_m=2.7,
        rig=RIG,
        frame_stamps_s=stamps,
        frame_arrivals_s=stamps,
        frame_numbers=np.arange(FRAMES),
        images=Pictures(pairs),
        odometry=OdometryStream(t, t, np.full(len(t), FLOW_M / PERIOD_S), rate),
    )


def _pairs(change: Callable[[Pair, Drive, int], Pair]) -> Callable[[Drive], Drive]:
    def made(drive: Drive) -> Drive:
        pairs = [change(drive.images.load(k), drive, k) for k in range(FRAMES)]
        return replace(drive, images=Pictures(tuple(pairs)))

    return made


def _rig(**changes: object) -> Callable[[Drive], Drive]:
    return lambda drive: replace(drive, rig=replace(RIG, **changes))


def _turned(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.ascontiguousarray(image[::-1, ::-1])


def _tilted(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = image.shape
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), 1.2, 1.0)
    return np.asarray(
        cv2.warpAffine(image, turn, (width, height), borderMode=cv2.BORDER_REFLECT), np.uint8
    )


MISTAKES: dict[str, tuple[Callable[[Drive], Drive], str, str]] = {
    "exchanged": (_pairs(lambda p, d, k: (p[1], p[0])), "picture_order", "error"),
    "right 3 rows lower": (_pairs(lambda p, d, k: (p[0], np.roll(p[1], 3, 0))), "picture_rows",
                           "error"),
    "right higher": (_pairs(lambda p, d, k: (p[0], np.roll(p[1], -2, 0))), "picture_rows",
                     "error"),
    "right of the frame before": (
        _pairs(lambda p, d, k: (p[0], d.images.load(max(k - 1, 0))[1])), "picture_instant",
        "error"),
    "not rectified": (_pairs(lambda p, d, k: (p[0], _tilted(p[1]))), "picture_rectified", "error"),
    "same twice": (_pairs(lambda p, d, k: (p[0], p[0])), "picture_same", "error"),
    "right covered": (_pairs(lambda p, d, k: (p[0], np.full_like(p[1], 6))), "picture_covered",
                      "error"),
    "right dark": (_pairs(lambda p, d, k: (p[0], (0.3 * p[1]).astype(np.uint8))),
                   "picture_exposure", "warning"),
    "stamps late": (lambda d: replace(d, frame_stamps_s=d.frame_stamps_s + 0.2), "clock_offset",
                    "warning"),
    "stamps early": (lambda d: replace(d, frame_stamps_s=d.frame_stamps_s - 0.3), "clock_offset",
                     "warning"),
    "focal length halved": (_rig(focal_px=200.0), "camera_scale", "error"),
    "focal length of a larger picture": (_rig(focal_px=480.0), "camera_scale", "warning"),
    "baseline doubled": (_rig(baseline_m=0.8), "camera_scale", "error"),
    "cy off": (_rig(cy_px=149.5), "camera_pitch", "warning"),
    "cx off": (_rig(cx_px=200.0), "camera_yaw", "warning"),
    "camera turned": (_rig(vehicle_from_camera=Mounting(1.5, 0.2, 1.4, yaw_rad=0.3)),
                      "camera_yaw", "error"),
    "camera nods": (_rig(vehicle_from_camera=Mounting(1.5, 0.2, 1.4, pitch_rad=-0.1)),
                    "camera_pitch", "warning"),
    "upside down": (_pairs(lambda p, d, k: (_turned(p[1]), _turned(p[0]))), "camera_upside_down",
                    "error"),
    "unreadable": (lambda d: replace(d, images=Broken()), "picture", "error"),
}  # fmt: skip


def test_true_pairs_are_left_alone(clean: Drive) -> None:
    assert [finding.line() for finding in check_pictures(clean)] == []


def test_the_way_of_the_pictures_is_measured_against_the_odometry_alone_where_it_is_believed(
    clean: Drive,
) -> None:
    t, n = clean.odometry.stamp_s, len(clean.odometry)
    fast = replace(clean, odometry=replace(clean.odometry, speed_mps=np.full(n, 32.4)))
    assert "camera_scale" in [f.kind for f in check_pictures(fast)]
    poses = np.column_stack([9.0 * t, np.zeros(n), np.zeros(n)])
    doubted = replace(fast, reference=ReferenceStream(t, poses, np.full(n, 0.02)))
    assert "camera_scale" not in [f.kind for f in check_pictures(doubted)]
    # a standing car shows nothing, nor does a drive without odometry
    still = replace(clean, odometry=replace(clean.odometry, speed_mps=np.zeros(n)))
    for drive in (still, replace(clean, odometry=None)):
        assert [f for f in check_pictures(drive) if f.stream == "camera"] == []


@pytest.mark.parametrize(
    ("told", "kinds"),
    [
        # small pictures of an empty street: pairs that contradict one another accuse nobody
        ([(0.78, -10.7, -62.8), (0.95, 0.2, -1.6), (1.02, 0.3, -1.1)], set()),
        ([(0.98, -1.1, -1.1), (0.87, -0.3, -1.8), (0.78, 0.3, 4.0), (0.86, 0.1, -4.0)], set()),
        ([(0.5, 12.0, 30.0)] * 2, set()),
        ([(0.84, 3.1, 0.2), (0.86, 2.9, -0.1), (0.85, 3.3, 0.1)], {"camera_scale", "camera_pitch"}),
    ],
)
def test_pairs_that_scatter_accuse_no_camera(
    clean: Drive, told: list[tuple[float, float, float]], kinds: set[str]
) -> None:
    nowhere = np.empty((0, 3))
    seen = [SeenMotion(s, np.radians(up), np.radians(left), nowhere) for s, up, left in told]
    assert {finding.kind for finding in camera_findings(clean, seen)} == kinds


def test_the_lag_of_the_pictures_is_told_to_a_few_hundredths(clean: Drive) -> None:
    """By the turn of the camera: what stands near swings with the way as well."""
    late = replace(clean, frame_stamps_s=clean.frame_stamps_s + 0.2)
    found = [f for f in check_pictures(late) if f.kind == "clock_offset"]
    assert "0.20 s" in found[0].value


def test_a_drive_without_pictures_has_none_to_blame(clean: Drive) -> None:
    assert check_pictures(replace(clean, images=None)) == []


@pytest.mark.parametrize("name", list(MISTAKES))
def test_a_mistake_in_the_pictures_is_noticed(clean: Drive, name: str) -> None:
    change, kind, severity = MISTAKES[name]
    findings = check_pictures(change(clean))
    match = [finding for finding in findings if finding.kind == kind]
    assert match, [finding.line() for finding in findings]
    assert match[0].severity == severity
    assert len(match[0].line()) < 300


@pytest.mark.parametrize(
    "numbers",
    [{"cx_px": 1e9}, {"cx_px": -1e6, "focal_px": 1.0}, {"focal_px": 1e-9}, {"baseline_m": 1e9}],
)
def test_numbers_that_no_camera_has_are_findings(clean: Drive, numbers: dict[str, float]) -> None:
    drive = _rig(**numbers)(clean)
    assert [f for f in [*check_drive(drive), *check_pictures(drive)] if f.severity == "error"]
