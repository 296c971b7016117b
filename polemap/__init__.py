"""Disparity to poles, poles to tracks, tracks to a map."""

__version__ = "0.1.0"
