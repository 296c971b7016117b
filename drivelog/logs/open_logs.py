"""The log files of one conversion, each opened once and found by name or kind."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.gpx import read_gpx
from polemap.drivelog.logs.log_files import CsvLog, LogFile, PointLog, open_csv
from polemap.drivelog.logs.mapping import LogMapping
from polemap.drivelog.logs.nmea import looks_like_nmea, read_nmea
from polemap.drivelog.logs.text import encoding_of, first_lines
from polemap.drivelog.problems import Gathered


def open_log(path: Path, mapping: LogMapping, day: str | None = None) -> LogFile:
    """A log of any kind, by what stands in it.

    Raises:
        InputError: it cannot be read, or only the user knows how.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    part = next(
        (p for name, p in mapping.layouts.items() if fnmatch(path.name, name)), mapping.layout
    )
    encoding = encoding_of(path, part.encoding)
    # what is no CSV may hold bytes that are damaged
    head = first_lines(path, "latin-1" if encoding.startswith("utf-8") else encoding, 50)
    if "<gpx" in "".join(head[:20]).lower():
        return read_gpx(path)
    if looks_like_nmea(head):
        return read_nmea(path, day)
    return open_csv(path, part)


class Logs:
    """The files of one call, each opened once."""

    def __init__(self, paths: Sequence[Path], mapping: LogMapping, day: str | None) -> None:
        gnss = mapping.streams.get("gnss")
        stated = day if gnss is None or gnss.date is None else gnss.date
        gathered = Gathered()
        opened = [gathered.attempt(open_log, path, mapping, stated) for path in paths]
        if gathered.errors:
            raise gathered.error("logs")
        self.files: list[LogFile] = [log for log in opened if log is not None]
        self.used: set[Path] = set()

    def named(self, place: str, pattern: str | None, *, points: bool) -> list[LogFile]:
        """The files that a stream or column comes from, in the order of the call.

        Args:
            place: of the mapping, for messages.
            pattern: name of a file, with `*` of its parts.
            points: whether NMEA and GPX files serve where no name is given.

        Raises:
            InputError: none, or several where one has to be named.
        """
        names = ", ".join(log.path.name for log in self.files)
        if pattern is not None:
            found = [log for log in self.files if fnmatch(log.path.name, pattern)]
            if not found:
                raise InputError(f"{place}: no log is called '{pattern}' (given: {names})")
        else:
            kinds = [PointLog, CsvLog] if points else [CsvLog, PointLog]
            for kind in kinds:
                found = [log for log in self.files if isinstance(log, kind)]
                if found:
                    break
            if len(found) > 1:
                raise InputError(
                    f"{place}: which log holds it? add `file: {found[0].path.name}` (given: "
                    f"{names}; `*` stands for any letters where a log has several parts)"
                )
        self.used |= {log.path for log in found}
        return found
