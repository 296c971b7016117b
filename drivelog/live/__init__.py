"""Samples as they are recorded: a growing MCAP file, or a pipe of MCAP or of JSON lines."""
