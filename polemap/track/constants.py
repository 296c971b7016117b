"""Figures of the tracker that no user need turn.

Source, where no other is named: tuned on KITTI odometry 03 with `polemap detect --evaluate`, held
against rendered streets on which nothing was tuned with `benchmarks/polemap/seen_poles.py`
(`docs/perception.md`).
"""

GATE_PROBABILITY = 0.99  # mass of the gate's ellipse
GATE_MAX_M = 2.5  # of the gate, whatever the covariance
WIDTH_SD_M = 0.12  # of one width measurement
DETECTION_PROBABILITY = 0.5  # in view, per frame, of thin and far poles, too
POLE_SHARE = 0.43  # of what the detector judges: its odds speak against these
PERIOD_S = 0.1  # frames closer than this are less evidence
ERROR_TIME_S = 0.3  # correlation time of a pole's position error
DELETE_EXISTENCE = 0.05  # a track below it ends
SPEED_SD_MPS = 0.1  # of odometry, beside the share of the way
DRIFT_SD_MPS = 0.05  # how fast a landmark may wander in the vehicle frame
