"""A drive localized in a map, held against its reference, and drawn."""

import matplotlib.pyplot as plt

import polemap

drive = polemap.open_drive("drive").lap("lap_2")
pole_map = polemap.read_map("campus.gpkg", drive.frame)  # of map_from_a_drive.py
run = polemap.replay(drive, pole_map, seed=0)
accuracy = polemap.evaluate(run, drive)

print(f"lateral {accuracy.lateral_rmse_m:.3f} m, yaw {accuracy.yaw_rmse_rad:.4f} rad (rms)")
plt.plot(*drive.reference.poses[:, :2].T, label="reference")
plt.plot(*run.kf.poses[:, :2].T, label="localized, 100 Hz")
plt.scatter(*pole_map.points_m.T, marker="+", label="poles")
plt.axis("equal")
plt.legend()
plt.savefig("localized.png")
