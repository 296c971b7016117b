"""What speaks against sensors, which of them are held for faulty, and until when."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

# how long a sensor is accused until it is held for faulty, by the window of the vote in seconds;
# window 0 is what a sensor tells of itself
PERSIST_S = {0.0: 0.0, 0.5: 0.15, 2.0: 0.3, 3.0: 0.45, 8.0: 1.0}
_TIMES, TOGETHER_S = 2, 0.16
# believed again after so long without evidence; twice as long each time it was believed too early
TRUST_S, TRUST_MOST_S = 1.0, 16.0
# two against each other: so long until the pair is told
UNDECIDED_S, _UNDECIDED_TOGETHER_S = 2.0, 0.3
_SPIKES_TOGETHER_S = 2.0


@dataclass(slots=True)
class Fault:
    """A stretch in which a sensor was held for faulty.

    Attributes:
        sensor: its name, or two names with "or" where they contradict each other and no third
            tells which.
        what: the evidence.
        from_s: stamp of the first evidence; found_s: stamp at which it was sure; to_s: stamp at
            which it was believed again, or of the last look.
        withheld: values that the estimator was not told.
    """

    sensor: str
    what: str
    from_s: float
    found_s: float
    to_s: float
    withheld: int = 0


class _Suspicion:
    """What speaks against one sensor."""

    __slots__ = ("count", "fault", "first_s", "hold_s", "last_s", "valid_s", "what", "window_s")

    def __init__(self) -> None:
        self.first_s = self.last_s = self.valid_s = float("-inf")
        self.count, self.hold_s, self.window_s = 0, TRUST_S, 0.0
        self.what = ""
        self.fault: Fault | None = None


class Suspicions:
    """Accusations against the sensors `names`.

    Attributes:
        faulty: names of those that are held for faulty now.
        faults: all stretches, in the order in which they were found.
        together_s: accusations further apart than this begin anew; the caller's beat.
    """

    def __init__(self, names: Iterable[str], faults: list[Fault]) -> None:
        self.faulty: set[str] = set()
        self.faults = faults
        self.together_s = TOGETHER_S
        self._of = {name: _Suspicion() for name in names}
        self._dispute = ("", 0.0, 0.0)

    def accuse(self, name: str, now_s: float, window_s: float, what: str) -> bool:
        """Evidence against a sensor; whether it is held for faulty from now on."""
        suspicion = self._of[name]
        if now_s - suspicion.last_s > self.together_s:
            suspicion.first_s, suspicion.count = now_s, 0
        suspicion.count += now_s > suspicion.last_s
        suspicion.last_s = max(now_s, suspicion.last_s)
        if name in self.faulty:
            return False
        lasting = suspicion.last_s - suspicion.first_s >= PERSIST_S[window_s]
        if not lasting or (window_s and suspicion.count < _TIMES):
            return False
        self.faulty.add(name)
        suspicion.window_s, suspicion.what = window_s, what
        suspicion.fault = Fault(name, what, suspicion.first_s, now_s, now_s)
        self.faults.append(suspicion.fault)
        return True

    def trust_late(self, name: str, hold_s: float) -> None:
        """A sensor is to be without evidence for so long at least."""
        self._of[name].hold_s = max(self._of[name].hold_s, hold_s)

    def still_against(self, name: str, now_s: float, window_s: float) -> None:
        """Evidence against a sensor that is faulty already; long windows remember too long."""
        if window_s <= max(self._of[name].window_s, 2.0):
            self._of[name].last_s = max(now_s, self._of[name].last_s)

    def since_s(self, name: str) -> float:
        """First evidence of the newest accusation."""
        return self._of[name].first_s

    def what(self, name: str) -> str:
        """The evidence for which a sensor was last held for faulty."""
        return self._of[name].what

    def comparable(self, name: str, start_s: float) -> bool:
        """Whether what a sensor said from `start_s` on was all said while it was sound."""
        return start_s >= self._of[name].valid_s

    def compare_from(self, names: Iterable[str], stamp_s: float) -> None:
        """What these said before is not to be compared."""
        for name in names:
            self._of[name].valid_s = stamp_s

    def acquit(self, now_s: float, *, judged: bool, alive: Callable[[str], bool]) -> set[str]:
        """Who is believed again; nobody where nothing can be `judged` now."""
        back = set()
        for name in self.faulty:
            suspicion = self._of[name]
            if suspicion.fault is not None:
                suspicion.fault.to_s = now_s
            if not judged:
                suspicion.last_s = now_s
            elif now_s - suspicion.last_s > suspicion.hold_s and alive(name):
                back.add(name)
                suspicion.valid_s = suspicion.last_s
                suspicion.hold_s = min(2.0 * suspicion.hold_s, TRUST_MOST_S)
                suspicion.fault = None
        self.faulty -= back
        return back

    def withheld(self, name: str) -> None:
        """A value of a faulty sensor was kept from the estimator."""
        fault = self._of[name].fault
        if fault is not None:
            fault.withheld += 1

    def spiked(self, name: str, what: str, now_s: float) -> None:
        """Single wild values: told, and the sensor is believed all the same."""
        for fault in reversed(self.faults[-6:]):
            if fault.sensor == name and now_s - fault.to_s < _SPIKES_TOGETHER_S:
                fault.to_s = now_s
                return
        self.faults.append(Fault(name, what, now_s, now_s, now_s))

    def undecided(self, names: set[str], now_s: float) -> None:
        """Sensors contradict each other and no third tells which is right."""
        pair = " or ".join(sorted(names))
        before, since_s, last_s = self._dispute
        if before != pair or now_s - last_s > max(_UNDECIDED_TOGETHER_S, self.together_s):
            since_s = now_s
        self._dispute = (pair, since_s, now_s)
        if now_s - since_s < UNDECIDED_S or len(names) != 2:
            return
        last = self.faults[-1] if self.faults else None
        if last is not None and last.sensor == pair and now_s - last.to_s < UNDECIDED_S:
            last.to_s = now_s
        else:
            self.faults.append(Fault(pair, "contradict each other", since_s, now_s, now_s))
