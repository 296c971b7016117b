"""The size of a picture from its header, before anything is made of it.

Decoders allocate what the header claims: a file of a hundred bytes may claim 60000 x 60000 pixels.
"""

from __future__ import annotations

import struct

from polemap.parsing.errors import ParsingError

LARGEST_PIXELS = 2**25
LONGEST_SIDE = 20_000
_PNG = b"\x89PNG\r\n\x1a\n"
_KNOWN = "PNG, JPEG, BMP, TIFF, PGM or PPM"
_TIFF_INTEGERS = {3: "H", 4: "I"}


def check_size(data: bytes) -> tuple[int, int]:
    """Width and height in pixels that the header of a picture states.

    Raises:
        ParsingError: no header of a known kind, or more pixels than a camera has.
    """
    try:
        width, height = _size(data)
    except (struct.error, IndexError, ValueError) as error:
        raise ParsingError("its header is cut off or damaged; restore the file") from error
    if not (0 < width <= LONGEST_SIDE and 0 < height <= LONGEST_SIDE):
        raise ParsingError(f"{width}x{height} pixels, a side may have 1 to {LONGEST_SIDE}")
    if width * height > LARGEST_PIXELS:
        raise ParsingError(f"{width}x{height} pixels, {LARGEST_PIXELS} are the most")
    return width, height


def stated_bits(data: bytes) -> int | None:
    """How many bits a PGM of sixteen-bit pixels says it fills; None where nothing is said.

    The largest value that stands in its header is nine to fifteen bits; 65535 is what writers put
    there that do not know.
    """
    if data[:2] not in (b"P2", b"P5"):
        return None
    words = _words(data)
    if len(words) < 3 or len(words[2]) > 5 or not words[2].isdigit():
        return None
    bits = int(words[2]).bit_length()
    return bits if 8 < bits < 16 else None


def _size(data: bytes) -> tuple[int, int]:
    if data.startswith(_PNG):
        if data[12:16] != b"IHDR":
            raise ParsingError("its first chunk is no IHDR; restore the file")
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    if data.startswith(b"\xff\xd8"):
        return _jpeg(data)
    if data.startswith(b"BM"):
        width, height = struct.unpack_from("<ii", data, 18)
        return width, abs(height)
    if data[:4] in (b"II*\0", b"MM\0*"):
        return _tiff(data)
    if data[:2] in (b"P2", b"P3", b"P5", b"P6"):
        return _netpbm(data)
    raise ParsingError(f"not an image that is read here ({_KNOWN})")


def _jpeg(data: bytes) -> tuple[int, int]:
    """The first start-of-frame segment."""
    at = 2
    while data[at] == 0xFF:
        kind = data[at + 1]
        if kind == 0xFF:  # padding
            at += 1
            continue
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        at += 2 + max(2, struct.unpack_from(">H", data, at + 2)[0])
    raise ValueError("no frame")


def _tiff(data: bytes) -> tuple[int, int]:
    """Tags 256 and 257 of the first directory."""
    order = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, at)
    found: dict[int, int] = {}
    for entry in range(count):
        tag, kind = struct.unpack_from(order + "HH", data, at + 2 + 12 * entry)
        if tag in (256, 257) and kind in _TIFF_INTEGERS:
            (found[tag],) = struct.unpack_from(
                order + _TIFF_INTEGERS[kind], data, at + 2 + 12 * entry + 8
            )
    if len(found) < 2:
        raise ValueError("no size")
    return found[256], found[257]


def _netpbm(data: bytes) -> tuple[int, int]:
    """The two numbers after the mark; comments run from # to the end of their line."""
    words = _words(data)
    if max(map(len, words[:2])) > 9:
        raise ValueError("too many digits")
    return int(words[0]), int(words[1])


def _words(data: bytes) -> list[bytes]:
    lines = (line.partition(b"#")[0] for line in data[2:4096].splitlines())
    return b" ".join(lines).split()
