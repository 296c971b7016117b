"""Figures of map building that no user need turn.

Source, where no other is named: tuned on simulated towns and held against Victoria Park and KITTI
odometry 03, as `docs/maps.md` states: poles neither doubled nor lost, NEES of the map about one.
"""

SYSTEMATIC_SD_M = 0.02  # error of a detector that no repetition averages away
DISPARITY_TRAVERSAL_SD_PX = 0.22  # disparity error of a pole that one traversal shares (stereo)
DISPARITY_COMMON_SD_PX = 0.2  # disparity error that all traversals of all drives share

GATE_PROBABILITY = 0.997  # of detections to a pole
GATE_SLACK_M = 0.15  # added to the gate within a traversal, 1 sd
TRAVERSAL_GAP_S = 20.0  # not detected for longer: a new traversal
MERGE_SLACK_M = 0.25  # seen from two sides a trunk has two middles: added to the gate
MERGE_PROBABILITY = 0.9999

FALSE_ALARM_PROBABILITY = 0.04  # of a detection where no pole stands, a scan
INDEPENDENT_SCAN_S = 0.5  # scans closer together share what hides a pole
DRIVE_LOG_ODDS_MAX = 3.0  # the most that one drive can say for or against a pole
LOG_ODDS_MAX = 4.0  # limit of all drives together, so that a map can still change

DRIFT_LEAST_M = 0.12  # traversals that differ by less, 1 sd, are taken as they are
