"""By what a file shows that polemap wrote it: a picture or a layer of somebody else is kept."""

from __future__ import annotations

import os
import re
import struct
import zlib
from pathlib import Path

from polemap.drivelog.errors import OutputError

CREATOR = "polemap"
"""Metadata `Creator` of all pictures that are written to a place of the user's choice."""

_HEAD_BYTES, _TAIL_BYTES = 65_536, 4_194_304
# eight bytes of signature, and the chunk IHDR
_PNG_HEADER_BYTES = 33
# by the ending: what only polemap writes; a format that has no place for it is not listed
_SIGNATURES = {
    ".geojson": rb'"polemap"\s*:\s*\{',
    ".gpx": rb"creator=[\"']polemap[\"']",
    ".osm": rb"generator=[\"']polemap[\"']",
    ".parquet": rb"polemap.*PAR1$",
    ".pdf": rb"/Creator \(polemap\)",
    ".png": rb"tEXtCreator\0polemap",
    ".svg": rb"<dc:creator>.{0,200}<dc:title>polemap</dc:title>",
}


def check_signature(path: Path) -> None:
    """Refuse to replace a file whose kind shows who wrote it, if that was not polemap.

    Raises:
        OutputError: it holds no signature of ours, or cannot be read.
    """
    signature = _SIGNATURES.get(path.suffix.lower())
    if signature is None or not path.is_file():
        return
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
            file.seek(max(len(head), size - _TAIL_BYTES), os.SEEK_SET)
            content = head + file.read(_TAIL_BYTES)
    except OSError as error:
        raise OutputError(
            f"{path}: is there already and cannot be read ({error.strerror}); name another file"
        ) from error
    if size and re.search(signature, content, re.DOTALL) is None:
        raise OutputError(
            f"{path}: is there already and was not written by polemap, or by a version that did "
            "not mark its files yet; name another file, or delete it"
        )


def signed_png(data: bytes) -> bytes:
    """A PNG with the metadata that tell it from others', behind its header."""
    kind_and_text = b"tEXtCreator\0" + CREATOR.encode()
    chunk = struct.pack(">I", len(kind_and_text) - 4) + kind_and_text
    chunk += struct.pack(">I", zlib.crc32(kind_and_text))
    return data[:_PNG_HEADER_BYTES] + chunk + data[_PNG_HEADER_BYTES:]
