"""Which fixes count against a place: those far from a new one, until poles have held it."""

from __future__ import annotations

from collections import Counter

import numpy as np

from polemap.localize.config import LocalizeConfig
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.particle_filter.pole_weigher import PoleWeigher
from polemap.localize.particle_filter.recovery import Recovery
from tests.localize.streets import street


def recovery() -> Recovery:
    config = LocalizeConfig()
    poles = street(np.random.default_rng(1), 40)
    return Recovery(
        poles, config.recovery, GnssReceiver(config=config.gnss), PoleWeigher(poles, config),
        np.random.default_rng(0), Counter(),
    )  # fmt: skip


def see_fix(place: Recovery, stamp_s: float, distance_sd: float) -> None:
    place.lost.add_match(stamp_s, 2, 2, 2.0, 0.1, distance_sd, held=place.held(stamp_s))


def test_a_fix_far_from_a_new_place_counts_until_poles_have_held_it() -> None:
    place = recovery()
    place.proof.believe()
    see_fix(place, 0.0, 2.0)
    assert not place.far_from_fixes
    see_fix(place, 1.0, 9.0)
    assert place.far_from_fixes
    for k in range(10):
        place.add_held(1.0 + 0.1 * k, 2, 1.0, 0.1)
    assert not place.far_from_fixes


def test_a_pose_that_has_become_wide_is_held_by_no_pole() -> None:
    place = recovery()
    place.proof.believe()
    for k in range(10):
        place.add_held(0.1 * k, 2, 1.0, 0.1)
    assert place.held(1.0)
    place.add_held(4.0, 0, 1.0, 3.5)
    see_fix(place, 5.0, 9.0)
    assert place.far_from_fixes
