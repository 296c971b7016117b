"""Live in a car: one thread adds what the sensors send, the controller asks for the pose."""

import threading
import time

import polemap

car = polemap.open_drive("drive").lap("lap_2")  # names camera, antenna and wheelbase
localizer = polemap.Localizer(polemap.read_map("campus.gpkg", car.frame), car)
now = [0.0]


def feed():
    for sample in car.samples():  # stands in for the sensors: odometry, fixes, stereo frames
        localizer.add_sample(sample)
        now[0] = sample.arrival_s


sensors = threading.Thread(target=feed)
sensors.start()
while sensors.is_alive():  # a controller, 100 times a second
    pose = localizer.pose_at(now[0])
    if pose is not None:  # None until a position is known
        east_m, north_m, yaw_rad = pose.pose
        print(f"{pose.stamp_s:.2f} s: {east_m:.2f} {north_m:.2f} m, {yaw_rad:.3f} rad")
    time.sleep(0.01)
print(localizer.summary())
