"""What is measured at all hypotheses at once, against one hypothesis, height, flank at a time."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest

from polemap.detect import flanks, surroundings
from polemap.detect.features import NAMES, Profiles, measure_features
from polemap.detect.flanks import INSIDE
from polemap.detect.ground import Ground, ground_from_mounting
from polemap.detect.hypotheses import Hypotheses
from polemap.detect.surroundings import HEIGHTS_M
from polemap.stereo.depth_edges import UprightMaps, upright_maps
from polemap.stereo.matching import DisparityPair
from tests.polemap.street import RIG

HEIGHT, WIDTH = 400, 640


def _scene(seed: int) -> tuple[Hypotheses, UprightMaps, np.ndarray]:
    """Random hypotheses in a random picture, some beyond it; disparities near theirs, holes."""
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 255, (HEIGHT, WIDTH)).astype(np.uint8)
    image = (image // 4 + 60 * (np.arange(WIDTH) // 40 % 2)).astype(np.uint8)
    near = 20.0 + 10.0 * (np.arange(WIDTH) // 20 % 3 == 0) + rng.normal(0, 0.3, (2, HEIGHT, WIDTH))
    near[rng.random(near.shape) < 0.2] = np.nan
    maps = upright_maps(DisparityPair(*near.astype(np.float32)), 3)
    n = 40
    top = rng.uniform(10.0, 150.0, n)
    values = {name: rng.uniform(0.0, 1.0, n) for name in Hypotheses.__slots__}
    values |= {
        "column_px": np.where(rng.random(n) < 0.8, rng.integers(0, 16, n) * 40.0, 3.0),
        "row_px": top + 40.0,
        "slope": rng.uniform(-0.15, 0.15, n),
        "width_px": rng.uniform(2.0, 40.0, n),
        "top_px": top,
        "bottom_px": top + rng.uniform(20.0, 240.0, n),
        "disparity_px": rng.choice([20.0, 30.0], n),
        "slices": rng.integers(3, 40, n).astype(float),
        "far_left_px": rng.uniform(0.0, 19.0, n),
    }
    return Hypotheses(**values), maps, image


def _flank(
    image: np.ndarray, hypotheses: Hypotheses, row: int, side: float
) -> tuple[float, float, bool]:
    """Where a candidate's flank has its strongest gradient, how strong, and if it counts."""
    reach, count = flanks._REACH_PX, flanks._ROWS
    share = (np.arange(count) + 0.5) / count
    rows = hypotheses.top_px[row] + (hypotheses.bottom_px[row] - hypotheses.top_px[row]) * share
    flank = hypotheses.column_px[row] + hypotheses.slope[row] * (rows - hypotheses.row_px[row])
    flank = flank + side * hypotheses.width_px[row]
    base = np.rint(flank)
    v = np.clip(np.rint(rows).astype(int), 0, HEIGHT - 1)
    contrast = float(image[::8, ::8].std()) + 1e-6
    gradient = np.zeros((count, 2 * reach + 1))
    for k in range(count):
        u = np.clip(int(base[k]) + np.arange(-reach - 1, reach + 2), 0, WIDTH - 1)
        gradient[k] = np.convolve(image[v[k], u].astype(float), [0.5, 0.0, -0.5], "valid")
    gradient /= contrast
    mean = np.abs(gradient.mean(axis=0)) + 0.35 * np.abs(gradient).mean(axis=0)
    mean *= np.exp(-0.5 * (np.arange(-reach, reach + 1) / 2.5) ** 2)
    at = int(np.clip(mean.argmax(), 1, 2 * reach - 1))
    before, peak, after = mean[at - 1 : at + 2]
    bend = before - 2.0 * peak + after
    fraction = np.clip(0.5 * (before - after) / bend, -0.5, 0.5) if bend < -1e-9 else 0.0
    counts = bool(peak / (np.median(mean) + 0.02) >= 1.8 and peak >= 0.05)
    return at - reach + fraction + float(np.mean(base - flank)), float(peak), counts


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_flanks_are_sharpened_as_one_after_the_other(seed: int) -> None:
    hypotheses, _, image = _scene(seed)
    left, right, _, edge_left, edge_right, _ = flanks.refine_flanks(hypotheses, image)
    trusted = 0
    for row in range(len(hypotheses)):
        expected = []
        for side, edge in ((-0.5, edge_left), (0.5, edge_right)):
            moved, peak, counts = _flank(image, hypotheses, row, side)
            assert edge[row] == pytest.approx(min(peak, 1.5), rel=1e-9)
            plain = hypotheses.column_px[row] + side * hypotheses.width_px[row]
            expected.append((plain, plain + moved * counts))
            trusted += counts
        crossed = expected[1][1] - expected[0][1] < 0.5
        pair = [one[0 if crossed else 1] for one in expected]
        assert [left[row], right[row]] == pytest.approx(pair, rel=1e-9)
    assert trusted > 10


def _at(disparity: np.ndarray, row: float, column: float) -> float:
    v, u = int(np.rint(row)), int(np.rint(column))
    inside = 0 <= v < disparity.shape[0] and 0 <= u < disparity.shape[1]
    return float(disparity[v, u]) if inside and disparity[v, u] > 0 else np.nan


def _shares(
    found: Profiles, hypotheses: Hypotheses, maps: UprightMaps, ground: Ground, row: int
) -> dict[str, float]:
    """The features that count heights, of one candidate, height by height."""
    d = hypotheses.disparity_px[row]
    per_m, depth = d / RIG.baseline_m, RIG.focal_px * RIG.baseline_m
    width = max(found.right_px[row] - found.left_px[row], 0.5)
    centre = 0.5 * (found.left_px[row] + found.right_px[row])
    tolerance, free = 0.8 + 0.3 * d * d / depth, max(0.5 * d * d / depth, 0.8)
    foot = float(ground.row_px(hypotheses.column_px[row], d))
    table = []
    for height_m in HEIGHTS_M:
        v = foot - height_m * per_m
        u = centre + hypotheses.slope[row] * (v - hypotheses.row_px[row])
        out = width / 2 + surroundings.CLEAR_PX + surroundings.BESIDE_M * per_m
        v_map = v / maps.row_step_px
        inside = np.array([_at(maps.left, v_map, u + part * width) for part in INSIDE])
        right = np.array([_at(maps.left, v_map, u + o) for o in out])
        left = np.array([_at(maps.right, v_map, u - d - o) for o in out])
        visible = 0 <= v <= maps.height_px - 1
        on = visible and np.count_nonzero(np.abs(inside - d) <= tolerance) >= 2
        hidden = visible and np.count_nonzero(inside > d + tolerance) >= 2
        lo, ro = left < d - free, right < d - free
        near = bool((left > d + tolerance).any() or (right > d + tolerance).any())
        both = on and lo[:3].any() and ro[:3].any()
        same = (np.abs(np.array([left[:3], right[:3]]) - d) <= tolerance).any()
        blank = np.isnan(left[:3]).all() or np.isnan(right[:3]).all()
        table.append([visible, hidden, on, both, lo[0], ro[0], lo[3], ro[3], near, same, blank])
    visible, hidden, on, both, *beside = np.array(table, dtype=bool).T
    clear, low = visible & ~hidden, HEIGHTS_M <= 1.0
    pairs = {"on_share": (on, clear), "on_low": (on & low, clear & low), "free_both": (both, on)}
    names = ["free_left_near", "free_right_near", "free_left_wide", "free_right_wide"]
    names += ["near_beside", "same_beside", "blank_beside"]
    pairs |= {name: (one, on) for name, one in zip(names, beside, strict=True)}
    pairs |= {"hidden_share": (hidden, visible)}
    shares = {name: np.sum(one & of) / max(np.sum(of), 1) for name, (one, of) in pairs.items()}
    above = []
    rows = [hypotheses.top_px[row] - up_m * per_m for up_m in surroundings.ABOVE_M]
    for v in rows:
        u = centre + hypotheses.slope[row] * (v - hypotheses.row_px[row])
        above.append(_at(maps.left, v / maps.row_step_px, u))
    seen = max(sum(v >= 0 for v in rows), 1)
    shares["above_free"] = sum(value < d - free for value in above) / seen
    shares["above_same"] = sum(abs(value - d) <= tolerance for value in above) / seen
    runs = "".join("x" if flag else " " for flag in both).split()
    shares["log_height"] = np.log(0.1 + 0.15 * np.sum(both))
    shares["log_run"] = np.log(0.1 + 0.15 * max(map(len, runs), default=0))
    return shares


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_heights_are_counted_as_one_after_the_other(seed: int) -> None:
    hypotheses, maps, image = _scene(seed)
    ground = ground_from_mounting(RIG)
    found = measure_features(hypotheses, maps, image, ground, RIG)
    assert found.features.shape == (len(hypotheses), len(NAMES))
    seen: dict[str, list[float]] = defaultdict(list)
    for row in range(len(hypotheses)):
        for name, value in _shares(found, hypotheses, maps, ground, row).items():
            got = found.features[row, NAMES.index(name)]
            assert got == pytest.approx(value, rel=1e-9), name
            seen[name].append(got)
    for name, values in seen.items():
        assert np.std(values) > 0.01, f"the scene has to vary {name}"


def test_no_hypotheses_have_no_features() -> None:
    hypotheses, maps, image = _scene(1)
    none = hypotheses.take(np.zeros(len(hypotheses), dtype=bool))
    found = measure_features(none, maps, image, ground_from_mounting(RIG), RIG)
    assert found.features.shape == (0, len(NAMES))
    assert len(found.left_px) == len(found.disparity_px) == 0
