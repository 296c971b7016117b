"""Lines of one frame: lane markings, kerbs, and facades in plan."""
