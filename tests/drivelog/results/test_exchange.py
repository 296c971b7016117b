"""Whatever interrupts the exchange, and wherever: the old result or the new one stands whole."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from polemap.drivelog.atomic import MARKER, atomic_folder
from polemap.drivelog.results import exchange

NAMES = [f"{number:02d}" for number in range(12)]


def write(target: Path, content: str) -> None:
    with atomic_folder(target, "run") as part:
        (part / "deeper").mkdir()
        for name in NAMES:
            (part / "deeper" / name).write_text(content)


def whole(target: Path) -> str:
    """The one content of all files; the test fails where some are missing or of another time."""
    found = {path.name: path.read_text() for path in (target / "deeper").iterdir()}
    assert sorted(found) == NAMES
    assert (target / MARKER).is_file()
    (content,) = set(found.values())
    return content


class Interrupting:
    """Raises KeyboardInterrupt just before or just after the n-th call of what it watches."""

    def __init__(self, number: int, *, before: bool) -> None:
        self.left, self.before, self.fired = number, before, False

    def watch(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def watched(*arguments: Any, **options: Any) -> Any:
            self.left -= 1
            due = self.left == 0
            self.fired = self.fired or due
            if due and self.before:
                raise KeyboardInterrupt
            result = call(*arguments, **options)
            if due:
                raise KeyboardInterrupt
            return result

        return watched


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize("swaps", [True, False])
def test_an_interrupt_at_any_step_leaves_one_of_the_two(
    swaps: bool, before: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not swaps:
        monkeypatch.setattr(exchange, "_swap", None)
    elif exchange._swap is None:
        pytest.skip("this system cannot swap two names")
    seen = set()
    for number in range(1, 200):
        target = tmp_path / f"{number}" / "run"
        write(target, "old")
        fault = Interrupting(number, before=before)
        with monkeypatch.context() as patch:
            for name in ("rename", "replace", "rmdir", "unlink", "mkdir", "open", "scandir"):
                patch.setattr(os, name, fault.watch(getattr(os, name)))
            if swaps:
                patch.setattr(exchange, "_swap", fault.watch(exchange._swap))
            try:
                write(target, "new")
            except KeyboardInterrupt:
                assert fault.fired
        seen.add(whole(target))
        # the next run finishes and tidies what this one left
        write(target, "newest")
        assert whole(target) == "newest"
        assert [path.name for path in target.parent.iterdir()] == ["run"]
        if not fault.fired:
            break
    else:
        pytest.fail("there are more steps than expected")
    assert seen == {"old", "new"}


def test_a_kill_between_two_renames_is_finished_by_the_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "run"
    write(target, "old")
    place = tmp_path / "place"
    with atomic_folder(tmp_path / "made", "run") as part:
        (part / "deeper").mkdir()
        for name in NAMES:
            (part / "deeper" / name).write_text("new")
    place.mkdir()
    (tmp_path / "made").rename(place / exchange.READY)
    target.rename(place / exchange.REPLACED)
    (place / exchange.JOURNAL).write_text("run")
    exchange.finish_exchange(place, tmp_path)
    assert whole(target) == "new"
    # without the new folder the old one comes back
    target.rename(place / exchange.READY)
    (place / exchange.READY).rename(tmp_path / "elsewhere")
    (place / exchange.JOURNAL).write_text("run")
    exchange.finish_exchange(place, tmp_path)
    assert whole(target) == "old"


@pytest.mark.parametrize("number", [22, 38, 95])
def test_a_system_without_the_call_renames_and_one_that_refuses_says_so(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exchange, "_swap", lambda _first, _second: number)
    target = tmp_path / "run"
    write(target, "old")
    write(target, "new")
    assert whole(target) == "new"
    monkeypatch.setattr(exchange, "_swap", lambda _first, _second: 5)
    with pytest.raises(OSError, match="Input/output error"):
        write(target, "newest")
    assert whole(target) == "new"


@pytest.mark.parametrize("swaps", [True, False])
def test_a_kill_at_any_moment_loses_nothing(swaps: bool, tmp_path: Path) -> None:
    target = tmp_path / "run"
    write(target, "first")
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from polemap.drivelog.results import exchange\n"
        "from tests.drivelog.results.test_exchange import write\n"
        f"{'' if swaps else 'exchange._swap = None'}\n"
        "print('at work', flush=True)\n"
        "for number in range(100000):\n"
        "    write(Path(sys.argv[1]), str(number))\n"
    )
    draws = random.Random(0)
    for _ in range(4):
        with subprocess.Popen(
            [sys.executable, "-c", program, str(target)], stdout=subprocess.PIPE
        ) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(draws.uniform(0.0, 0.1))
            process.send_signal(signal.SIGKILL)
        if swaps:
            whole(target)
        write(target, "next")
        assert whole(target) == "next"
        assert [path.name for path in tmp_path.iterdir()] == ["run"]
