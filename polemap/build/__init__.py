"""Drives with reference poses to one pole map."""
