"""Only what polemap listed may be deleted, and only while it is as it was listed."""

from __future__ import annotations

from pathlib import Path

import pytest

from polemap.drivelog.results.marker import (
    MARKER,
    NOTHING,
    foreign_file,
    read_marker,
    remove_listed,
    write_marker,
)


@pytest.fixture
def made(tmp_path: Path) -> Path:
    folder = tmp_path / "made"
    (folder / "a" / "b").mkdir(parents=True)
    (folder / "empty").mkdir()
    (folder / "a" / "b" / "c.csv").write_text("1,2\n")
    (folder / "d.yaml").write_text("x: 1\n")
    write_marker(folder, "run")
    return folder


def test_what_was_written_is_listed_and_can_go(made: Path) -> None:
    listing = read_marker(made)
    assert listing.kind == "run"
    assert listing.files == {"a/b/c.csv": 4, "d.yaml": 5}
    assert listing.folders == {"a", "a/b", "empty"}
    assert foreign_file(made, listing) is None
    assert remove_listed(made)
    assert not made.exists()


@pytest.mark.parametrize("name", ["a/notes.txt", "notes.txt", "d.yaml", "a/new"])
def test_what_was_added_or_changed_is_found_and_stays(made: Path, name: str) -> None:
    if name.endswith("new"):
        (made / name).mkdir()
    else:
        (made / name).write_text("years of work")
    assert foreign_file(made, read_marker(made)) == name
    assert not remove_listed(made)
    assert (made / name).exists()
    assert not (made / "a" / "b" / "c.csv").exists()


def test_a_link_in_place_of_a_file_is_somebodys(made: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept.yaml"
    (made / "d.yaml").rename(kept)
    (made / "d.yaml").symlink_to(kept)
    assert foreign_file(made, read_marker(made)) == "d.yaml"
    assert not remove_listed(made)
    assert kept.read_text() == "x: 1\n"


@pytest.mark.parametrize(
    "text",
    [
        "made by polemap, which may replace this folder\n",
        "{}",
        "[]",
        "[" * 100_000,
        '{"polemap": 1, "kind": "run", "folders": [], "files": {"d.yaml": "5"}}',
        '{"polemap": 1, "kind": "run", "folders": 3, "files": {}}',
        '{"polemap": 7, "kind": "run", "folders": [], "files": {}}',
    ],
)
def test_a_marker_that_lists_nothing_licenses_nothing(made: Path, text: str) -> None:
    (made / MARKER).write_text(text)
    assert read_marker(made) is NOTHING
    assert foreign_file(made, read_marker(made)) == MARKER
    assert not remove_listed(made)
    assert (made / "d.yaml").exists()


def test_a_marker_reaches_nothing_outside_its_folder(made: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_text("12345")
    text = f'{{"../outside": 5, "{outside}": 5, "d.yaml": 5}}'
    (made / MARKER).write_text(
        f'{{"polemap": 1, "kind": "run", "folders": ["..", "a"], "files": {text}}}'
    )
    assert read_marker(made).files == {"d.yaml": 5}
    assert not remove_listed(made)
    assert outside.exists()
