"""A pole map from a drive that has reference poses."""

import matplotlib.pyplot as plt

import polemap

drive = polemap.open_drive("drive").lap("lap_1")  # polemap simulate park_loop --laps 2 --out drive
# filmed at a few frames a second, a pole is seen seldom; at 10 Hz and more the default will do
settings = polemap.Settings(polemap={"mapping": {"observations_min": 4}})
pole_map = polemap.build_map(drive, settings)
polemap.write_map(pole_map, "campus.gpkg")

print(f"{len(pole_map)} poles in {pole_map.frame}", *pole_map.notes, sep="\n")
plt.scatter(*pole_map.points_m.T, s=100 * pole_map.width_m, c=pole_map.existence)
plt.axis("equal")
plt.savefig("map.png")
