"""Benchmarks of localize/."""
