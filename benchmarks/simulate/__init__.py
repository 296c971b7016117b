"""Benchmarks of simulate/."""
