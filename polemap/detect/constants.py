"""Figures of the detector that no user need turn.

Source, where no other is named: tuned on KITTI odometry 03 with `polemap detect --evaluate`, held
against rendered streets on which nothing was tuned with `benchmarks/polemap/seen_poles.py`: recall
and precision of poles, and the NEES of tracks for the errors (`docs/perception.md`).
"""

STEP_MIN_PX = 0.8  # smallest disparity jump of a depth edge
STEP_MIN_M = 0.4  # smallest depth jump of a depth edge
LEAN_MAX_RAD = 0.18
BASE_MAX_M = 2.2  # greatest height of the lowest evidence above the ground
HYPOTHESES_MAX = 80  # of one frame; bounds its time
REFINE_PROBABILITY = 0.15  # from here on the disparity is fitted to the images

DISPARITY_SD_PX = 0.15  # error that all of a pole's surface shares, beside what all poles share
MATCHER_SD_PX = 0.25  # more of it where the fit to the images failed
COLUMN_SD_PX = 0.7  # of the centre column
ACROSS_SD_M = 0.03  # of the axis at ground level, sideways
ACROSS_SD_SHARE = 0.1  # more of it, in widths: what is wide may be two things side by side
EXTENSION_SD_M = 0.05  # more of it, for each length by which the axis is extended down
AXIS_SHARE = 0.3  # axis behind the matched front of a cylinder, in widths
AXIS_SD_SHARE = 0.15
