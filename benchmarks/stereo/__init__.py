"""Benchmarks of stereo/."""
