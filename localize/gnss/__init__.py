"""GNSS for both filters.

`outlier_mixture.py` is the receiver's error model: antenna, noise by HDOP, outliers. A fix enters

- the particle filter: `alignment.py` lays the path of the odometry onto the recent fixes, which
  says where to start or to look; `particle_weights.py` weighs the particles;
- the output filter: `start.py` finds its first pose; `ekf_update.py` bounds it while no pose is
  accepted, and lets fixes speak for or against a re-initialization.
"""
