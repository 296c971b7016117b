"""The kinds of fault of the campaign by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.campaign.detector_faults import (
    Faulty,
    Kind,
    frozen_scans,
    mirrored,
    ranges_times,
    scans_at_another_time,
    scans_changed,
    turned,
    with_course,
)
from benchmarks.campaign.drives import STREET, car_park, street
from benchmarks.campaign.faults import (
    aged_map,
    doubled_map,
    fixes_jump,
    fixes_late,
    fixes_walk,
    odometry_held_back,
    other_map,
    parked,
    silent,
    speed_drifts,
    speed_times,
    unseen,
    yaw_rate_changed,
)
from polemap.simulate.points.motion import WindingRoad

_STANDING = replace(STREET, motion=WindingRoad(standstill_s=8.0))


KINDS: dict[str, Kind] = {
    "none": lambda seed: Faulty(street(seed)),
    "none, winding road after a standstill": lambda seed: Faulty(street(seed, _STANDING)),
    "speed 0 for 0.1 s": speed_times(0.0, 0.1),
    "speed 0 for 0.5 s": speed_times(0.0, 0.5),
    "speed 0 for 2 s": speed_times(0.0, 2.0),
    "speed 0 for 2 s, no poles": speed_times(0.0, 2.0, unseen=True),
    "speed x 1.3 for 1 s": speed_times(1.3, 1.0),
    "speed x 1.3 for 5 s": speed_times(1.3, 5.0),
    "speed x 1.8 for 1 s": speed_times(1.8, 1.0),
    "speed x 1.8 for 5 s": speed_times(1.8, 5.0),
    "speed x 1.3 for 5 s, no poles": speed_times(1.3, 5.0, unseen=True),
    "speed x 1.3 gently for 8 s": speed_drifts(1.3, 3.0, 8.0),
    "speed x 0.7 for 3 s": speed_times(0.7, 3.0),
    "silent for 1 s": silent(1.0),
    "silent for 5 s": silent(5.0),
    "silent for 10 s": silent(10.0),
    "yaw rate other sign": yaw_rate_changed(lambda w: -w),
    "yaw rate other sign for 5 s": yaw_rate_changed(lambda w: -w, 5.0),
    "yaw rate 0 for 2 s": yaw_rate_changed(lambda w: 0.0 * w, 2.0),
    "yaw rate 0.05 rad/s off for 5 s": yaw_rate_changed(lambda w: w + 0.05, 5.0),
    "yaw rate in degrees": yaw_rate_changed(np.degrees),
    "car park, 7 % in tight turns": lambda seed: Faulty(car_park(seed), 30.0),
    "car park, lamps along the way": parked("along the way"),
    "car park, lamps in a grid": parked("grid"),
    "car park, lamps in rows": parked("rows"),
    "no poles for 4 s": unseen(4.0),
    "no poles for 20 s": unseen(20.0),
    "fixes 18 s late": fixes_late(18.0),
    "fixes 18 s early": fixes_late(-18.0),
    "fixes 2 s late": fixes_late(2.0),
    "fixes jump 10 m": fixes_jump(10.0),
    "fixes jump 30 m for 10 s": fixes_jump(30.0, 10.0),
    "fixes jump 100 m": fixes_jump(100.0),
    "fixes 60 m off from the start": fixes_jump(60.0, start_s=-1.0),
    "fixes walk off at 1 m/s": fixes_walk(1.0),
    "map 40 % out of date": aged_map(0.4, 0.4),
    "map of which 40 % is gone": aged_map(0.0, 0.67),
    "map doubled, 1 m off": doubled_map(1.0),
    "map doubled, 0.6 m and 0.5 degrees off": doubled_map(0.6, 0.009),
    "map doubled, 3 m off": doubled_map(3.0),
    "map of another street": other_map,
    "detector ranges x 0.9 from the start": scans_changed(ranges_times(0.9), start_s=-1.0),
    "detector ranges x 1.1 from the start": scans_changed(ranges_times(1.1), start_s=-1.0),
    "detector turned by 2 degrees from the start": scans_changed(
        turned(np.radians(2.0)), start_s=-1.0
    ),
    "none, course from the camera": with_course(lambda seed: Faulty(street(seed))),
    "camera turned by 2 degrees from the start, its own course": with_course(
        scans_changed(turned(np.radians(2.0)), start_s=-1.0), np.radians(2.0)
    ),
    "detector ranges x 0.9": scans_changed(ranges_times(0.9)),
    "detector ranges x 1.1": scans_changed(ranges_times(1.1)),
    "detector turned by 2 degrees": scans_changed(turned(np.radians(2.0))),
    "scans stamped 0.3 s early for 8 s": scans_at_another_time(-0.3, 8.0),
    "odometry held back by 0.5 s for 8 s": odometry_held_back(0.5, 8.0),
    "poles mirrored for 5 s": scans_changed(mirrored, 5.0),
    "poles frozen for 3 s": frozen_scans(3.0),
}
