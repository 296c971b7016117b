"""Pole maps as tables and documents in memory; `polemap.io` brings them to the disk and back."""
