"""Benchmarks by room: `python -m benchmarks [NAME...]`, NAME as in `stereo.speed`."""
