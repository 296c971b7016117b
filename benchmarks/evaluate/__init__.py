"""Benchmarks of evaluate/."""
