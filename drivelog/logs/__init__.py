"""Logs of other recorders (CSV of all shapes, NMEA, GPX) read by a mapping into our streams."""
