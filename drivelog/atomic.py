"""Results appear whole or not at all: written under a temporary name, then renamed."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp

from drivelog.errors import InputError


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

    A folder that stood there before is replaced as a whole.

    Raises:
        InputError: the place cannot be written to, or a file stands there.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file, a folder is to be written there")
    if path.is_symlink():
        path = path.resolve()
    folder = _temporary(path)
    try:
        part = folder / path.name
        part.mkdir()
        yield part
        if path.exists():
            os.replace(path, folder / "replaced")
        os.replace(part, path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
