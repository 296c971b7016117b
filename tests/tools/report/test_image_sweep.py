"""A sweep over a drive with images: detected once, tracked anew at every frame rate."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from polemap.evaluation.runs.io import read_run_set
from polemap.simulate.camera_mounting import CameraConfig
from polemap.simulate.config import OdometryConfig, RenderConfig, SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.scenario import Scenario
from polemap.tools import cli
from polemap.tools.report.run_tables import STAGE_NAMES

STREET = Scenario.model_validate(
    {
        "name": "street",
        "route": {
            "closed": True,
            "corner_radius_m": 8.0,
            "corners_m": [[0, 0], [34, 0], [34, 20], [0, 20]],
        },
        "rows": [
            {"kind": "lamp", "side": "both", "spacing_m": 8, "offset_m": 0.5},
            {"kind": "sign", "side": "both", "spacing_m": 9, "offset_m": 0.7},
        ],
        "drive": {"speed_mps": 9.0, "standstill_s": 1.0},
        "backdrop": False,
    }
)
CONFIG = SimulateConfig(
    camera=CameraConfig(width_px=320, height_px=200, focal_px=343.0, frame_rate_hz=4.0),
    render=RenderConfig(workers=1, shadows=False),
    odometry=OdometryConfig(rate_hz=20.0),
)


@pytest.mark.slow
def test_poles_of_images_are_detected_once(tmp_path: Path) -> None:
    drive, run, cache = tmp_path / "drive", tmp_path / "run", tmp_path / "cache"
    simulate_drive(STREET, drive, 1, 3, CONFIG, objects=True)
    few = ["--set", "localize.particles=80", "--set", "localize.output.rate_hz=20"]
    words = ["localize", drive, "--map", drive / "objects.geojson", "--out", run, *few]
    words += ["--cache", cache, "--workers", 1]
    assert cli.run([str(word) for word in words]) == cli.GOOD
    detection_files = {path: path.stat().st_mtime_ns for path in cache.iterdir()}
    with (drive / "frames.csv").open() as stream:
        frames = len(list(csv.DictReader(stream)))
    assert len(detection_files) == -(-frames // 20) >= 2
    (kept,) = read_run_set(run).runs
    assert {"disparity_ms", "detection_ms", "tracking_ms", "particle_filter_ms"} < set(kept.timings)
    assert all(np.nanmin(kept.timings[f"{name}_ms"]) > 0.0 for name in ("disparity", "tracking"))
    report = ["report", run, "--out", tmp_path / "out", "--cache", cache, "--workers", 1]
    report += ["--sweep", "frame_rate=full,half", "--sweep", "particles=80", "--sweep-runs", 2]
    assert cli.run([str(word) for word in report]) == cli.GOOD
    after = {path: path.stat().st_mtime_ns for path in cache.iterdir()}
    # nothing was detected again; the run's own seed stands for itself, so three replays are new
    assert detection_files.items() <= after.items()
    assert len(after) - len(detection_files) == 3
    content = json.loads((tmp_path / "out" / "report.json").read_text())
    full, half = content["sweeps"]["frame_rate"]["street_3"]
    assert full["frame_rate_hz"] == pytest.approx(2.0 * half["frame_rate_hz"]) == 4.0
    assert full["runs"] == half["runs"] == 2
    stages = content["timing"]["street_3"]["stages_ms"]
    assert {"disparity", "detection", "tracking", "particle_filter", "output_pose"} <= set(stages)
    assert stages["perception"]["median"] > stages["disparity"]["median"] > 0.0
    whole = content["timing"]["street_3"]["whole_update_ms"]
    assert stages["perception"]["median"] < 2.0 * whole["median"] <= 2.0 * whole["p99"]
    table = (tmp_path / "out" / "tables" / "timing.csv").read_text()
    assert all(f",{name}," in table for name in STAGE_NAMES.values() if "," not in name)
    # the gate's own record of every pose stands in the picture of consistency
    nis = kept.health_numbers("nis")
    assert nis is not None
    assert np.isfinite(nis).sum() > 10
    picture = (tmp_path / "out" / "pictures" / "street-3-consistency.svg").read_text()
    assert "NIS at the gate" in picture
    assert f"mean {np.nanmean(nis):.2f}" in picture
    # a part of the detections that is lost is found anew, and only that one
    lost = min(detection_files)
    lost.unlink()
    assert cli.run([str(word) for word in report]) == cli.GOOD
    again = {path: path.stat().st_mtime_ns for path in cache.iterdir()}
    assert {path for path in after if again[path] != after[path]} == {lost}
