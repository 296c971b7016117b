"""The door to Open3D's ray caster (Embree): imported late, with one clear line if it cannot be."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import ConfigError
from polemap.extras import MissingExtraError, need
from polemap.simulate.mesh import Mesh

Floats32 = NDArray[np.float32]


def open3d() -> Any:
    """The open3d module.

    Its wheel links to the system's libusb, which lean machines lack although nothing here needs
    it; the copy inside the package `libusb-package` serves then.

    Raises:
        MissingExtraError: open3d is not installed.
        ConfigError: it cannot be loaded.
    """
    try:
        return need("open3d")
    except MissingExtraError:
        raise
    except ImportError as error:
        if "libusb" not in str(error):
            raise ConfigError(
                f"the simulator needs open3d, which does not load: {error}"
            ) from error
        first = error
    try:
        package = find_spec("libusb_package")
        if package is None or package.origin is None:
            raise ImportError("libusb-package is not installed")
        library = Path(package.origin).parent / "libusb-1.0.so"
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
        return need("open3d")
    except (ImportError, OSError) as error:
        raise ConfigError(
            f"open3d does not load ({first}): install the system library libusb-1.0-0, "
            "or `pip install libusb-package`"
        ) from error


@dataclass(frozen=True, slots=True)
class Hits:
    """First intersections of n rays; `depth` counts in lengths of the ray, infinite for none.

    `triangle` `(n,)` uint32 (0 without a hit), `bary` `(n, 2)`, `normal` `(n, 3)`.
    """

    depth: Floats32
    triangle: NDArray[np.uint32]
    bary: Floats32
    normal: Floats32

    def rows(self, rows: slice | NDArray[np.int64]) -> Hits:
        """Some of the rays."""
        return Hits(self.depth[rows], self.triangle[rows], self.bary[rows], self.normal[rows])


class Caster:
    """One mesh, ready for rays."""

    def __init__(self, mesh: Mesh, threads: int = 0) -> None:
        o3d = open3d()
        self._tensor = o3d.core.Tensor.from_numpy
        self._threads = threads
        self.empty = len(mesh) == 0
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
        if not self.empty:
            self._low = mesh.vertices_m.min(axis=0)
            self._high = mesh.vertices_m.max(axis=0)
            self._scene.add_triangles(mesh.vertices_m, mesh.triangles)

    def cast(self, rays: Floats32) -> Hits:
        """Rays `(n, 6)`: origin and direction."""
        count = len(rays)
        if self.empty or count == 0:
            return Hits(
                np.full(count, np.inf, np.float32),
                np.zeros(count, np.uint32),
                np.zeros((count, 2), np.float32),
                np.zeros((count, 3), np.float32),
            )
        found = self._scene.cast_rays(
            self._tensor(np.ascontiguousarray(rays)), nthreads=self._threads
        )
        triangle = found["primitive_ids"].numpy()
        depth = found["t_hit"].numpy()
        triangle[~np.isfinite(depth)] = 0
        return Hits(
            depth, triangle, found["primitive_uvs"].numpy(), found["primitive_normals"].numpy()
        )

    def around(self, reach_m: float) -> tuple[float, float, float, float] | None:
        """West, south, east and north end of all within `reach_m` of the mesh; None if empty."""
        if self.empty:
            return None
        low, high = self._low - reach_m, self._high + reach_m
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def blocked(self, rays: Floats32) -> NDArray[np.bool_]:
        """Which rays `(n, 6)` hit anything at all."""
        if self.empty or len(rays) == 0:
            return np.zeros(len(rays), dtype=np.bool_)
        found = self._scene.test_occlusions(
            self._tensor(np.ascontiguousarray(rays)), nthreads=self._threads
        )
        return np.asarray(found.numpy(), dtype=np.bool_)
