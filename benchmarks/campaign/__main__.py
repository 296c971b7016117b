"""The long fault campaign: `python -m benchmarks.campaign [SEEDS]` (`make campaign`).

Every kind of contradiction through the whole localizer (`contradictions.py`, at most ten seeds),
every fault of the output filter and every recovery case of the particle filter, on drives of
points; prints each table and writes the second kind to `benchmarks/campaign.json`.
"""

from __future__ import annotations

import sys

from benchmarks.campaign import contradictions
from benchmarks.harness import FOLDER, show, write_results
from benchmarks.localize import particle_filter_recovery
from benchmarks.localize.output_filter_faults import faults

RESULTS = FOLDER / "campaign.json"


def main(seeds: int) -> None:
    """Run all cases with `seeds` seeds each."""
    contradictions.main(["--seeds", str(min(seeds, 10))])
    tables = {
        "output filter, with GNSS": faults(seeds),
        "output filter, without GNSS": faults(seeds, with_gnss=False),
    }
    for title, table in tables.items():
        show(title, table)
    write_results(RESULTS, {"seeds": seeds, **tables})
    print("\nparticle filter")
    particle_filter_recovery.main(seeds, list(particle_filter_recovery.CASES))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50)
