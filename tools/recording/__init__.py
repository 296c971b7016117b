"""Runs as recordings for Foxglove and rerun."""
