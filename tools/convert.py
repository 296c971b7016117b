"""`polemap convert`: drives, runs and logs of other programs from one form into another.

A conversion is chosen by what the input is and what is to come out; `CONVERSIONS` names the module
and function of each, which is imported when it is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import typer

from polemap.drivelog.drive import readers
from polemap.drivelog.errors import ConfigError, InputError
from polemap.tools.option_types import SeedOption

Source = Literal["drive", "run", "log"]

CONVERSIONS: dict[tuple[Source, str], str] = {
    ("drive", "folder"): "polemap.tools.convert_drive:to_folder",
}
"""What goes in and what comes out, to `module:function`, which takes a `Request`."""

FORM_OF_ENDING = {".mcap": "mcap", ".rrd": "rrd"}
"""What comes out by the ending of `--out`, where `--to` does not say; a folder otherwise."""

_RUN_FILES = ("config.yaml", "pf.tum")


@dataclass(frozen=True, slots=True)
class Request:
    """One call of `polemap convert`.

    Attributes:
        inputs: drives, runs or logs; at least one.
        out: the file or folder to write.
        seed: of what a reader derives.
    """

    inputs: tuple[Path, ...]
    out: Path
    seed: int = 0

    @property
    def input(self) -> Path:
        """The only input.

        Raises:
            ConfigError: there are several, and this conversion takes one.
        """
        if len(self.inputs) > 1:
            raise ConfigError(f"convert: {self.inputs[1]}: this conversion takes one input")
        return self.inputs[0]


def command(
    inputs: Annotated[
        list[Path], typer.Argument(metavar="INPUT...", help="A drive of any kind, or a run.")
    ],
    out: Annotated[Path, typer.Option("--out", help="File or folder to write.")],
    form: Annotated[
        str | None,
        typer.Option("--to", help="What to write; by the ending of --out where it is not said."),
    ] = None,
    seed: SeedOption = 0,
) -> None:
    """Convert a drive into another form.

    Examples:
        polemap convert sequences/03 --out drives/kitti_03

    What is written has the streams, calibration and notes of the input.
    """
    request = Request(tuple(inputs), out, seed)
    source = kind_of(request.inputs[0])
    target = form or FORM_OF_ENDING.get(out.suffix.lower(), "folder")
    place = CONVERSIONS.get((source, target))
    if place is None:
        known = ", ".join(form for kind, form in CONVERSIONS if kind == source)
        raise ConfigError(
            f"convert: {inputs[0]} is a {source} and cannot become '{target}'; --to takes "
            f"{known or 'nothing'} for a {source}"
        )
    module, _, function = place.partition(":")
    lines: Sequence[str] = getattr(import_module(module), function)(request)
    typer.echo("\n".join(lines))


def kind_of(path: Path) -> Source:
    """What an input is, without reading more than names and first lines.

    Raises:
        InputError: nothing that polemap knows.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if all((path / name).is_file() for name in _RUN_FILES):
        return "run"
    if any(reader.can_read(path) for reader in readers()):
        return "drive"
    raise InputError(
        f"{path}: neither a drive nor a run; `polemap info --help` names the kinds of drive"
    )
