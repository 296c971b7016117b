"""Text and bytes that somebody else wrote, turned into plain values: with limits, and one error.

Every file that polemap reads comes in through here: settings, drives, maps, runs and caches may be
damaged or hostile, and must cost one line, not a traceback, a hang or the memory of the machine.
docs/files.md states the limits.
"""
