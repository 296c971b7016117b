"""`polemap lanes`: heading, offset and curvature in the lane from a drive's pictures."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file, atomic_folder, check_file, check_folder
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.readers.registry import open_drive
from polemap.electric.io import read_signal_log
from polemap.electric.lanes import (
    NAMES,
    LaneTrack,
    follow_lane,
    lane_log,
    make_finder,
    preview_of,
    with_lanes,
)
from polemap.electric.signals import SignalLog
from polemap.parsing.csv_text import check_csv
from polemap.parsing.errors import named
from polemap.tools.findings import require_plausible
from polemap.tools.lane_pictures import LanePictures
from polemap.tools.option_types import ForceOption, TopicsOption, frame_range
from polemap.tools.plausible import find
from polemap.tools.progress import progress
from polemap.vehicle.io import load_car
from polemap.vehicle.parameters import Car

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]
SIGNALS, TRUTH = "signals.csv", "lane_truth.csv"
PICTURES = "folder of lane pictures"


def command(
    drive: Annotated[Path, typer.Argument(help="Drive with pictures of a calibrated camera.")],
    out: Annotated[Path, typer.Option("--out", help="Signal log that is written (.csv).")],
    signals: Annotated[
        Path | None,
        typer.Option("--signals", help="Signal log to join; by default the drive's signals.csv."),
    ] = None,
    vehicle: Annotated[
        str, typer.Option("--vehicle", help="Car, for its preview point: a name or a YAML file.")
    ] = "passat",
    preview: Annotated[
        float | None,
        typer.Option("--preview", min=1.0, max=60.0, help="Metres ahead of the rear axle instead."),
    ] = None,
    frames: Annotated[
        str, typer.Option("--frames", help="A:B, rows of the drive from A up to but without B.")
    ] = ":",
    pictures: Annotated[
        Path | None, typer.Option("--pictures", help="Folder for overlay pictures.")
    ] = None,
    every: Annotated[
        int, typer.Option("--every", min=1, help="With --pictures: each so manyth frame.")
    ] = 1,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the random samples.")] = 0,
    topics: TopicsOption = None,
    force: ForceOption = False,
) -> None:
    """Find the lane in the pictures of a drive.

    Examples:
        polemap lanes drive --out lanes.csv
        polemap lanes drive --out log.csv --signals can.csv --vehicle passat
        polemap lanes kitti/2011_09_26_drive_0039_sync --out lanes.csv --pictures seen --every 10

    Each picture gives the car's heading and lateral offset in the lane and the lane's curvature at
    the preview point, with deviations and correlations, when it was taken and when it arrived.
    With a signal log beside it the pictures' rows go into that, and polemap estimate takes the
    result.
    """
    check_file(out, (drive, signals, topics), (".csv",))
    if pictures is not None:
        check_folder(pictures, PICTURES, (drive, signals))
    car = load_car(vehicle)
    opened = open_drive(drive, topics=topics)
    preview_m = preview_of(car) if preview is None else preview
    if not 1.0 <= preview_m <= 60.0:
        raise ConfigError(f"--vehicle {vehicle}: its preview point is {preview_m:.1f} m ahead of "
                          "the rear axle, 1 to 60 m can be looked at; give --preview")  # fmt: skip
    make_finder(opened, preview_m, np.random.default_rng(seed))  # tells what the drive lacks
    rows = frame_range(frames, len(opened.frame_stamps_s))
    require_plausible(opened.name, find(opened), force=force)
    beside = _signals_of(opened, signals)
    if pictures is None:
        track = _follow(opened, preview_m, rows, seed)
    else:
        with atomic_folder(pictures, PICTURES) as folder:
            track = _follow(opened, preview_m, rows, seed, folder, every)
    if len(track.stamp_s) < 2:
        raise ConfigError(f"--frames {frames}: a signal log needs two pictures at least")
    log = lane_log(track) if beside is None else with_lanes(beside, track)
    write_signal_log(log, out)
    lines = [*summary(track), *score(opened, track, preview_m)]
    lines.append(f"wrote {out}" + (f" and {pictures}" if pictures is not None else ""))
    if beside is None:
        lines.append(f"next: polemap lanes {drive} --signals LOG.csv --out LOG_LANES.csv")
    else:
        lines.append(f"next: polemap estimate {out} --estimator clones --vehicle {vehicle} "
                     "--out estimate.csv")  # fmt: skip
    typer.echo("\n".join(lines))


def drive_signals(path: Path, car: Car) -> SignalLog:
    """The signal log of a drive folder, with the lane of its pictures in it where it has any.

    Raises:
        InputError: no drive, or one without signals.csv.
    """
    drive = open_drive(path)
    signals = _signals_of(drive, None)
    if signals is None:
        raise InputError(
            f"drive {drive.name}: it has no {SIGNALS} with steering and yaw rate; give the log "
            f"itself, or join one with polemap lanes {path} --signals LOG.csv --out LOG_LANES.csv"
        )
    if drive.rig is None or not drive.has_frames:
        return signals
    track = _follow(drive, preview_of(car), range(len(drive.frame_stamps_s)), 0)
    sys.stderr.write("note: " + "; ".join(summary(track)) + "\n")
    if not track.found.any():
        return signals
    return with_lanes(signals, track)


def _signals_of(drive: Drive, given: Path | None) -> SignalLog | None:
    path = drive.path / SIGNALS if given is None else given
    if given is None and not path.is_file():
        return None
    log, ignored = read_signal_log(path)
    if ignored:
        sys.stderr.write(f"note: ignored columns {', '.join(ignored)}\n")
    return log


def _follow(
    drive: Drive, preview_m: float, rows: range, seed: int, folder: Path | None = None,
    every: int = 1,
) -> LaneTrack:  # fmt: skip
    finder = make_finder(drive, preview_m, np.random.default_rng(seed))
    pictures = None if folder is None else LanePictures(folder, finder, every)
    with progress(len(rows), "finding the lane") as advance:

        def counted() -> object:
            for row in rows:
                yield row
                advance(1)

        return follow_lane(drive, finder, counted(), pictures)  # type: ignore[arg-type]


def write_signal_log(log: SignalLog, out: Path) -> None:
    """A signal log as CSV; what was not sampled is an empty cell."""
    import pandas as pd  # slow to import

    with atomic_file(out) as part:
        table = pd.DataFrame({"stamp_s": log.stamp_s, **log.columns})
        table.to_csv(part, index=False, float_format="%.9g")


def summary(track: LaneTrack) -> list[str]:
    """How often there was a lane, how sure it is and what it took."""
    count, found = len(track.stamp_s), int(track.found.sum())
    lines = [
        f"{count} pictures: a lane in {found} ({100.0 * found / max(count, 1):.0f} %), both "
        f"markings in {int((track.sides == 2).sum())}, "
        f"{1e3 * float(np.median(track.work_s)):.1f} ms a picture (median)"
    ]
    if found:
        sd = np.sqrt(np.diagonal(track.covariance[track.found], axis1=1, axis2=2))
        heading, offset, curvature = np.median(sd, axis=0).tolist()
        lines.append(
            f"stated deviation (median): heading {np.degrees(heading):.2f} deg, offset "
            f"{offset:.3f} m, curvature {curvature:.5f} 1/m"
        )
    return lines


def score(drive: Drive, track: LaneTrack, preview_m: float) -> list[str]:
    """Errors against the truth of a simulated drive; nothing for others."""
    path = drive.path / TRUTH
    if not path.is_file():
        return []
    import pandas as pd

    with named(path, InputError, "table"):
        check_csv(path)
        truth = pd.read_csv(path)
    wanted = {"stamp_s", "preview_m", *NAMES}
    if not wanted <= set(truth.columns) or not len(truth):
        raise InputError(f"{path}: the columns {', '.join(sorted(wanted))} are needed")
    if abs(float(truth["preview_m"].iloc[0]) - preview_m) > 1e-3:
        return [
            f"not scored: the truth is that at {truth['preview_m'].iloc[0]:g} m, give --preview"
        ]
    errors, nees = lane_errors(truth, track)
    if not len(errors):
        return ["not scored: no picture with a lane has a truth"]
    rms = np.sqrt(np.mean(errors**2, axis=0))
    return [
        f"against the truth ({len(errors)} pictures): heading {np.degrees(rms[0]):.3f} deg, offset "
        f"{rms[1]:.3f} m, curvature {rms[2]:.5f} 1/m (rms), NEES {np.mean(nees) / 3.0:.2f} of 1"
    ]


def lane_errors(truth: pd.DataFrame, track: LaneTrack) -> tuple[Floats, Floats]:
    """Errors `(n, 3)` and their squares over the stated covariance `(n,)`, where both are known."""
    stamps = truth["stamp_s"].to_numpy()
    at = np.clip(np.searchsorted(stamps, track.stamp_s - 1e-4), 0, len(stamps) - 1)
    true = truth[list(NAMES)].to_numpy(dtype=np.float64)[at]
    good = track.found & (np.abs(stamps[at] - track.stamp_s) < 1e-3) & np.isfinite(true).all(axis=1)
    errors = track.value[good] - true[good]
    nees = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(track.covariance[good]), errors)
    return errors, nees
