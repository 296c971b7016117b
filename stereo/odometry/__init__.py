"""Motion of the stereo camera from one pair to the next: corners, tracks, robust motion."""
