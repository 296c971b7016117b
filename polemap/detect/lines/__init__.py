"""Lines on the ground of one frame: lane markings and kerbs."""
