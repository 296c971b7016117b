"""Numbered pictures of both KITTI layouts: grey or colour, from any number on, with gaps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from polemap.drivelog.errors import InputError

PICTURE_ENDINGS = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True, slots=True)
class NumberedPairs:
    """Pairs whose left and right file carry the same number, sorted by it.

    Attributes:
        cameras: names of the cameras that they are of.
        one_sided: how many pictures have no partner, and were left out.
    """

    cameras: tuple[str, str]
    numbers: tuple[int, ...]
    paths: tuple[tuple[Path, Path], ...]
    one_sided: int

    def take(self, positions: list[int]) -> NumberedPairs:
        """The pairs at these positions."""
        return NumberedPairs(
            self.cameras,
            tuple(self.numbers[k] for k in positions),
            tuple(self.paths[k] for k in positions),
            self.one_sided,
        )


def find_pairs(
    path: Path, cameras: tuple[tuple[str, str], ...], inner: str = ""
) -> NumberedPairs | None:
    """The pairs of the first of `cameras` that has any; files are `image_CAMERA/inner/NUMBER.png`.

    Raises:
        InputError: pictures of one side only.
    """
    lonely = None
    for pair in cameras:
        folders = [path / f"image_{camera}" / inner for camera in pair]
        left, right = (_numbered(folder) for folder in folders)
        both = sorted(left.keys() & right.keys())
        if both:
            paths = tuple((left[number], right[number]) for number in both)
            return NumberedPairs(pair, tuple(both), paths, len(left.keys() ^ right.keys()))
        if left or right:
            lonely = lonely or (folders, len(left), len(right))
    if lonely:
        folders, lefts, rights = lonely
        raise InputError(
            f"{path}: {lefts} pictures in {folders[0].relative_to(path)} and {rights} in "
            f"{folders[1].relative_to(path)}, none with the same number: a stereo pair needs both"
        )
    return None


def _numbered(folder: Path) -> dict[int, Path]:
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return {
        int(file.stem): file
        for file in reversed(files)  # of two files with one number the first by name stays
        if file.suffix.lower() in PICTURE_ENDINGS and file.stem.isdecimal()
    }


def lines_of(numbers: tuple[int, ...], count: int) -> tuple[dict[int, int], bool]:
    """Which line of a list belongs to which number, and whether that goes by position.

    KITTI's line i belongs to picture i. A list with as many lines as there are pictures, whose
    numbers go beyond it, was cut out with them: its k-th line belongs to the k-th picture.
    """
    if numbers and numbers[-1] >= count == len(numbers):
        return {number: k for k, number in enumerate(numbers)}, True
    return {number: number for number in numbers if number < count}, False
