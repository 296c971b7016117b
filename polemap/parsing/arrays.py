"""Numpy archives (.npz) that were kept earlier: never unpickled, and no larger than they say."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.parsing.errors import ParsingError, short
from polemap.parsing.text import MEGABYTE, read_bytes

LARGEST_BYTES = 2000 * MEGABYTE
# what compresses to less than a hundredth is no measurement
SMALL_BYTES = 256 * MEGABYTE
LARGEST_RATIO = 100
MOST_ARRAYS = 100
_KINDS = "biufU"


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an archive: numbers and texts.

    Raises:
        ParsingError: damaged, an array of objects, or larger than the file can mean.
        OSError: it cannot be read.
    """
    data = read_bytes(path, LARGEST_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if len(members) > MOST_ARRAYS:
                raise ParsingError(f"{len(members)} arrays, {MOST_ARRAYS} are the most")
            size = sum(member.file_size for member in members)
            if size > SMALL_BYTES + LARGEST_RATIO * len(data):
                raise ParsingError(f"its arrays would take {size} bytes")
            return {
                member.filename.removesuffix(".npy"): _array(archive, member) for member in members
            }
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise ParsingError(f"no archive of arrays, or damaged ({short(error)})") from error
    except (OSError, ValueError, RuntimeError, LookupError, TypeError, SyntaxError) as error:
        raise ParsingError(f"an array in it is damaged ({short(error)})") from error


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }.get(version)
        if read_header is None:
            raise ParsingError(f"an array of version {version}")
        shape, fortran, dtype = read_header(stream)
        if dtype.hasobject or dtype.kind not in _KINDS:
            raise ParsingError(f"{member.filename} holds {dtype}, not numbers or texts")
        data = stream.read()
        if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(data):
            raise ParsingError(f"{member.filename}: {len(data)} bytes are not {shape} of {dtype}")
        array = np.frombuffer(data, dtype=dtype)
        return array.reshape(shape, order="F" if fortran else "C")
