"""The localizer: samples in, the pose at any moment out. Replay and a live car drive the same."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import replace
from threading import Lock
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.samples import GnssFix, OdometrySample, Sample, StereoFrame
from polemap.localize.calibration import OdometryCorrection
from polemap.localize.clocks import ComputerClock, StreamClock, is_time
from polemap.localize.config import LocalizeConfig
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.odometry_watch import Held, OdometryWatch
from polemap.localize.output_filter.filter import OutputFilter, usable_pose
from polemap.localize.output_filter.health import distrust, fixes_disagree
from polemap.localize.output_filter.limiter import OutputLimiter, OutputPose
from polemap.localize.output_filter.state import NEVER
from polemap.localize.particle_filter.assignment import HAVE_KERNEL
from polemap.localize.particle_filter.estimate import PfEstimate
from polemap.localize.particle_filter.filter import ParticleFilter
from polemap.localize.pose_queue import PoseQueue, PoseUpdate, count_dropped
from polemap.localize.stage_times import StageTimes
from polemap.localize.usable import usable_fix, usable_odometry, usable_poles
from polemap.map.city.city_map import CityMap
from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]

# where nothing arrives for longer than this, there is no output until something does again
OUTPUT_HOLE_S = 60.0
STREAMS = ("odometry", "gnss", "camera")


class Perception(Protocol):
    """Frames to pole scans; `polemap.perception.PolePerception` is one."""

    def record_odometry(self, sample: OdometrySample, /) -> None:
        """Keep what moves the tracks until the next frame."""

    def scan_frame(self, frame: StereoFrame, /) -> Detections:
        """The tracked poles of a frame, in the vehicle frame."""


class Localizer:
    """A pole map and a stream of samples to a pose at any moment.

    `add_sample` and `pose_at` may be called from different threads: a frame that is processed does
    not keep `pose_at` waiting. Samples must be added in the order in which they arrive.

    Args:
        pole_map: a map in memory, or that of a city, of which what lies around the car is kept;
            None localizes by odometry and GNSS alone.
        config: settings of the particle filter, and of the output filter in `config.output`.
        wheelbase_m: rear axle to front axle.
        rng: all randomness.
        gnss_antenna_m: `(2,)` in the vehicle frame.
        perception: finds poles in stereo frames; not needed where scans are added.
        processing_delay_s: for replay; holds a pose back as long as the live system would need.
        on_update: called with every pose of the particle filter once its fate is known.
        clock: a monotonic clock in seconds; with it, `timings_s` collects the time of each stage.
        load_in_background: of a city's map what lies ahead is read by a thread; otherwise by the
            scan that asks for it, so that the same samples give the same poses, bit for bit.
    """

    def __init__(
        self,
        pole_map: PoleMap | CityMap | None,
        config: LocalizeConfig,
        wheelbase_m: float,
        rng: np.random.Generator,
        *,
        gnss_antenna_m: Floats | None = None,
        perception: Perception | None = None,
        processing_delay_s: float = 0.0,
        on_update: Callable[[PoseUpdate], None] | None = None,
        clock: Callable[[], float] | None = None,
        load_in_background: bool = True,
    ) -> None:
        antenna = (0.0, 0.0) if gnss_antenna_m is None else tuple(map(float, gnss_antenna_m))
        receiver = GnssReceiver((antenna[0], antenna[1]), config.gnss)
        self._frame = None if pole_map is None else pole_map.frame
        if pole_map is not None:
            # scipy loads its parts when they are first used: here, so that no scan waits for it
            _ = scipy.spatial if HAVE_KERNEL else (scipy.spatial, scipy.optimize)
        self._particle_filter = (
            ParticleFilter(
                pole_map,
                config,
                wheelbase_m,
                rng,
                receiver=receiver,
                load_in_background=load_in_background,
            )
            if pole_map is not None
            else None
        )
        self._filter = OutputFilter(config.output, receiver, config.odometry.rear_slip_rad_per_mps2)
        self._limiter = OutputLimiter(
            limited=config.output.limit_corrections, step_beyond_m=config.output.step_beyond_m
        )
        self._health = config.health
        # without a map fixes are all there is
        self._fixes_out = config.gnss.output or pole_map is None
        self._watch = OdometryWatch(doubts=config.odometry.doubts)
        # what the particle filter has learned
        self._correction = OdometryCorrection()
        self._perception = perception
        self._times = StageTimes(clock)
        self._computer_clock = ComputerClock()
        self._clocks = {name: StreamClock() for name in STREAMS}
        self._inbox: deque[tuple[OdometrySample | GnssFix, Held | None]] = deque(maxlen=20_000)
        # the slow half (perception, particles) and the fast half (output filter) have a lock each
        self._slow, self._fast = Lock(), Lock()
        self.counts: Counter[str] = Counter()
        self.timings_s = self._times.seconds
        self._poses = PoseQueue(
            self._filter,
            self.counts,
            self._times,
            processing_delay_s,
            on_update,
            config.odometry.rear_slip_rad_per_mps2,
            offered=config.output.offered,
        )

    def add_sample(self, sample: Sample) -> PfEstimate | None:
        """Take a sample in; the particle filter's estimate if it led to one.

        Reference poses and vehicle signals are no input of a localizer and are passed over.

        Raises:
            InputError: a stereo frame, but no perception was given.
        """
        if not isinstance(sample, OdometrySample | GnssFix | Detections | StereoFrame):
            return None
        with self._fast:
            if not self._computer_clock.accept(sample.arrival_s):
                return None
            by_s = self._computer_clock.correction_s
        if by_s:
            sample = replace(
                sample, stamp_s=sample.stamp_s + by_s, arrival_s=sample.arrival_s + by_s
            )
        if isinstance(sample, OdometrySample):
            self._add_odometry(sample)
        elif isinstance(sample, GnssFix):
            self._add_fix(sample)
        elif self._particle_filter is not None:
            return self._process_view(sample)
        return None

    def add_estimate(self, estimate: PfEstimate) -> None:
        """Take in a pose of another source than the own particle filter, late as it may be.

        It passes the same clock watch, health policy and gate.
        """
        with self._fast:
            stamp = self._clocks["camera"].checked_stamp(estimate.stamp_s, estimate.arrival_s)
            if stamp is not None:
                self._poses.hold(replace(estimate, stamp_s=stamp), estimate.arrival_s)

    def start_at(self, stamp_s: float, pose: Floats, covariance: Floats) -> None:
        """Start from a known rear-axle pose `(3,)` with covariance `(3, 3)`.

        For a car that was parked where it was left, or that stands on a marked place.

        Raises:
            InputError: a pose or covariance that cannot be one, or a localizer without a map.
        """
        problem = usable_pose(stamp_s, pose, covariance)
        if problem is not None:
            raise InputError(f"start_at: the pose at {stamp_s} s cannot be used ({problem})")
        if self._particle_filter is None:
            raise InputError("start_at: this localizer has no map, so no particle filter to start")
        with self._slow:
            self._empty_inbox(self._particle_filter)
            self._particle_filter.set_pose(stamp_s, pose, covariance)

    def exchange_map(self, pole_map: PoleMap | CityMap) -> None:
        """Hold the next scans against a newer map; particles, and so the pose, stay where they are.

        May be called from any thread while samples come; `pose_at` is not kept waiting.

        Raises:
            FrameError: it is in another frame than the map so far.
            InputError: it holds no poles, or a localizer without a map.
        """
        if self._particle_filter is None:
            raise InputError("exchange_map: this localizer has no map, so no particle filter")
        if pole_map.frame != self._frame:
            raise FrameError(
                f"exchange_map: the new map is in {pole_map.frame}, the localizer in "
                f"{self._frame}; read it in that frame"
            )
        if not len(pole_map) and not (isinstance(pole_map, PoleMap) and pole_map.lines):
            raise InputError("exchange_map: the new map holds no poles; keep the one there is")
        if isinstance(pole_map, PoleMap):
            _ = pole_map.tree  # built here, so that no scan waits for it
        with self._slow:
            self._particle_filter.exchange_map(pole_map)
        with self._fast:
            self.counts["maps_exchanged"] += 1

    def pose_at(self, stamp_s: float) -> OutputPose | None:
        """The pose at `stamp_s` from what has arrived; None before the filter has started, and
        where nothing has arrived for a minute.

        Asked at rising stamps, the answers never jump but where they are flagged. For a stamp at
        or before the last one asked for, it is the filter's best knowledge of that moment.
        """
        with self._fast, self._times.of("output_tick"):
            if not is_time(stamp_s):
                self.counts["asked_not_finite"] += 1
                return None
            asked_s, stamp_s = stamp_s, stamp_s + self._computer_clock.correction_s
            self._poses.release(stamp_s)
            if not self._filter.started:
                return None
            if stamp_s - self._filter.newest.stamp_s > OUTPUT_HOLE_S:
                self.counts["asked_after_a_hole"] += 1
                return None
            state = self._filter.predicted_to(stamp_s)
            if state.stamp_s > stamp_s:
                return None
            late = stamp_s <= self._limiter.last_stamp_s
            answer = self._limiter.unlimited(state) if late else self._limiter.limit(state)
            reason = distrust(state, stamp_s, answer.covariance, self._health)
            reason = reason or self._poses.particles_distrust
            return replace(answer, stamp_s=asked_s, distrust=reason)

    def summary(self) -> dict[str, int]:
        """Counts of decisions, and of bad input by stream and kind."""
        with self._slow, self._fast:
            total: Counter[str] = Counter(self.counts)
            total.update(self._computer_clock.counts)
            for name, clock in self._clocks.items():
                total.update({f"{name}_{kind}": n for kind, n in clock.counts.items()})
            if self._particle_filter is not None:
                total.update({f"pf_{k}": n for k, n in self._particle_filter.counts.items()})
            if self._filter.started:
                total.update(self._filter.newest.counts._asdict())
            return dict(sorted(total.items()))

    # the fast half

    def _add_odometry(self, sample: OdometrySample) -> None:
        with self._fast:
            stamp = self._clocks["odometry"].checked_stamp(sample.stamp_s, sample.arrival_s)
            if stamp is None:
                return
            if not usable_odometry(sample.speed_mps, sample.yaw_rate_radps):
                self.counts["odometry_not_finite"] += 1
                return
            held = self._watch.check(stamp, sample.speed_mps, sample.yaw_rate_radps)
            self._poses.release(sample.arrival_s)
            with self._times.of("output_odometry"):
                placed = self._filter.add_odometry(
                    stamp,
                    *self._correction.rates(sample),
                    doubted=held is not None and held.speed_doubted,
                    turn_doubted=held is not None and held.turn_doubted,
                )
            count_dropped(self.counts, "odometry", placed)
            if self._particle_filter is not None:
                self._inbox.append((replace(sample, stamp_s=stamp), held))

    def _add_fix(self, fix: GnssFix) -> None:
        with self._fast:
            stamp = self._clocks["gnss"].checked_stamp(fix.stamp_s, fix.arrival_s)
            if stamp is None:
                return
            if not usable_fix(fix.east_m, fix.north_m, fix.hdop):
                self.counts["gnss_not_finite"] += 1
                return
            self._poses.release(fix.arrival_s)
            if self._fixes_out:
                placed = self._filter.add_gnss(stamp, fix.east_m, fix.north_m, fix.hdop)
                count_dropped(self.counts, "gnss", placed)
            if self._filter.started:
                state = self._filter.newest
                # what fixes have started says nothing of odometry while poles may yet do so
                judged = self._particle_filter is None or state.last_pose_s != NEVER
                if judged and fixes_disagree(state, stamp):
                    self._watch.contradict(stamp)
            if self._particle_filter is not None:
                self._inbox.append((replace(fix, stamp_s=stamp), None))

    # the slow half

    def _process_view(self, sample: Detections | StereoFrame) -> PfEstimate | None:
        assert self._particle_filter is not None
        with self._fast:
            stamp = self._clocks["camera"].checked_stamp(sample.stamp_s, sample.arrival_s)
            self._poses.release(sample.arrival_s)
        with self._slow:
            self._empty_inbox(self._particle_filter)
            if stamp is None:
                return None
            scan = self._scan_of(replace(sample, stamp_s=stamp))
            with self._times.of("particle_filter"):
                estimate = self._particle_filter.process_scan(scan)
            spent_s = self._times.last_s("particle_filter")
            correction = self._particle_filter.correction
            slip_rad_per_mps2 = self._particle_filter.slip_rad_per_mps2
        if estimate is None:
            return None
        with self._fast:
            self._correction, self._poses.slip_rad_per_mps2 = correction, slip_rad_per_mps2
            if estimate.odometry == "contradicted":
                self._watch.contradict(estimate.stamp_s)
            elif estimate.odometry == "confirmed":
                self._watch.confirm()
            self._poses.hold(estimate, sample.arrival_s, spent_s)
        return estimate

    def _empty_inbox(self, particle_filter: ParticleFilter) -> None:
        """Give the particle filter what has come since the last scan."""
        with self._fast:
            inbox = list(self._inbox)
            self._inbox.clear()
        for earlier, held in inbox:
            if isinstance(earlier, OdometrySample):
                particle_filter.add_odometry(earlier, held)
                if self._perception is not None:
                    self._perception.record_odometry(earlier)
            else:
                particle_filter.add_fix(earlier)

    def _scan_of(self, sample: Detections | StereoFrame) -> Detections:
        if isinstance(sample, Detections):
            usable = usable_poles(sample)
            self.counts["poles_not_usable"] += len(sample) - len(usable)
            if sample.lines is not None and usable.lines is not None:
                lost = len(sample.lines) - len(usable.lines)
                self.counts.update({"lines_not_usable": lost} if lost else {})
            return usable
        if self._perception is None:
            raise InputError("a stereo frame was added, but this localizer has no perception")
        with self._times.of("perception"):
            return self._perception.scan_frame(sample)
