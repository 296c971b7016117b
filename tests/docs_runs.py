"""How the tests run each command of the docs: on what, how shortened, and which not at all."""

from __future__ import annotations

import re
from dataclasses import dataclass

from polemap.simulate.scenario import scenario_names
from polemap.tools import cli
from tests.docs_commands import words_of

# what each page takes for granted: a place, and the name of its maker in docs_data.py
NEEDS: dict[str, dict[str, str]] = {
    "README.md": {
        "drives/monday": "monday", "drives/friday": "friday", "sequences": "kitti/sequences",
        "poles": "kitti/poles", "poses": "kitti/poses", "LOG": "bag_monday",
    },
    "calibration.md": {"DRIVE": "monday"},
    "camera_odometry.md": {"DRIVE": "monday"},
    "city.md": {"drives/lap_1": "lap_1", "drives/lap_2": "lap_2"},
    "drives.md": {"DRIVE": "lap_1"},
    "estimators.md": {"LOG": "estimator_log", "DRIVE": "driven_log", "revs_250lm": "revs"},
    "kitti.md": {"": "kitti"},
    "live.md": {
        "recording.mcap": "street_mcap", "campus.gpkg": "map.gpkg", "drives/lap_1": "lap_1",
    },
    "logs.md": {
        "can.csv": "can", "gps.nmea": "nmea", "track.gpx": "gpx", "signals.yaml": "signals",
    },
    "maps.md": {
        "drives/monday": "lap_1", "drives/tuesday": "lap_2", "drives/friday": "lap_2",
        "campus_old.gpkg": "map.gpkg",
    },
    "perception.md": {
        "DRIVE": "monday", "MAP.geojson": "monday/objects.geojson", "kitti_odometry": "kitti",
        "benchmarks/polemap/kitti_03_unmapped_poles.csv": "kitti/poles/03.csv",
        "monday": "monday", "friday": "friday",
    },
    "place.md": {"drives/lap_1": "long_1", "drives/lap_2": "long_2", "drive": "long_2"},
    "recordings.md": {
        "monday": "bag_monday", "tuesday": "bag_friday", "drive.mcap": "drive_mcap",
    },
    "repeatability.md": {"victoria_park/drive": "lap_1", "campus/drive": "lap_1"},
    "simulator.md": {"my_street.yaml": "my_street"},
    "slam.md": {
        "drives/taxi": "taxi", "drives/taxi_monday": "taxi", "drives/taxi_friday": "taxi_friday",
        "drives/kitti": "kitti",
    },
    "start.md": {"FILE": "street_mcap", "LOG.csv": "can"},
    "stereo.md": {"DRIVE": "monday"},
    "troubleshooting.md": {"DRIVE": "monday", "MAP.gpkg": "map.gpkg"},
    "viewers.md": {"drives/monday": "monday"},
}  # fmt: skip
EVERYWHERE = {"block.yaml": "block"}

# what the reader of a page did before
BEFORE = {
    "city.md": ["polemap map drives/lap_1 --out districts/north.gpkg"],
    "place.md": ["polemap map drives/lap_1 --out districts/north.gpkg"],
    "repeatability.md": [
        "polemap map campus/drive --out campus/map.gpkg",
        "polemap localize campus/drive --map campus/map.gpkg --out runs/campus --runs 2",
    ],
    "viewers.md": [
        "polemap map drives/monday --out m.gpkg",
        "polemap localize drives/monday --map m.gpkg --out runs/lap_2",
    ],
}

# words in capitals and variables of the shell, where no file can have the name
STANDS_FOR = (
    ("polemap new DRIVE", "polemap new new_drive"),
    ("LOG --estimator NAME --vehicle CAR --out CSV",
     "LOG --estimator bicycle --vehicle 250lm --out a.csv"),
    ("LOG --identify A:B[,C:D] --vehicle START --out CAR.yaml [--also LOG2]",
     "LOG --identify 0:3 --vehicle 250lm --out CAR.yaml --also LOG"),
    ("--vehicle CAR", "--vehicle passat"),
    ("RUN... --out DIR", "runs/campus --out DIR"),
    ("--evaluate MAP [--unmapped MAP] [--pictures]",
     "--evaluate MAP.geojson --unmapped MAP.geojson --pictures"),
    ("LEFT RIGHT --out", "DRIVE/left/000000.png DRIVE/right/000000.png --out"),
    ("polemap info MAP", "polemap info MAP.gpkg"),
    ("DRIVE=MAP ... --out", "DRIVE=MAP.geojson --out"),
    ("$simulated", "monday=monday/objects.geojson friday=friday/objects.geojson"),
)  # fmt: skip

# what makes a command short: words that are added, or stand in place of others
SMALL = (
    "--set simulate.camera.width_px=96 --set simulate.camera.height_px=64 "
    "--set simulate.camera.focal_px=100 --set simulate.camera.frame_rate_hz=1 "
    "--set simulate.render.workers=1 --set simulate.render.shadows=false"
)
SHORTER = (
    (r"^(polemap simulate (?!.*--scans).*)$", rf"\1 {SMALL}"),
    (rf"^(polemap simulate) (?:{'|'.join(scenario_names())})(?= (?!.*--scans))", r"\1 block.yaml"),
    (r"^(polemap simulate) residential(?= --scans)", r"\1 block.yaml"),
    (r"^(polemap (?:view|report|localize(?! --follow)) .*)$", r"\1 --workers 1"),
    # what a command takes and writes depends on neither
    (
        r"^(polemap localize (?!--follow).*)$",
        r"\1 --set localize.particles=300 --set localize.output.rate_hz=25",
    ),
    (r"--workers 8", "--workers 1"),
    (r"--runs \d+\b", "--runs 2"),
    (r"--identify 150:250", "--identify 150:155"),
    (r"--sweep frame_rate=\S+", "--sweep frame_rate=full,half"),
    (r"--sweep particles=\S+", "--sweep particles=50,100"),
    (r" --sweep-runs 50", ""),
    (r"(--sweep localize\.p_detection)=\S+", r"\1=0.5,0.9"),
    (r"(.*--sweep .*)", r"\1 --sweep-runs 1"),
)


@dataclass(frozen=True, slots=True)
class Left:
    """Commands that this suite does not run as they stand, and why.

    Attributes:
        pattern: what they match.
        why: and what is done in place.
        long: whether `make check-docs` runs them.
    """

    pattern: str
    why: str
    long: bool = False


LEFT = (
    Left(r"^polemap demo", "two minutes", long=True),
    Left(r"^polemap study full-loop", "an hour; test_full_loop.py closes it on a short street"),
    Left(r"^polemap study", "ten seconds to minutes; tests/tools/test_study.py runs short ones",
         long=True),
    Left(r"^polemap train .*--kind corner", "needs drives past houses, minutes to render"),
    Left(r"^make (?:demo|site|docs|lint)$", "minutes, or writes into the source", long=True),
    Left(r"^make test", "is this suite"),
    Left(r"^make city", "half an hour; test_every_target_is_there asks make for it"),
    Left(r"^pip ", "installs from the network; CI installs before it tests"),
    Left(r"^polemap --install-completion", "writes into the shell's start-up file"),
    Left(r"somewhere\.yard", "needs the plug-in installed; tests/tools/test_plugins.py does it"),
    Left(r"^python -m benchmarks", "minutes to hours; imported, and the options are looked up"),
)  # fmt: skip


def left(command: str) -> Left | None:
    return next((one for one in LEFT if re.search(one.pattern, command)), None)


def is_mention(command: str) -> bool:
    """A verb, perhaps with options, that the text speaks of, without anything to run it on."""
    words = command.split()
    if words[0] != "polemap":
        return False
    own = [word for word in words[2:] if not word.startswith("-")]
    if own:
        return words[1] == "VERB" or words[-1] in ("NAME", "--write-mapping", "time")
    return words[1:2] == ["VERB"] or (len(words) > 1 and words[-1] not in ("--list", "--help"))


def as_run(command: str) -> list[str]:
    """The words of a command of polemap, with what they stand for and made short."""
    if left(command) is not None or is_mention(command):
        verb = command.split()[1:2]
        return [*(verb if verb and verb[0] in cli.VERBS else ()), "--help"]
    for told, meant in STANDS_FOR:
        command = command.replace(told, meant)
    for pattern, shorter in SHORTER:
        command = re.sub(pattern, shorter, command)
    return words_of(command)[1:]
