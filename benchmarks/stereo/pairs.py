"""What is measured beside each other: pairs of pictures with true disparities, and matchers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import StereoMatcher, make_matcher
from polemap.stereo.opencv_sgbm import OPENCV_OPTIONS, OpenCvOptions


@dataclass(frozen=True, slots=True)
class Pair:
    """A pair with the true disparity of its left view, NaN where it is unknown."""

    name: str
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    truth: NDArray[np.float32]
    kitti: bool

    def non_occluded(self) -> NDArray[np.bool_]:
        """Where truth is known and the right camera sees the point (KITTI's truth is so already).

        A pixel is hidden if one with a disparity over 1 px larger has the same partner.
        """
        known = np.isfinite(self.truth)
        if self.kitti:
            return known
        height, width = self.truth.shape
        row, column = np.nonzero(known)
        disparity = self.truth[row, column]
        partner = np.rint(column - disparity).astype(np.int64)
        nearest = np.full((height, width), -np.inf)
        inside = partner >= 0
        np.maximum.at(nearest, (row[inside], partner[inside]), disparity[inside])
        seen = inside & (disparity >= nearest[row, np.maximum(partner, 0)] - 1)
        mask = np.zeros((height, width), dtype=bool)
        mask[row[seen], column[seen]] = True
        return mask

    def wrong(self, disparity: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Over 3 px and 5 % (KITTI) or over 1 px (Middlebury)."""
        with np.errstate(invalid="ignore"):
            error = np.abs(disparity - self.truth)
            if self.kitti:
                return np.asarray((error > 3) & (error > 0.05 * self.truth))
            return np.asarray(error > 1)


def read_grey(path: Path) -> NDArray[np.uint8]:
    """A picture, as grey levels `(h, w)`."""
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SystemExit(f"{path}: no image; pass a KITTI or Middlebury folder")
    return np.asarray(image, dtype=np.uint8)


def read_truth(path: Path, scale: float) -> NDArray[np.float32]:
    """True disparities `(h, w)` from a picture that holds them times `scale`; NaN where unknown."""
    raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if raw is None:
        raise SystemExit(f"{path}: no ground truth")
    return np.where(raw > 0, raw / scale, np.nan).astype(np.float32)


def _rectified_projection(calibration: Path, camera: str) -> NDArray[np.float64]:
    """3x4 matrix of a rectified camera of a KITTI raw `calib_cam_to_cam.txt`."""
    for line in calibration.read_text(encoding="utf-8").splitlines():
        if line.startswith(f"P_rect_{camera}:"):
            return np.array(line.split()[1:], dtype=float).reshape(3, 4)
    raise SystemExit(f"{calibration}: no line P_rect_{camera}")


def read_raw_pairs(folder: Path) -> Iterator[Pair]:
    """Both views of the frames of a KITTI raw folder that have LiDAR depth for either camera.

    `depth/DRIVE/image_02/FRAME.png` is depth x 256 in metres (KITTI's depth benchmark: eleven scans
    together, freed of what contradicts a stereo match, so hard pixels are rare in it). The pair
    of the right view is the mirrored one, whose left view it is.
    """
    for path in sorted((folder / "depth").glob("*/image_02/*.png")):
        drive = path.parts[-3]
        calibration = folder / drive[:10] / "calib_cam_to_cam.txt"
        near, far = (_rectified_projection(calibration, camera) for camera in ("02", "03"))
        depth_to_disparity = near[0, 3] - far[0, 3]  # focal length x baseline
        images, truths = [], []
        for camera in ("image_02", "image_03"):
            images.append(read_grey(folder / drive[:10] / drive / camera / "data" / path.name))
            depth = read_truth(path.parents[1] / camera / path.name, 256.0)
            truths.append((depth_to_disparity / depth).astype(np.float32))
        yield Pair(f"{path.stem} left", images[0], images[1], truths[0], True)
        mirrored = [np.ascontiguousarray(x[:, ::-1]) for x in images]
        truth = np.ascontiguousarray(truths[1][:, ::-1])
        yield Pair(f"{path.stem} right", mirrored[1], mirrored[0], truth, True)


def read_pairs(folder: Path) -> Iterator[Pair]:
    """The pairs of a KITTI or Middlebury folder."""
    if (folder / "depth").is_dir():
        yield from read_raw_pairs(folder)
        return
    folder = folder / "training" if (folder / "training").is_dir() else folder
    kitti = [
        (left, right, truth)
        for left, right, truth in (
            ("image_2", "image_3", "disp_noc_0"),
            ("image_0", "image_1", "disp_noc"),
        )
        if (folder / truth).is_dir()
    ]
    for left, right, truth in kitti[:1]:
        for path in sorted((folder / truth).glob("*_10.png")):
            yield Pair(
                path.stem,
                read_grey(folder / left / path.name),
                read_grey(folder / right / path.name),
                read_truth(path, 256.0),
                True,
            )
    if kitti:
        return
    for truth_path in sorted(folder.rglob("*disp*2.png")):
        lefts = [p for p in truth_path.parent.glob("*2.png") if "disp" not in p.name]
        rights = [p for p in truth_path.parent.glob("*6.png") if "disp" not in p.name]
        stem = truth_path.stem.split("_")[0].split("-")[0]
        left_path = next((p for p in lefts if stem in p.name), lefts[0] if lefts else None)
        right_path = next((p for p in rights if stem in p.name), rights[0] if rights else None)
        if left_path is None or right_path is None:
            continue
        name = truth_path.parent.name if stem.startswith("disp") else stem
        truth_map = read_truth(truth_path, 4.0)
        yield Pair(name, read_grey(left_path), read_grey(right_path), truth_map, False)


@dataclass(frozen=True)
class Variant:
    """Settings of a matcher, and StereoSGBM's own options."""

    config: StereoConfig
    opencv: OpenCvOptions = OPENCV_OPTIONS

    def matcher(self, **changes: Any) -> StereoMatcher:
        """The matcher, with some settings changed."""
        return make_matcher(self.config.model_copy(update=changes), opencv=self.opencv)


def variants(disparities: int = 128) -> dict[str, Variant]:
    """The census matcher's main settings, and OpenCV behind every preprocessing."""
    found = {
        "census": Variant(StereoConfig(disparities=disparities)),
        "census shared": Variant(StereoConfig(disparities=disparities, right_map="shared")),
        "census 4 paths": Variant(StereoConfig(disparities=disparities, paths=4)),
    }
    base: dict[str, Any] = {"matcher": "opencv_sgbm", "disparities": disparities}
    settings: list[dict[str, Any]] = [
        {"preprocessing": "none", "block_size_px": 5, "p1": 16, "p2": 64},
        {"preprocessing": "none", "block_size_px": 3, "p1": 8, "p2": 32},
        {"preprocessing": "clahe", "block_size_px": 3, "p1": 24, "p2": 96},
        {"preprocessing": "clahe", "block_size_px": 3, "p1": 8, "p2": 32},
        {"preprocessing": "rank7x7", "block_size_px": 5, "p1": 16, "p2": 64},
        {"preprocessing": "rank7x7", "block_size_px": 3, "p1": 24, "p2": 96},
        {"preprocessing": "partial_ranks", "block_size_px": 3, "p1": 8, "p2": 32},
        {"preprocessing": "partial_ranks", "block_size_px": 5, "p1": 32, "p2": 128},
        {"preprocessing": "partial_ranks", "block_size_px": 3, "p1": 24, "p2": 96},
        {"preprocessing": "census_bytes", "block_size_px": 3, "p1": 24, "p2": 96},
    ]
    for number, options in enumerate(settings):
        kind = options.pop("preprocessing")
        config = StereoConfig(**base, opencv_preprocessing=kind)
        name = f"3way {kind} {options['block_size_px']} {options['p1']}"
        found[f"opencv {name}"] = Variant(config, OpenCvOptions(**options))
        for mode in ("sgbm", "hh") if number == 0 else ():
            found[f"opencv {mode}{name[4:]}"] = Variant(config, OpenCvOptions(**options, mode=mode))
    return found
