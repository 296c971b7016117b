"""A run folder to a recording, or into the viewer: opens, looks, writes, and says what it did."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from os import cpu_count
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from polemap.drivelog.atomic import check_files
from polemap.drivelog.errors import ConfigError
from polemap.extras import check_installed
from polemap.settings import Settings
from polemap.tools.drive_detection import Source
from polemap.tools.progress import progress
from polemap.tools.recording.opened import OpenedRun, open_run
from polemap.tools.recording.scene import Scene, scene_of

FORMS = (".rrd", ".mcap")


def record_run(
    run_folder: Path,
    out: Path | None,
    drive: Path | None,
    map_file: Path | None,
    number: int,
    cache: Path | None,
    inputs: tuple[Path | None, ...],
    workers: int | None = None,
) -> list[str]:
    """Write a run as a recording, or open the viewer where `out` is None; what to say of it.

    Poles are looked for by `workers` processes, by default one a core.

    Raises:
        ConfigError: an ending that is no recording's.
        InputError: the run, its map or its drive cannot be read.
        MissingExtraError: what writes or shows it is not installed.
    """
    _check(out, inputs)
    opened = open_run(run_folder, number, map_file, drive)
    notes = [f"note: {note}" for note in opened.notes]
    if opened.drive is None or drive is None:
        scene = scene_of(opened, None, None, 1, None, lambda _: None)
        notes.append("note: without pictures and seen poles; --drive DRIVE adds them")
    else:
        settings, more = _settings(opened)
        frames = len(opened.drive.frame_stamps_s) or len(opened.drive.scans)
        with progress(frames, "poles in the pictures") as advance:
            topics = None if opened.topics is None else str(opened.topics)
            source = Source(str(drive), opened.lap, topics)
            scene = scene_of(opened, settings, source, workers or cpu_count() or 1, cache, advance)
        notes += more
    with progress(scene.picture_count, "writing pictures") as advance:
        return notes + _put(scene, out, advance)


def _settings(opened: OpenedRun) -> tuple[Settings, list[str]]:
    """The settings of the run, so that the same poles are found again."""
    stated: Mapping[str, Any] | None = opened.config.get("settings")
    try:
        return Settings.model_validate(stated or {}), []
    except ValidationError:
        return Settings(), [
            "note: the run's settings are of another polemap: poles are detected with the defaults"
        ]


def _check(out: Path | None, inputs: tuple[Path | None, ...]) -> None:
    """Refuse before the work what would be refused after it."""
    if out is None:
        check_installed("rerun")
        return
    ending = out.suffix.lower()
    if ending not in FORMS:
        raise ConfigError(f"{out}: a recording ends in .rrd (rerun) or .mcap (Foxglove)")
    check_installed("rerun" if ending == ".rrd" else "mcap")
    if ending == ".mcap":
        from polemap.tools.recording.foxglove import layout_path

        check_files([out, layout_path(out)], inputs)
        return
    check_files([out], inputs)


def _put(scene: Scene, out: Path | None, advance: Callable[[int], None]) -> list[str]:
    if out is None or out.suffix.lower() == ".rrd":
        from polemap.tools.recording import rerun

        if out is None:
            rerun.show_in_viewer(scene, advance)
            return [f"{scene.name} is shown in the rerun viewer"]
        rerun.write_rerun(scene, out, advance)
        return [f"wrote {out}; open it with: rerun {out}"]
    from polemap.tools.recording.foxglove import write_foxglove

    counts, layout = write_foxglove(scene, out, advance)
    return [
        *(f"{count:8}  {topic}" for topic, count in sorted(counts.items())),
        f"wrote {out}; open it with Foxglove (https://foxglove.dev) and import the layout {layout}",
    ]
