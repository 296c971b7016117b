"""Figures of the detector of corners that no user need turn."""

EDGE_HEIGHT_MIN_M = 0.7  # of an upright edge
EDGE_FILL_MIN = 0.45  # share of its rows that show it
EDGE_ROWS_MIN = 6  # searched rows
EDGE_LEAN_MAX = 0.08  # columns a row
EDGES_MAX = 60  # of one frame; bounds its time
EXTENT_MIN_M = 0.45  # of a wall beside its edge: less is a post

CORNER_DISPARITY_SD_PX = 0.2  # error that all of a wall shares
CORNER_COLUMN_SD_PX = 0.7  # of the edge
CORNER_ACROSS_SD_M = 0.055  # edges of walls are no lines: plinths, gutters, reveals
