"""Benchmarks of polemap/."""
