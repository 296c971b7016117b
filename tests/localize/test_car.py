"""What a car file tells the localizer."""

from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.errors import ConfigError
from polemap.localize.config import (
    ANY_SLIP_RAD_PER_MPS2,
    LocalizeConfig,
    OdometryConfig,
    for_car,
)
from polemap.localize.replay import replay
from polemap.vehicle.io import car_names, load_car
from tests.localize.point_drives import street_drive

PASSAT = load_car("passat")


@pytest.mark.parametrize("name", car_names())
def test_the_slip_is_that_of_the_car(name):
    car = load_car(name)
    used = for_car(LocalizeConfig(), car)
    assert used.odometry.rear_slip_rad_per_mps2 == car.rear_slip_rad_per_mps2
    assert for_car(used, PASSAT) == used


def test_without_a_car_it_is_that_of_any_car_and_a_setting_overrides_both():
    assert LocalizeConfig().odometry.rear_slip_rad_per_mps2 == ANY_SLIP_RAD_PER_MPS2
    assert for_car(LocalizeConfig(), None).odometry.slip_rad_per_mps2 == ANY_SLIP_RAD_PER_MPS2
    stated = LocalizeConfig(odometry=OdometryConfig(slip_rad_per_mps2=0.003))
    assert for_car(stated, PASSAT) is stated


def test_a_car_that_slips_as_no_tyre_does_is_refused():
    axle = replace(PASSAT, rear_stiffness_nprad=0.1 * PASSAT.rear_stiffness_nprad)
    with pytest.raises(ConfigError, match=r"car passat: its rear axle slips .* of one tyre"):
        for_car(LocalizeConfig(), axle)


def test_a_drive_that_names_a_car_is_replayed_with_its_slip():
    street = street_drive(3, duration_s=4.0)
    named = replace(street.drive, car=PASSAT)
    slip = OdometryConfig(slip_rad_per_mps2=PASSAT.rear_slip_rad_per_mps2)
    few = LocalizeConfig(particles=50)
    stated = LocalizeConfig(particles=50, odometry=slip)
    runs = [
        replay(drive, street.pole_map, street.scans, config, seed=1)
        for drive, config in ((named, few), (street.drive, stated), (street.drive, few))
    ]
    assert np.array_equal(runs[0].pf.poses, runs[1].pf.poses)
    assert not np.array_equal(runs[0].pf.poses, runs[2].pf.poses)
