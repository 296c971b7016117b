"""The output filter: odometry and late poses to a smooth pose at any moment.

`filter.py` is the EKF behind a replay buffer; `odometry_update.py`, `pose_update.py` and
`gnss/ekf_update.py` take one kind of event in; `rejection.py` decides on poses that fail the gate;
`limiter.py` bounds how fast the output moves. `noise_model.py` is what is taken to be random.
"""
