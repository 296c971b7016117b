"""Where in a map of any size the car is, by the pattern of the poles along the way driven alone."""
