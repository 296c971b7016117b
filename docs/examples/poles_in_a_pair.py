"""Poles in one stereo pair, as a table and a picture."""

import matplotlib.pyplot as plt

import polemap

drive = polemap.open_drive("drive")  # polemap simulate park_loop --laps 2 --out drive
frame = drive.read_frame(10)  # two image files will do as well: poles("left.png", "right.png")
found = polemap.Perception(drive).poles(frame.left, frame.right)

print(found.table.round(2))
plt.imsave("poles.png", found.picture())
