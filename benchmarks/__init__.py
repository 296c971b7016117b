"""Benchmarks that anyone can run: `python -m benchmarks [NAME...]`."""

from pathlib import Path

# recordings lie beside the project; what is not there is left out
RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "data"
