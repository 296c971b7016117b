"""Know where the car is from the poles beside the road.

Poles in one stereo pair, as a table and a picture:

    import polemap

    drive = polemap.open_drive("drives/monday")
    frame = drive.read_frame(0)
    found = polemap.Perception(drive).poles(frame.left, frame.right)
    print(found.table)
    pyplot.imshow(found.picture())

A map from a drive with reference poses:

    pole_map = polemap.build_map(drive)
    polemap.write_map(pole_map, "campus.gpkg")

Another drive localized in it, and how well:

    friday = polemap.open_drive("drives/friday")
    run = polemap.replay(friday, polemap.read_map("campus.gpkg", friday.frame))
    pyplot.plot(*run.kf.poses[:, :2].T)
    print(polemap.evaluate(run, friday).lateral_rmse_m)

Live, sample by sample as they arrive:

    localizer = polemap.Localizer(pole_map, friday)
    for sample in samples:
        localizer.add_sample(sample)
        pose = localizer.pose_at(sample.arrival_s)

The map of a whole city is opened in no time, and its poles are read around the car:

    localizer = polemap.Localizer(polemap.open_map("city.parquet", friday.frame), friday)

Every setting has a default; `Settings` overrides:

    settings = polemap.Settings(localize={"particles": 500})
    run = polemap.replay(friday, pole_map, settings, seed=1)

Everything that goes wrong with input is a `PolemapError` whose message says what, where and how to
mend it. The names are imported when they are first used, so `import polemap` itself costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # for editors and type checkers; at run time __getattr__ does it
    from polemap.api.accuracy import evaluate
    from polemap.api.localization import Localizer, replay
    from polemap.api.maps import build_map
    from polemap.api.poles import Perception
    from polemap.drivelog.readers.registry import open_drive
    from polemap.errors import PolemapError
    from polemap.map.city.io import open_map
    from polemap.map.io import read_map, write_map
    from polemap.settings import Settings

__version__ = "0.1.0"

__all__ = [
    "Localizer",
    "Perception",
    "PolemapError",
    "Settings",
    "__version__",
    "build_map",
    "evaluate",
    "open_drive",
    "open_map",
    "read_map",
    "replay",
    "write_map",
]

_HOMES = {
    "Localizer": "polemap.api.localization",
    "Perception": "polemap.api.poles",
    "PolemapError": "polemap.errors",
    "Settings": "polemap.settings",
    "build_map": "polemap.api.maps",
    "evaluate": "polemap.api.accuracy",
    "open_drive": "polemap.drivelog.readers.registry",
    "open_map": "polemap.map.city.io",
    "read_map": "polemap.map.io",
    "replay": "polemap.api.localization",
    "write_map": "polemap.map.io",
}


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'polemap' has no attribute '{name}'")
    value = getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
