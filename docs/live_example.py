import threading
import time

import numpy as np

from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer


def drive(pole_map, samples, steer):
    localizer = Localizer(pole_map, LocalizeConfig(), 2.7, np.random.default_rng(0))
    clock = [0.0]

    def feed():
        for sample in samples:  # OdometrySample, GnssFix, PoleScan or StereoFrame, by arrival
            localizer.push(sample)
            clock[0] = sample.arrival_s

    thread = threading.Thread(target=feed)
    thread.start()
    while thread.is_alive():  # a controller; 100 times a second
        if (pose := localizer.pose(clock[0])) is not None:
            steer(pose)
        time.sleep(0.001)
