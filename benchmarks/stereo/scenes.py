"""Rendered street pairs with known disparity: textured wall and ground, poles of 2 to 20 px.

Independent of the simulator: each layer is a texture in left-image coordinates, and the right view
is the same layers shifted by their disparity, with the edges of poles at fractions of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.stereo.matching import Image

Floats = NDArray[np.float64]

CLEAR_PX = 6


@dataclass(frozen=True, slots=True)
class View:
    """One rendered view: truth of the visible surface, and which pole it is (-1 = none)."""

    disparity_px: Floats
    pole: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Scene:
    """A pair with its truth; `pole_width_px` and `pole_disparity_px` by pole number."""

    left: Image
    right: Image
    views: tuple[View, View]
    pole_width_px: Floats
    pole_disparity_px: Floats


@dataclass(frozen=True, slots=True)
class _Pole:
    start: float
    width: float
    disparity: float
    top: int
    foot: int
    texture: Floats


def _texture(rng: np.random.Generator, height: int, width: int, contrast: float) -> Floats:
    """Grey values with structure on several scales, as plaster, asphalt and leaves have."""
    total = np.zeros((height, width))
    for scale, weight in ((1, 0.5), (3, 0.8), (8, 1.0), (24, 1.2)):
        coarse = rng.standard_normal((height // scale + 3, width // scale + 3))
        total += weight * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(110 + contrast * total / total.std())


def _sample(texture: Floats, row: int, columns: Floats) -> Floats:
    grid = np.arange(texture.shape[1], dtype=np.float64)
    return np.asarray(np.interp(columns + 40, grid, texture[row]))


def _render(
    shape: tuple[int, int],
    wall: Floats,
    ground: Floats,
    wall_disparity: float,
    horizon: int,
    slope: float,
    poles: list[_Pole],
    right: bool,
) -> tuple[Floats, View]:
    height, width = shape
    image = np.zeros(shape)
    disparity = np.zeros(shape)
    owner = np.full(shape, -1, dtype=np.int64)
    x = np.arange(width, dtype=np.float64)
    for y in range(height):
        ground_disparity = slope * (y - horizon)
        on_ground = ground_disparity > wall_disparity
        far = ground_disparity if on_ground else wall_disparity
        image[y] = _sample(ground if on_ground else wall, y, x + (far if right else 0.0))
        disparity[y] = far
        for number, pole in enumerate(poles):
            if not pole.top <= y < pole.foot:
                continue
            place = x + (pole.disparity if right else 0.0) - pole.start
            cover = np.clip(np.minimum(place + 0.5, pole.width - place + 0.5), 0.0, 1.0)
            shade = _sample(pole.texture, y, np.clip(place, 0, pole.width))
            image[y] = cover * shade + (1 - cover) * image[y]
            disparity[y][cover >= 0.5] = pole.disparity
            owner[y][cover >= 0.5] = number
    return image, View(disparity, owner)


def rendered_scene(
    seed: int,
    shape: tuple[int, int] = (480, 768),
    bits: int = 8,
    noise_sd: float = 1.5,
    gain: float = 1.0,
    gamma: float = 1.0,
    vignetting: float = 0.0,
) -> Scene:
    """One pair. `gain`, `gamma` and `vignetting` (loss in the corners) act on the right image;
    `noise_sd` is in grey values of an 8-bit image.
    """
    rng = np.random.default_rng(seed)
    height, width = shape
    wall = _texture(rng, height, width + 200, rng.uniform(6, 20))
    ground = _texture(rng, height, width + 200, rng.uniform(5, 15))
    horizon, slope = int(height * 0.45), 0.26
    wall_disparity = rng.uniform(3, 10)
    poles = []
    for _ in range(14):
        disparity = rng.uniform(wall_disparity + 3, 55)
        pole_width = float(np.exp(rng.uniform(np.log(2), np.log(20))))
        foot = min(height, int(horizon + disparity / slope))
        top = int(rng.uniform(0, 0.4) * height)
        level = rng.choice([-1.0, 1.0]) * rng.uniform(25, 70)
        columns = np.arange(width + 200) - 40.0
        round_shade = 15 * np.sqrt(np.clip(1 - (2 * columns / pole_width - 1) ** 2, 0, 1))
        texture = 110 + level + round_shade + 0.5 * (_texture(rng, height, width + 200, 15) - 110)
        poles.append(_Pole(rng.uniform(60, width - 40), pole_width, disparity, top, foot, texture))
    poles.sort(key=lambda pole: pole.disparity)
    images, views = [], []
    for right in (False, True):
        image, view = _render(shape, wall, ground, wall_disparity, horizon, slope, poles, right)
        images.append(np.clip(image, 0, 255))
        views.append(view)
    v, u = np.mgrid[:height, :width]
    radius2 = ((u - width / 2) ** 2 + (v - height / 2) ** 2) / ((width**2 + height**2) / 4)
    images[1] = 255 * (images[1] / 255) ** gamma * gain * (1 - vignetting * radius2)
    top_value = 2**bits - 1
    grey: list[Image] = []
    for image in images:
        noisy = image + noise_sd * rng.standard_normal(shape)
        levels = np.clip(np.rint(noisy * top_value / 255), 0, top_value)
        grey.append(levels.astype(np.uint8) if bits == 8 else levels.astype(np.uint16))
    return Scene(
        grey[0],
        grey[1],
        (views[0], views[1]),
        np.array([pole.width for pole in poles]),
        np.array([pole.disparity for pole in poles]),
    )


@dataclass(frozen=True, slots=True)
class PoleScore:
    """Counts that add up over scenes. `clear`: rows in which no other pole stands within 6 px."""

    pixels: int = 0
    found: int = 0
    thin_pixels: int = 0
    thin_found: int = 0
    clear_pixels: int = 0
    clear_found: int = 0
    rows: int = 0
    fat: int = 0

    def __add__(self, other: PoleScore) -> PoleScore:
        return PoleScore(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))

    @property
    def recall(self) -> float:
        """Share of the pole pixels with a disparity within 1 px of the truth."""
        return self.found / self.pixels

    @property
    def thin_recall(self) -> float:
        """The same for poles under 6 px."""
        return self.thin_found / self.thin_pixels

    @property
    def clear_recall(self) -> float:
        """The same where the pole stands clear of others in both views."""
        return self.clear_found / self.clear_pixels

    @property
    def fattening_px(self) -> float:
        """Pixels beside a pole that take its disparity, per pole and row."""
        return self.fat / self.rows


def _clear(scene: Scene, side: int) -> NDArray[np.bool_]:
    """Pole pixels of a view in whose rows the pole stands clear of others in both views."""
    owners = scene.views[side].pole
    clear = np.zeros(owners.shape, dtype=bool)
    for number in range(len(scene.pole_width_px)):
        crowded = np.zeros(len(owners), dtype=bool)
        for view in scene.views:
            of_pole = (view.pole == number).astype(np.uint8)
            around = cv2.dilate(of_pole, np.ones((1, 2 * CLEAR_PX + 1), np.uint8)) > 0
            crowded |= (around & (view.pole >= 0) & (view.pole != number)).any(axis=1)
        clear |= (owners == number) & ~crowded[:, np.newaxis]
    return clear


def score_poles(scene: Scene, disparity: NDArray[np.float32], side: int) -> PoleScore:
    """Pole pixels found in the map of `side` (0 left, 1 right), and how far poles grow."""
    view = scene.views[side]
    width = view.disparity_px.shape[1]
    column = np.arange(width)
    partner = column - view.disparity_px if side == 0 else column + view.disparity_px
    inside = np.clip(np.rint(partner), 0, width - 1).astype(np.int64)
    other = np.take_along_axis(scene.views[1 - side].disparity_px, inside, axis=1)
    # what the other camera cannot see has no partner that a matcher could find
    visible = (partner >= 0) & (partner <= width - 1)
    visible &= np.abs(other - view.disparity_px) <= 0.5
    known = np.isfinite(disparity)
    right_value = known & (np.abs(disparity - view.disparity_px) <= 1)
    pole = (view.pole >= 0) & visible
    thin = pole & (scene.pole_width_px[view.pole] < 6)
    clear = pole & _clear(scene, side)
    rows = fat = 0
    for number, truth in enumerate(scene.pole_disparity_px):
        of_pole = view.pole == number
        for y in np.flatnonzero(of_pole.any(axis=1)):
            extent = np.flatnonzero(of_pole[y])
            low, high = max(extent[0] - 8, 0), min(extent[-1] + 9, width)
            rows += 1
            near = slice(low, high)
            wrong = known[y, near] & (np.abs(disparity[y, near] - truth) <= 1)
            fat += int((wrong & (np.abs(view.disparity_px[y, near] - truth) > 1)).sum())
    return PoleScore(
        int(pole.sum()),
        int((pole & right_value).sum()),
        int(thin.sum()),
        int((thin & right_value).sum()),
        int(clear.sum()),
        int((clear & right_value).sum()),
        rows,
        fat,
    )
