"""Lines of a map: from the pieces that drives saw to polylines."""
