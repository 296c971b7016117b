"""Run every benchmark, or those named, and write `benchmarks/results.json`."""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from importlib import import_module

from benchmarks.harness import FOLDER, modules, show, write_results

RESULTS = FOLDER / "results.json"


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
        figures = import_module(f"benchmarks.{name}").run()
        show(f"{name} ({time.perf_counter() - begin:.0f} s)", figures)
        results.update(figures)
        write_results(RESULTS, results)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
