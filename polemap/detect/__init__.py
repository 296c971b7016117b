"""A stereo frame to the poles that it shows."""
