"""Errors of the API are as short as those of the terminal."""

from __future__ import annotations

from pathlib import Path

import pytest

import polemap
from polemap.drivelog.errors import InputError, Mistakes
from polemap.errors import LONGEST_MESSAGE, PolemapError
from polemap.extras import MissingExtraError
from polemap.stereo.errors import StereoError


@pytest.mark.parametrize("kind", [PolemapError, InputError, StereoError, MissingExtraError])
def test_a_message_is_one_line_of_at_most_300_letters(kind: type[PolemapError]) -> None:
    text = str(kind("start " + "x" * 5000 + "\n\x1b[2J" + " end"))
    assert len(text) < LONGEST_MESSAGE
    assert text.startswith("start ")
    assert text.endswith(" end")
    assert text.isprintable()
    assert str(kind("a short  one")) == "a short one"


def test_several_mistakes_keep_their_lines_whole() -> None:
    error = Mistakes("drive.yaml", [f"mistake {number}: " + "y" * 80 for number in range(20)])
    assert len(str(error)) < LONGEST_MESSAGE
    assert len(error.lines) == 21


def test_the_door_raises_short_messages(tmp_path: Path) -> None:
    long = tmp_path / ("d" * 200) / ("e" * 200)
    with pytest.raises(PolemapError) as caught:
        polemap.open_drive(long)
    assert len(str(caught.value)) < LONGEST_MESSAGE
