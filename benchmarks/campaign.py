"""The long fault campaign: `python -m benchmarks.campaign [SEEDS]` (`make campaign`).

Every fault of the output filter and every recovery case of the particle filter, over many seeds,
on drives of points; prints each table and writes the first kind to `benchmarks/campaign.json`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from benchmarks import particle_filter_recovery
from benchmarks.output_filter import show
from benchmarks.output_filter_faults import faults

RESULTS = Path(__file__).parent / "campaign.json"


def main(seeds: int) -> None:
    """Run all cases with `seeds` seeds each."""
    tables = {
        "output filter, with GNSS": faults(seeds),
        "output filter, without GNSS": faults(seeds, with_gnss=False),
    }
    for title, table in tables.items():
        show(title, table)
    part = RESULTS.with_suffix(".part")
    part.write_text(json.dumps({"seeds": seeds, **tables}, indent=1))
    part.replace(RESULTS)
    print("\nparticle filter")
    particle_filter_recovery.main(seeds, list(particle_filter_recovery.CASES))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50)
