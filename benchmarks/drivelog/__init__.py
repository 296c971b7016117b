"""Benchmarks of reading drives."""
