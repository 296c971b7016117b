"""A drive and a map to poses: recorded drives at once, a car on the road sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import FrameError
from polemap.localize import localizer as live
from polemap.localize import replay as replays
from polemap.localize.config import for_car
from polemap.localize.pose_queue import PoseUpdate
from polemap.map.city.city_map import CityMap
from polemap.map.pole_map import PoleMap
from polemap.settings import Settings


class Localizer(live.Localizer):
    """A pole map and a stream of samples to a pose at any moment, for use in the car.

    Add odometry, fixes and stereo frames (or scans) as they arrive; ask for the pose whenever it
    is needed, from another thread if you like.

    Args:
        pole_map: of `read_map`, or of `open_map` where it is a city's; None localizes by odometry
            and GNSS alone.
        car: names wheelbase, camera and antenna. A recording of the same car does, and so does a
            folder with nothing but a `drive.yaml`.
        settings: the defaults where not given.
        seed: of the particle filter.
        on_update: called with every pose of the particle filter once its fate is known.

    Raises:
        FrameError: the map is in another frame than the car's drives.
    """

    def __init__(
        self,
        pole_map: PoleMap | CityMap | None,
        car: Drive,
        settings: Settings | None = None,
        *,
        seed: int = 0,
        on_update: Callable[[PoseUpdate], None] | None = None,
    ) -> None:
        chosen = settings or Settings()
        perception = None
        if car.rig is not None:
            # a car that is told its poles starts without the half second of these imports
            from polemap.api.poles import Perception

            perception = Perception(car, chosen)
        if pole_map is not None and pole_map.frame != car.frame:
            raise FrameError(
                f"the map is in {pole_map.frame}, the car's drive {car.name} in {car.frame}: "
                "read the map in the car's frame, read_map(path, car.frame)"
            )
        super().__init__(
            pole_map,
            for_car(chosen.localize, car.car),
            car.wheelbase_m,
            np.random.default_rng(seed),
            gnss_antenna_m=car.gnss_antenna_m,
            perception=perception,
            on_update=on_update,
        )


def replay(
    drive: Drive,
    pole_map: PoleMap | CityMap | None,
    settings: Settings | None = None,
    *,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
    force: bool = False,
) -> replays.Run:
    """Localize a recorded drive in a map, as a car on the road would have done it.

    Args:
        drive: with odometry, and images or poles of its own.
        pole_map: in the drive's frame, of `read_map` or `open_map`; None localizes by odometry and
            GNSS alone.
        settings: the defaults where not given.
        seed: of the particle filter; the same seed gives the same poses, bit for bit.
        progress: called with the number of frames looked at since the last call.
        force: go on with inputs that cannot be right; what is doubtful is warned of either way.

    Returns:
        The run: `kf`, the 100 Hz output, and `pf`, the particle filter, as trajectories with
        stamps, poses `(n, 3)` east, north, yaw and covariances; `counts` of what happened.

    Raises:
        FrameError: map and drive are in different frames.
        InputError: the drive lacks what localizing needs, an image cannot be read, or drive and
            map contradict themselves or each other.
    """
    # not at the top, where a localizer in a car would wait for them
    from polemap.api.plausible import check
    from polemap.perception import scan_drive

    chosen = settings or Settings()
    has_poles = drive.has_frames or bool(drive.scans)
    replays.check_inputs(drive, pole_map, has_poles=has_poles)
    check(drive, pole_map, force=force)
    scans: Sequence[Detections] = ()
    if pole_map is not None:
        scans = scan_drive(drive, chosen.polemap, progress, stereo=chosen.stereo)
    return replays.replay(drive, pole_map, scans, chosen.localize, seed=seed)
