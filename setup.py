"""Builds the eight C++17 kernels where a compiler is found, and goes on without them elsewhere."""

from pathlib import Path

from pybind11.setup_helpers import Pybind11Extension
from setuptools import setup

KERNELS = {
    module: f"{module.replace('.', '/')}.cpp"
    for module in (
        "polemap.stereo.native.census_kernel",
        "polemap.localize.particle_filter.native.assignment_kernel",
        "polemap.localize.particle_filter.native.particle_kernel",
        "polemap.vehicle.native.packed_kernel",
        "polemap.simulate.native.shading_kernel",
        "polemap.detect.native.pieces_kernel",
        "polemap.detect.native.corners_kernel",
        "polemap.detect.native.road_kernel",
    )
}
# Python's own flags bring -fwrapv, under which GCC 12 no longer vectorises the matcher's loops:
# measured, it is fifteen times slower with it
FLAGS = ["-O3", "-fno-wrapv", "-g0", "-pthread"]

setup(
    ext_modules=[
        # optional: a failed build is a warning, and the slower fallbacks serve instead
        Pybind11Extension(
            module,
            [source],
            depends=[str(header) for header in Path(source).parent.glob("*.hpp")],
            cxx_std=17,
            extra_compile_args=FLAGS,
            optional=True,
        )
        for module, source in KERNELS.items()
        if Path(source).exists()
    ]
)
