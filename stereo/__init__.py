"""Two images to disparity and depth edges. Imports no other room."""
