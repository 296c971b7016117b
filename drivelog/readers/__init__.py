"""Readers of drives, one format a file; found through the entry points `polemap.readers`."""
