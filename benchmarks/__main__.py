"""Run every benchmark of this folder, or those named, and write `benchmarks/results.json`.

A benchmark is a module with `run() -> {name: {"median_ms": ..., "p95_ms": ..., ...}}`. It
measures what it compares in one run, interleaved, and skips with a `skipped` note where the
recordings that it needs are missing.
"""

from __future__ import annotations

import json
import os
import pkgutil
import platform
import sys
import time
from importlib import import_module
from pathlib import Path

FOLDER = Path(__file__).parent
RESULTS = FOLDER / "results.json"


def modules() -> list[str]:
    """Names of the benchmark modules: those that define `run`."""
    found = (entry.name for entry in pkgutil.iter_modules([str(FOLDER)]))
    return sorted(name for name in found if "\ndef run(" in (FOLDER / f"{name}.py").read_text())


def main(names: list[str]) -> int:
    """Run the benchmarks called `names`, or all; the exit code says whether any was unknown."""
    known = modules()
    unknown = sorted(set(names) - set(known))
    if unknown:
        sys.stderr.write(f"no benchmark {', '.join(unknown)}; there are: {', '.join(known)}\n")
        return 2
    results = json.loads(RESULTS.read_text()) if names and RESULTS.exists() else {}
    results["machine"] = {
        "python": platform.python_version(),
        "system": platform.platform(),
        "cores": os.cpu_count() or 0,
    }
    for name in names or known:
        begin = time.perf_counter()
        print(f"== {name}", flush=True)
        figures = import_module(f"benchmarks.{name}").run()
        for figure, values in figures.items():
            shown = ", ".join(f"{k} {_short(v)}" for k, v in values.items())
            print(f"   {figure}: {shown}")
        results.update(figures)
        print(f"   ({time.perf_counter() - begin:.0f} s)", flush=True)
        part = RESULTS.with_suffix(".part")
        part.write_text(json.dumps(results, indent=1))
        part.replace(RESULTS)
    return 0


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
