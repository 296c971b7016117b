"""`polemap disparity`: one rectified pair to disparity maps in the KITTI convention."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file, check_files
from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.images import read_grey
from polemap.drivelog.results.signature import signed_png
from polemap.drivelog.samples import Image
from polemap.settings import load_settings
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import make_matcher
from polemap.tools.option_types import ConfigOption, SetOption

_SCALE = 256.0
_LARGEST = 256


def command(
    left: Annotated[Path, typer.Argument(help="Left image of a rectified pair.")],
    right: Annotated[Path, typer.Argument(help="Right image of the pair.")],
    out: Annotated[Path, typer.Option("--out", help="Disparity of the left view, PNG.")],
    right_out: Annotated[
        Path | None, typer.Option("--right-out", help="Disparity of the right view, PNG.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Colour picture of the left disparity, PNG.")
    ] = None,
    max_disparity: Annotated[
        int | None, typer.Option("--max-disparity", help="Largest disparity to search, 1 to 256.")
    ] = None,
    matcher: Annotated[
        str | None, typer.Option("--matcher", help="census_sgm or opencv_sgbm.")
    ] = None,
    config_file: ConfigOption = None,
    set_values: SetOption = None,
) -> None:
    """Match one rectified pair, grey or colour, 8 or 16 bit.

    Writes uint16 PNGs with disparity x 256; 0 means that there is none (the KITTI convention).

    Examples:
        polemap disparity left.png right.png --out disparity.png
        polemap disparity left.png right.png --out d.png --right-out r.png --picture colour.png
        polemap disparity left.png right.png --out d.png --max-disparity 192 --matcher opencv_sgbm
    """
    for target in (out, right_out, picture):
        if target is not None and target.suffix.lower() != ".png":
            raise InputError(f"{target}: disparity is written as PNG, name the file NAME.png")
    check_files([out, right_out, picture], (left, right, config_file))
    images = read_grey(left), read_grey(right)
    overrides = list(set_values or [])
    if matcher is not None:
        overrides.append(f"stereo.matcher={matcher}")
    settings = load_settings(config_file, overrides).stereo
    settings = fitting_settings(settings, images, max_disparity)
    pair = make_matcher(settings).match(*images)
    outputs: list[tuple[Path, NDArray[np.uint8] | NDArray[np.uint16]]] = [(out, encode(pair.left))]
    if right_out is not None:
        outputs.append((right_out, encode(pair.right)))
    if picture is not None:
        largest = settings.min_disparity_px + settings.disparities
        outputs.append((picture, colour_picture(pair.left, largest)))
    for path, image in outputs:
        _write_png(path, image)
    found = np.isfinite(pair.left).mean()
    typer.echo(f"{out}: {100 * found:.1f} % of the pixels have a disparity")


def fitting_settings(
    settings: StereoConfig, images: tuple[Image, Image], max_disparity: int | None
) -> StereoConfig:
    """Settings with the search range asked for, and with as many bits as the images use.

    Raises:
        ConfigError: a range that the matchers cannot search.
    """
    changes: dict[str, int] = {}
    if max_disparity is not None:
        count = -(-(max_disparity + 1 - settings.min_disparity_px) // 16) * 16
        if not 1 <= max_disparity <= _LARGEST or count < 16:
            raise ConfigError(
                f"--max-disparity {max_disparity}: expected {settings.min_disparity_px + 1} "
                f"to {_LARGEST}"
            )
        changes["disparities"] = min(count, _LARGEST)
    top = max(int(image.max()) for image in images)
    changes["uint16_bits"] = max(settings.uint16_bits, top.bit_length())
    return settings.model_copy(update=changes)


def encode(disparity: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Disparity x 256 as uint16, 0 where there is none; what rounds to 0 is written as 1.

    Raises:
        ConfigError: disparities beyond what 16 bits can hold.
    """
    known = np.isfinite(disparity)
    scaled = np.rint(np.where(known, disparity, 0) * _SCALE)
    if scaled.max() > np.iinfo(np.uint16).max:
        raise ConfigError(
            f"a disparity of {scaled.max() / _SCALE:.1f} px does not fit a 16-bit PNG "
            "(255.99 px): lower stereo.min_disparity_px or stereo.disparities"
        )
    return np.where(known, np.maximum(scaled, 1), 0).astype(np.uint16)


def colour_picture(disparity: NDArray[np.float32], largest_px: float) -> NDArray[np.uint8]:
    """`(h, w, 3)` BGR: near is red, far is blue, black where there is none.

    Colours follow the square root of disparity, which spreads the far range.
    """
    known = np.isfinite(disparity)
    share = np.sqrt(np.clip(np.where(known, disparity, 0) / largest_px, 0, 1))
    colours = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_TURBO)
    colours[~known] = 0
    return np.asarray(colours, dtype=np.uint8)


def _write_png(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    with atomic_file(path) as part:
        good, data = cv2.imencode(".png", image)
        if not good:
            raise InputError(f"{path}: the PNG cannot be encoded")
        part.write_bytes(signed_png(data.tobytes()))
