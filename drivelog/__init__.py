"""A drive on disk to typed, time-ordered samples, and the frames of the earth."""
