"""Results appear whole or not at all: written under a temporary name, then renamed."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp

from polemap.drivelog.errors import InputError

# stands in every folder written here, and says that it may be replaced
MARKER = ".polemap"


def _temporary(path: Path) -> Path:
    """A fresh folder beside `path`, so that the rename stays on one file system."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return Path(mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """A temporary path to write to; it becomes `path` when the block ends well, else it goes.

    Raises:
        InputError: the place cannot be written to.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder, a file is to be written there")
    folder = _temporary(path)
    try:
        part = folder / path.name
        yield part
        os.replace(part, path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """A temporary folder to fill; it becomes `path` when the block ends well, else it goes.

    A folder that this function made before is replaced as a whole; one that holds anything else
    is left alone.

    Raises:
        InputError: the place cannot be written to, or a file or somebody's folder stands there.
    """
    path = Path(path).absolute()
    if path.is_symlink():
        path = path.resolve()
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file, a folder is to be written there")
    if path.exists() and not (path / MARKER).exists() and any(path.iterdir()):
        raise InputError(
            f"{path}: holds files that polemap did not write and would replace; choose another "
            "folder, or empty this one"
        )
    folder = _temporary(path)
    try:
        part = folder / path.name
        part.mkdir()
        yield part
        (part / MARKER).write_text("made by polemap, which may replace this folder\n")
        if path.exists():
            os.replace(path, folder / "replaced")
        os.replace(part, path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
