"""Long campaigns against faults, damaged files and kills: see docs/files.md."""
