"""Worlds, drives, sensor and fault models; writes drives as any recorder would."""
