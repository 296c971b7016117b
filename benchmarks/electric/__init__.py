"""Benchmarks of electric/."""
