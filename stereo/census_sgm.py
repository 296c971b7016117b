"""The census matcher: 5x5 census, Hamming cost, semi-global matching in the C++ extension."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

import numpy as np

from polemap.stereo.census import census_pairs
from polemap.stereo.checks import SPECKLE_STEP_PX, check_pair
from polemap.stereo.config import StepPenalty, StereoConfig
from polemap.stereo.errors import StereoError
from polemap.stereo.matching_types import DisparityPair, Image
from polemap.stereo.rig import StereoRig

_ALPHA_ONE = 1 << 16
_SMOOTHING = {"none": 0, "upright": 1, "square": 2}
_SUBPIXEL = {"none": 0, "parabola": 1, "equiangular": 2}


@dataclass(frozen=True, slots=True)
class KernelOptions:
    """What the kernel can do otherwise, and no user should turn; figures in `docs/stereo.md`.

    Attributes:
        subpixel: where between whole pixels: `equiangular` fits the V that the sums are,
            `parabola` stays too near to the whole pixel.
        median: a 3x3 median of the winners before the checks.
        speckle_rows: connected components at least this tall stay, as what is left of a thin
            pole is.
        speckle_step_px: neighbours are connected if their disparities differ by no more.
        outside_cost: matching cost where the partner would lie outside the other image; half of
            the 24 bits, as of two pixels that have nothing in common.
        instruction_set: auto, baseline, avx2 or avx512; the result is the same.
    """

    subpixel: Literal["none", "parabola", "equiangular"] = "equiangular"
    median: bool = True
    speckle_rows: int = 16
    speckle_step_px: float = SPECKLE_STEP_PX
    outside_cost: int = 12
    instruction_set: str = "auto"


KERNEL_OPTIONS = KernelOptions()


def _law(law: StepPenalty, bits: int) -> tuple[int, int, int, int]:
    """P2 as the kernel takes it: p2_min, p2_max, gamma and alpha as a fraction of 2^16."""
    alpha = round(law.alpha * _ALPHA_ONE / 2 ** (bits - 8))
    return law.p2_min, law.p2_max, law.gamma, alpha


class CensusSgm:
    """Matches with the C++ kernel; one object keeps its memory from frame to frame.

    Raises:
        ImportError: the extension was not built.
        StereoError: the machine lacks the instruction set that `options` ask for.
    """

    name = "census_sgm"

    def __init__(
        self,
        config: StereoConfig,
        rig: StereoRig | None = None,
        options: KernelOptions = KERNEL_OPTIONS,
    ) -> None:
        census_kernel: Any = import_module("polemap.stereo.native.census_kernel")

        self._kernel = census_kernel
        self._config = config
        self._rig = rig
        self._options = options
        if options.instruction_set not in ("auto", *census_kernel.instruction_sets()):
            known = ", ".join(census_kernel.instruction_sets())
            raise StereoError(
                f"instruction_set {options.instruction_set}: this machine has {known}; use auto"
            )
        self._by_bits = {bits: self._make(bits) for bits in {8, config.uint16_bits}}

    @property
    def instruction_set(self) -> str:
        """Which build of the loops runs here: avx512, avx2 or baseline."""
        return str(self._by_bits[8].instruction_set)

    def match(self, left: Image, right: Image) -> DisparityPair:
        """Both disparity maps of a rectified pair.

        Raises:
            StereoError: images of different size or type, or too small for the search range,
                or with more bits than `uint16_bits`.
        """
        kernel, pair = self._checked(left, right)
        return DisparityPair(*kernel.match(*pair))

    def searched_rows(self, left: Image, right: Image) -> list[int]:
        """How many disparities `match` searches in each row of this pair; see `search`.

        Raises:
            StereoError: as of `match`.
        """
        kernel, pair = self._checked(left, right)
        return list(kernel.searched(*pair))

    def _checked(self, left: Image, right: Image) -> tuple[Any, tuple[Image, Image]]:
        check_pair(left, right, self._config, self._rig)
        bits = 8 if left.dtype == np.uint8 else self._config.uint16_bits
        if bits < 16 and int(left.max()) >> bits | int(right.max()) >> bits:
            raise StereoError(
                f"the images hold values above {2**bits - 1}, more than {bits} bits: "
                "raise uint16_bits in the stereo settings"
            )
        pair: Any = np.ascontiguousarray(left), np.ascontiguousarray(right)
        return self._by_bits[bits], pair

    def _make(self, bits: int) -> Any:
        config, penalties, options = self._config, self._config.penalties, self._options
        tolerance = config.left_right_tolerance_px
        return self._kernel.CensusMatcher(
            pairs=census_pairs(config.census),
            bits=bits,
            smoothing=_SMOOTHING[config.smoothing],
            disparities=config.disparities,
            offset=config.min_disparity_px,
            paths=config.paths,
            own_right=config.right_map == "own",
            p1=penalties.p1,
            across=_law(penalties.across, bits),
            upright=_law(penalties.upright, bits),
            uniqueness_percent=config.uniqueness_percent,
            subpixel=_SUBPIXEL[options.subpixel],
            median=options.median,
            tolerance=-1.0 if tolerance is None else tolerance,
            speckle_px=config.speckle_px,
            speckle_rows=options.speckle_rows,
            speckle_step_px=options.speckle_step_px,
            outside_cost=options.outside_cost,
            cost_weight=config.cost_weight,
            threads=config.threads,
            instruction_set=options.instruction_set,
            search_strips=config.search == "strips",
        )
