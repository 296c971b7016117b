"""Builds the three C++17 kernels where a compiler is found, and goes on without them elsewhere."""

from pathlib import Path

from pybind11.setup_helpers import Pybind11Extension
from setuptools import setup

KERNELS = {
    "stereo.native.census_kernel": "stereo/native/census_kernel.cpp",
    "polemap.native.assignment_kernel": "polemap/native/assignment_kernel.cpp",
    "simulate.native.shading_kernel": "simulate/native/shading_kernel.cpp",
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
