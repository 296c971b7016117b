"""The localizer at work on a stream: a thread reads, one matches, one looks, one asks."""

from __future__ import annotations

import time
from array import array
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isfinite, nan
from queue import Empty, Full, Queue
from threading import Condition, Event, Thread

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import PolemapError
from polemap.drivelog.live.arrival import StreamTime
from polemap.drivelog.live.pending import PendingFrame
from polemap.drivelog.samples import GnssFix, OdometrySample
from polemap.drivelog.streams import GnssStream, OdometryStream
from polemap.localize.config import for_car
from polemap.localize.localizer import Localizer
from polemap.localize.output_filter.limiter import OutputPose
from polemap.localize.output_trace import OutputTrace, particle_trajectory
from polemap.localize.pose_queue import PoseUpdate
from polemap.localize.replay import Run
from polemap.map.city.city_map import CityMap
from polemap.map.pole_map import PoleMap
from polemap.matching_ahead import MatchedFrame
from polemap.perception import PolePerception
from polemap.settings import Settings
from polemap.tools.follow.source import Followed, Sample

Floats = NDArray[np.float64]

# ticks further in the past than this are given up: nobody steers by them
_LATE_TICKS_S = 10.0
# views come in bursts, a chunk of the recorder at a time; one that has waited longer is passed over
# for a newer one, so that its pose still reaches the output filter within its horizon
_BEHIND_S, _MOST_WAITING = 0.3, 64
# a tick that goes out later than this after its moment is counted
_LATE_S = 0.05


# a tick further ahead than this is of a clock that no longer counts
_AHEAD_S = 1.0

# samples that wait for their time, and how often it is looked whether it has come
_MOST_HELD, _LOOK_S = 2000, 0.004
_WAIT_S = 0.1


@dataclass(frozen=True, slots=True)
class Tick:
    """One answer: the pose, when it went out on the stream's clock, and what was skipped so far."""

    answer: OutputPose
    lag_s: float
    frames_skipped: int


class Engine:
    """Localizes a stream in real time.

    Attributes:
        counts: frames looked at, skipped and unreadable; ticks late and given up.
    """

    def __init__(
        self,
        followed: Followed,
        pole_map: PoleMap | CityMap | None,
        settings: Settings,
        seed: int,
        delay_s: float = 0.0,
    ) -> None:
        """Prepare; nothing is read before `run`.

        Args:
            followed: the stream.
            pole_map: None for odometry and GNSS alone.
            settings: of the filters.
            seed: of the particle filter.
            delay_s: samples are held back, and answers asked for, so long after their time of
                recording: what comes in bursts of up to that length is in time then.
        """
        car = followed.car
        self._followed, self._rate_hz = followed, settings.localize.output.rate_hz
        self._updates: list[PoseUpdate] = []
        perception = PolePerception(car.rig, settings.polemap, stereo=settings.stereo)
        self._match = perception.matched
        self._tracker = PolePerception(car.rig, settings.polemap, stereo=settings.stereo)
        self._localizer = Localizer(
            pole_map,
            for_car(settings.localize, car.car),
            car.wheelbase_m,
            np.random.default_rng(seed),
            gnss_antenna_m=car.gnss_antenna_m,
            perception=perception if car.rig is not None else None,
            on_update=self._updates.append,
            clock=time.perf_counter,
        )
        self._delay_s = delay_s
        self._held: deque[Sample] = deque()
        self._for_tracker: deque[OdometrySample] = deque(maxlen=20_000)
        self._with_map = pole_map is not None
        self.time = StreamTime(time.monotonic)
        self.counts: Counter[str] = Counter()
        self.perception_s = nan
        self._trace = OutputTrace()
        self._odometry, self._gnss = array("d"), array("d")
        self._views: deque[PendingFrame | Detections] = deque()
        # one frame is matched while the one before is looked at and localized
        self._matched: Queue[tuple[float, MatchedFrame | Detections] | None] = Queue(maxsize=1)
        self._waiting = Condition()
        self._all_read, self._read_all, self._stop = False, False, Event()
        self._error: BaseException | None = None

    def run(
        self,
        stop: Event,
        send: Callable[[Tick], None],
        watch: Callable[[], None],
    ) -> None:
        """Until the stream ends or `stop` is set.

        Args:
            stop: ends it at the next tick.
            send: takes every answer, in this thread.
            watch: called some ten times a second, to say what is to be said.

        Raises:
            PolemapError: the stream cannot be read on.
        """
        threads = [
            Thread(target=self._guarded, args=(work,), name=name, daemon=True)
            for work, name in (
                (self._read, "reader"),
                (self._match_views, "matching"),
                (self._look, "pictures"),
            )
        ]
        sources = [threads[0]]
        if self._delay_s > 0.0:
            sources.append(Thread(target=self._guarded, args=(self._release,), daemon=True))
            threads.append(sources[1])
        for thread in threads:
            thread.start()
        period = 1.0 / self._rate_hz
        number: int | None = None
        beats = 0
        try:
            while not stop.is_set():
                ended = not any(thread.is_alive() for thread in sources)
                number = self._ticks(number, send)
                if self._error is not None or ended:
                    break
                if beats % 10 == 0:
                    watch()
                beats += 1
                stop.wait(period)
        finally:
            # also when `send` fails: a thread inside compiled code when the process ends aborts it
            self._stop.set()
            with self._waiting:
                self._read_all = True
                self._waiting.notify_all()
            for thread in threads[1:3]:
                thread.join()
        self._ticks(number, send)
        if self._error is not None:
            raise self._error

    def run_so_far(self) -> tuple[Run, Drive]:
        """What `polemap localize` makes of a recorded drive, for its summary and its files."""
        kf, output, flags, distrust = self._trace.result()
        updates = tuple(self._updates)
        run = Run(
            particle_trajectory(updates), updates, kf, output, flags, distrust,
            self._localizer.summary(), self._localizer.timings_s,
        )  # fmt: skip
        odometry = np.array(self._odometry).reshape(-1, 4)
        gnss = np.array(self._gnss).reshape(-1, 5)
        odometry = odometry[np.argsort(odometry[:, 0], kind="stable")]
        gnss = gnss[np.argsort(gnss[:, 0], kind="stable")]
        drive = replace(
            self._followed.car,
            images=None,
            frame_stamps_s=np.empty(0),
            odometry=OdometryStream(*odometry.T) if len(odometry) else None,
            gnss=GnssStream(*gnss.T) if len(gnss) else None,
            problems={**self._followed.counts, **self.counts},
        )
        return run, drive

    def _ticks(self, number: int | None, send: Callable[[Tick], None]) -> int | None:
        """Every tick that is due; the number of the next one."""
        now = self._now_s()
        if now is None:
            return None
        if number is None or number > (now + _AHEAD_S) * self._rate_hz:
            # a stream may be read to its end before it is first asked; or its clock was set back
            number = int((self.time.began_s - self._delay_s) * self._rate_hz) + 1
        oldest = int((now - _LATE_TICKS_S) * self._rate_hz)
        if number < oldest:
            self.counts["ticks_given_up"] += oldest - number
            number = oldest
        while number / self._rate_hz <= now:
            stamp = number / self._rate_hz
            number += 1
            answer = self._localizer.pose_at(stamp)
            if answer is None:
                continue
            lag_s = (self.time.now_s() or stamp) - stamp
            self.counts["ticks_late"] += lag_s - self._delay_s > _LATE_S
            self._trace.append(stamp, answer)
            send(Tick(answer, lag_s, self.counts["frames_skipped"]))
        return number

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:  # handed to the thread that asks
            self._error = error
            self._stop.set()

    # the reader

    def _read(self) -> None:
        for sample in self._followed.samples:
            if self._stop.is_set():
                break
            if self._delay_s > 0.0:
                self.time.note(_recorded_s(sample))
                self._held.append(sample)
                while len(self._held) >= _MOST_HELD and not self._stop.wait(_LOOK_S):
                    pass
            else:
                self._take(sample)
        self._all_read = True

    def _release(self) -> None:
        """Hands samples on when their time of recording and the delay have passed."""
        while not self._stop.is_set():
            now = self._now_s()
            if not self._held and self._all_read:
                return
            if now is None or not self._held or _recorded_s(self._held[0]) > now:
                self._stop.wait(_LOOK_S)
                continue
            self._take(self._held.popleft())

    def _now_s(self) -> float | None:
        """The time of what has been handed on, on the stream's clock."""
        now = self.time.now_s()
        return None if now is None else now - self._delay_s

    def _take(self, sample: Sample) -> None:
        log_s = _recorded_s(sample)
        now = self._now_s()
        sample = replace(sample, arrival_s=log_s if now is None else max(log_s, now))
        if isinstance(sample, OdometrySample):
            self._localizer.add_sample(sample)
            self._for_tracker.append(sample)
            self._odometry.extend(
                (sample.stamp_s, sample.arrival_s, sample.speed_mps, sample.yaw_rate_radps)
            )
        elif isinstance(sample, GnssFix):
            self._localizer.add_sample(sample)
            self._gnss.extend(
                (sample.stamp_s, sample.arrival_s, sample.east_m, sample.north_m, sample.hdop)
            )
        elif self._with_map:
            self._hand_over(sample)
        self.time.note(log_s)

    def _hand_over(self, view: PendingFrame | Detections) -> None:
        """A view waits for its turn; the oldest is given up where too many do."""
        with self._waiting:
            if len(self._views) == _MOST_WAITING:
                self._views.popleft()
                self.counts["frames_skipped"] += 1
            self._views.append(view)
            self._waiting.notify()

    # the pictures

    def _next_view(self) -> PendingFrame | Detections | None:
        """The oldest view that has not waited too long, else the newest; None at the end."""
        with self._waiting:
            while not self._views and not self._read_all:
                self._waiting.wait(0.5)
            now = self._now_s() or 0.0
            while len(self._views) > 1 and now - self._views[0].arrival_s > _BEHIND_S:
                self._views.popleft()
                self.counts["frames_skipped"] += 1
            return self._views.popleft() if self._views else None

    def _match_views(self) -> None:
        """One frame ahead of `_look`."""
        try:
            while (view := self._next_view()) is not None:
                begin = time.perf_counter()
                if isinstance(view, PendingFrame):
                    try:
                        self._pass_on((begin, self._match(view.decoded())))
                    except PolemapError as error:
                        self._leave_out(error)
                else:
                    self._pass_on((begin, view))
        finally:
            self._pass_on(None)

    def _pass_on(self, view: tuple[float, MatchedFrame | Detections] | None) -> None:
        passed = False
        while not passed and self._error is None:
            try:
                self._matched.put(view, timeout=_WAIT_S)
                passed = True
            except Full:
                continue

    def _look(self) -> None:
        while self._error is None:
            try:
                taken = self._matched.get(timeout=_WAIT_S)
            except Empty:
                continue
            if taken is None:
                return
            self._process(taken[1])
            spent = time.perf_counter() - taken[0]
            known = isfinite(self.perception_s)
            self.perception_s += 0.1 * (spent - self.perception_s) if known else 0.0
            self.perception_s = self.perception_s if known else spent

    def _process(self, view: MatchedFrame | Detections) -> None:
        try:
            if isinstance(view, MatchedFrame):
                self._localizer.add_sample(view)
            else:
                while self._for_tracker:
                    self._tracker.record_odometry(self._for_tracker.popleft())
                self._localizer.add_sample(self._tracker.track_scan(view))
        except PolemapError as error:
            self._leave_out(error)
            return
        self.counts["frames_looked_at"] += 1

    def _leave_out(self, error: PolemapError) -> None:
        """Damaged, or pictures that do not fit the camera."""
        self.counts["frames_unusable"] += 1
        self._followed.reasons.setdefault("frames_unusable", str(error))


def _recorded_s(sample: Sample) -> float:
    """When a recorder had a sample; its stamp where nothing says it."""
    return sample.arrival_s if isfinite(sample.arrival_s) else sample.stamp_s
