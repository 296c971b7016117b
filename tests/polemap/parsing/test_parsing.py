"""Documents with limits: what is sound is read as it is, all else is one short error."""

from __future__ import annotations

import gzip
import io
import json
import os
import struct
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from polemap.drivelog.errors import ConfigError, InputError
from polemap.parsing import csv_text, yaml_text
from polemap.parsing.arrays import read_arrays
from polemap.parsing.csv_text import check_csv, read_rows
from polemap.parsing.errors import ParsingError, named
from polemap.parsing.json_text import parse_json, plain_values
from polemap.parsing.pictures import check_size
from polemap.parsing.text import read_bytes, read_text
from polemap.parsing.yaml_text import parse_yaml, read_yaml

SHARED = [1, 2.5]
SOUND: Any = {"a": SHARED, "b": SHARED, "c": {"d": None, "e": True, "f": "x: y"}, "g": -3}
BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join(['*' + before] * 10)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


def test_yaml_that_the_library_writes_is_read_with_its_aliases() -> None:
    text = yaml.safe_dump(SOUND)
    assert "*id001" in text
    assert parse_yaml(text) == SOUND
    assert parse_yaml("") is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB, "line 5: more than 100000 values"),
        ("a: &a [*a]", "line 1: the alias \\*a names nothing, or itself"),
        ("a: *b", "line 1: the alias \\*b names nothing"),
        ("[" * 33 + "]" * 33, "line 1: nested deeper than 32 levels"),
        ("[" * 100_000, "nested deeper than 32 levels"),
        ("a:\n  b:\n c: 1", "not YAML \\(line 3"),
        ("a:\n- " + "9" * 5000, "line 2: a number of 5000 digits, 40 are the most"),
        ("a: " + "9" * 41, "a number of 41 digits"),
        ("a: 0x" + "f" * 40, "a number of more than 40 digits"),
        ("a: 1\nb: 2024-13-45", "line 2: 2024-13-45: month must be in 1..12"),
        ("a: !!int x", "line 1: x: invalid literal"),
        ("a: !!binary x", "not YAML"),
        ("a: !!python/object:os.system {}", "not YAML"),
        ("? [1, 2]\n: 3", "not YAML"),
        ("a: \x07", "not YAML"),
        ("a: b\0c", "not YAML"),
        ("--- 1\n--- 2", "not YAML"),
        ("x: [" + "1, " * 100_001 + "1]", "more than 100000 values"),
    ],
)
@pytest.mark.parametrize("loader", [yaml_text._loader(yaml.SafeLoader), yaml_text._Loader])
def test_dangerous_yaml_is_refused(
    text: str, message: str, loader: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(yaml_text, "_Loader", loader)
    with pytest.raises(ParsingError, match=message) as caught:
        parse_yaml(text)
    assert len(str(caught.value)) < 200


def test_json_is_bounded_in_depth_and_digits() -> None:
    assert parse_json(json.dumps(SOUND)) == SOUND
    assert parse_json('"\\ud83d\\ude00"') == "😀"
    for text, message in (
        ("[" * 65 + "]" * 65, "nested deeper than 64 levels"),
        ('{"a":' * 5000 + "1" + "}" * 5000, "nested deeper than 64 levels"),
        ("[" * 200_000, "nested deeper|not JSON"),
        ("9" * 5000, "not JSON \\(a number of 5000 digits"),
        ("0." + "9" * 5000, "not JSON \\(a number of 5002 digits"),
        ('["\\ud83d"]', "half a character"),
        ("{", "not JSON"),
    ):
        with pytest.raises(ParsingError, match=message) as caught:
            parse_json(text)
        assert len(str(caught.value)) < 200


def test_files_are_regular_utf_8_and_not_too_large(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1")
    assert read_text(path, 100) == "a: 1"
    assert read_yaml(path) == {"a": 1}
    with pytest.raises(ParsingError, match="7 bytes are more than the 6"):
        read_bytes(path, 6)
    path.write_bytes(b"a: \xff")
    with pytest.raises(ParsingError, match="is not UTF-8 text \\(byte 3\\)"):
        read_text(path, 100)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ParsingError, match="no regular file"):
        read_bytes(tmp_path / "pipe", 100)
    with pytest.raises(ParsingError, match="no regular file"):
        check_csv(tmp_path / "pipe")


def test_tables_are_bounded_in_columns_cells_and_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.csv"
    path.write_text('a,b\n1,"2\n3"\n')
    assert read_rows(path) == [["a", "b"], ["1", "2\n3"]]
    for content, message in (
        (b"a," * 200_000, "200001 columns, a table may have 1000"),
        (b"a\n" + b"1" * 10_001, "line 2: a cell of more than 10000 bytes"),
        (b"a\n" + b"1," * 500_001, "line 2: longer than 1000000 bytes"),
        (b"a\n1\0\n", "not a UTF-8 CSV file \\(line 2 holds a NUL byte"),
        (b"a\n\xff\n", "not a UTF-8 CSV file"),
    ):
        path.write_bytes(content)
        with pytest.raises(ParsingError, match=message):
            read_rows(path)
    packed = tmp_path / "a.csv.gz"
    packed.write_bytes(gzip.compress(b"a,b\n1,2\n"))
    check_csv(packed)
    packed.write_bytes(gzip.compress(b"a\n" + b"1\n" * 100)[:-9])
    with pytest.raises(ParsingError, match="a damaged archive"):
        check_csv(packed)
    monkeypatch.setattr(csv_text, "SMALL_BYTES", 0)
    packed.write_bytes(gzip.compress(b"1\n" * 1_000_000))
    with pytest.raises(ParsingError, match=r"line \d+: more than \d+ bytes when unpacked"):
        check_csv(packed)
    monkeypatch.setattr(csv_text, "LARGEST_BYTES", 3)
    with pytest.raises(ParsingError, match="bytes are more than the 3"):
        check_csv(path)


def archive(path: Path, members: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return path


def npy(array: Any, **options: Any) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array), **options)
    return stream.getvalue()


def header(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def test_arrays_come_back_as_they_were(tmp_path: Path) -> None:
    kept = {"a": np.arange(6.0).reshape(2, 3), "b": np.array("text"), "c": np.empty((0, 2)),
            "d": np.asfortranarray(np.arange(6).reshape(2, 3)), "e": np.array([True])}  # fmt: skip
    path = tmp_path / "a.npz"
    with path.open("wb") as stream:
        np.savez_compressed(stream, **kept)
    found = read_arrays(path)
    assert list(found) == list(kept)
    for name, values in kept.items():
        assert found[name].dtype == values.dtype
        np.testing.assert_array_equal(found[name], values)


def test_arrays_that_lie_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    sound = npy([1.0, 2.0])
    for member, message in (
        (npy([{"a": 1}], allow_pickle=True), "holds object, not numbers"),
        (sound[:-3], "13 bytes are not \\(2,\\) of float64"),
        (
            header("{'descr': '<f8', 'fortran_order': False, 'shape': (9999999999999,), }"),
            "0 bytes",
        ),
        (header("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }"), "0 bytes are not"),
        (header("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (), }"), "not numbers"),
        (header("__import__('os').system('true')"), "damaged"),
        (b"\x93NUMPY\x03\x00" + sound[8:], "an array of version"),
        (b"no array", "damaged"),
    ):
        with pytest.raises(ParsingError, match=message):
            read_arrays(archive(path, {"a.npy": member}))
    with pytest.raises(ParsingError, match="its arrays would take 4000"):
        read_arrays(archive(path, {"a.npy": npy(np.zeros(50_000_000))}))
    with pytest.raises(ParsingError, match="101 arrays, 100 are the most"):
        read_arrays(archive(path, {f"{number}.npy": sound for number in range(101)}))
    whole = archive(path, {"a.npy": npy(np.random.default_rng(0).normal(size=100))}).read_bytes()
    for damaged in (whole[:-30], whole[:50] + b"\xff" * 40 + whole[90:], b"", b"PK\x05\x06"):
        path.write_bytes(damaged)
        with pytest.raises(ParsingError, match="damaged"):
            read_arrays(path)


@pytest.mark.parametrize("ending", [".png", ".jpg", ".bmp", ".tiff", ".pgm"])
def test_sizes_are_read_from_the_header_alone(ending: str) -> None:
    picture = np.zeros((7, 11), dtype=np.uint8)
    data = cv2.imencode(ending, picture)[1].tobytes()
    assert check_size(data) == (11, 7)
    for cut in range(0, min(len(data), 60), 3):
        try:
            found = check_size(data[:cut])
        except ParsingError:
            continue
        assert found == (11, 7)


def test_sizes_that_no_camera_has_are_refused() -> None:
    def png(width: int, height: int) -> bytes:
        return b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(">II", width, height)

    assert check_size(png(8000, 4000)) == (8000, 4000)
    for data, message in (
        (png(60_000, 60_000), "60000x60000 pixels, a side may have 1 to 20000"),
        (png(0, 5), "0x5 pixels"),
        (png(19_000, 19_000), "33554432 are the most"),
        (b"P5 99999999999999999999 1", "header is cut off or damaged"),
        (b"P5 # a comment\n30000 2 255\n", "30000x2"),
        (b"GIF89a\x01\0\x01\0", "not an image that is read here"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIDAT\0\0\0\0\0", "first chunk is no IHDR"),
        (b"II*\0\x08\0\0\0\0\0", "header is cut off or damaged"),
    ):
        with pytest.raises(ParsingError, match=message):
            check_size(data)


@pytest.mark.parametrize(
    ("raised", "message"),
    [
        (ParsingError("not YAML"), "^a.yaml: not YAML$"),
        (FileNotFoundError(2, "No such file", "b"), "^a.yaml: cannot be read \\(No such file\\)$"),
        (MemoryError(), "^a.yaml: this map asks for more memory than there is"),
        (KeyError("x"), "^a.yaml: damaged, or no such map \\('x'\\); restore it$"),
        (OverflowError("w" * 1000), "^a.yaml: damaged, or no such map \\(w{117}\\.\\.\\.\\)"),
        (ConfigError("as it is"), "^as it is$"),
    ],
)
def test_whatever_a_reader_raises_is_one_line(raised: Exception, message: str) -> None:
    kind = ConfigError if isinstance(raised, ConfigError) else InputError
    with pytest.raises(kind, match=message), named("a.yaml", InputError, "map"):
        raise raised


@pytest.mark.parametrize("text", ["a: 1\nb: 2\na: 3\n", "x: {k: 1, 'k': 2}\n", "- {a: 1, a: 1}\n"])
def test_a_key_that_stands_twice_is_no_yaml(text: str) -> None:
    with pytest.raises(ParsingError, match="stands twice"):
        parse_yaml(text)


def test_a_merged_key_may_be_overridden() -> None:
    text = "base: &b {a: 1, c: 2}\nmore: {<<: *b, a: 3}\n"
    assert parse_yaml(text)["more"] == {"a": 3, "c": 2}


def test_values_for_json_are_plain_and_finite() -> None:
    tree = {1: np.float32(0.5), "a": (np.int64(3), np.nan, [np.inf, np.bool_(True)]), "b": None}
    assert plain_values(tree) == {"1": 0.5, "a": [3, None, [None, True]], "b": None}
