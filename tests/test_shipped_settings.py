"""Settings files that come with the package: found by name, and whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import ConfigError
from polemap.localize.replay import replay
from polemap.settings import Settings, load_settings, read_tree, shipped_settings
from polemap.simulate.config import DetectorConfig
from polemap.simulate.points.drive import PointScenario, simulate_points

PRINTED = Path("papers/s16.yaml")


def test_every_shipped_file_is_found_from_anywhere(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "papers/s16.yaml" in shipped_settings()
    for name in shipped_settings():
        assert load_settings(Path(name)) != Settings()


def test_a_file_of_the_user_comes_before_one_of_the_package(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "papers").mkdir()
    (tmp_path / "papers" / "s16.yaml").write_text("localize: {particles: 77}\n")
    assert load_settings(Path("papers/s16.yaml")).localize.particles == 77


def test_a_set_value_comes_after_the_file() -> None:
    settings = load_settings(Path("papers/s16.yaml"), ["localize.estimate=best_mode"])
    assert settings.localize.estimate == "best_mode"
    assert settings.localize.covariance == "particles"


@pytest.mark.parametrize("name", ["papers/s17.yaml", "s16.yaml", "papers/../papers/s16.yaml"])
def test_what_the_package_lacks_is_named_with_what_it_has(name, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"cannot be read.*papers/s16\.yaml"):
        read_tree(Path(name))


def test_the_printed_method_localizes_a_clean_drive() -> None:
    scenario = PointScenario(duration_s=12.0, detector=DetectorConfig(rate_hz=5.0))
    points = simulate_points(scenario, np.random.default_rng(3))
    config = load_settings(PRINTED, ["localize.particles=300"]).localize
    run = replay(points.drive, points.pole_map, points.scans, config, seed=1)
    assert len(run.pf) > 20
    for track in (run.pf, run.kf):
        assert track.covariance is not None
        assert np.isfinite(track.poses).all()
        assert np.isfinite(track.covariance).all()
    # every pose is offered, and none is ever gone to
    assert {u.decision for u in run.updates} <= {"started", "accepted", "ignored"}
    assert "gnss_accepted" not in run.counts or run.counts["gnss_accepted"] == 0
