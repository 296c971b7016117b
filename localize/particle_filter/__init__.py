"""The particle filter: pole scans, odometry and GNSS to a pose, once a scan.

`filter.py` shows the whole of an update. Each step has its file: `motion_model.py` moves the
particles (`particles.py`), with noise that `motion_noise.py` learns; `sensor_model.py` says how
likely a scan is against the map (`landmarks.py`), by the best assignment of poles (`assignment.py`
and its kernel in `native/`), and `pole_weigher.py` applies it to all particles; `recovery.py`
explores and starts anew (`exploration.py`, `place_search.py`, `constellation.py`,
`recent_poles.py`); `estimate.py` is what comes out, and `health.py` whether it may be trusted.
"""
