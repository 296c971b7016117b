"""The output filter: odometry and late poses to a smooth pose at any moment.

`filter.py` is the EKF behind a replay buffer; `odometry_update.py`, `pose_update.py` and
`gnss/ekf_update.py` take one kind of event in. `gate.py` is the chi-square gate of all three, and
`failed_gate.py` says what follows a pose that fails it; `limiter.py` bounds how fast the output
moves, and `health.py` says whether it may be trusted. `noise_model.py` is what is taken to be
random.
"""
