"""Mutation fuzzing of all readers: `python -m benchmarks.campaign.readers --seconds 600`.

Every input is a valid file with a few changes. A reader may return or raise a `PolemapError`;
anything else is a finding, as are a hang (over ten seconds), a crash of the process, and memory
beyond two gigabytes. Inputs are tried in a child process, so that a crash costs one input. With
`--atheris KIND` the coverage of the reader guides the changes instead.
"""

from __future__ import annotations

import multiprocessing
import random
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import FrameType, FunctionType
from typing import Any

from benchmarks.campaign.corpus import Kind, make_corpus
from benchmarks.harness import command_line, write_results
from polemap.errors import PolemapError

HANG_S = 10
MEMORY_BYTES = 4_000_000_000
_NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")
# what has broken readers before
TOKENS = (
    b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"-1", b"0", b"9" * 50, b"9" * 5000, b"1e999",
    b"18446744073709551616", b"9223372036854775808", b"2024-13-45", b"[" * 40, b"{" * 3000, b"]",
    b"}", b"&a [*a]", b"&a", b"*a", b"<<: *a", b"!!binary x", b"!!python/none", b"? [1]", b"---",
    b"\0", b"\xff", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\\ud800", b"null", b"true", b"{}", b"[]",
    b'""', b"'", b'"', b",", b",,,,,,,,", b"\n", b"\r", b"\t", b";", b"../../..", b"a" * 300,
    b"<!DOCTYPE x>", b"=1+1", b"<script>", b"\xf0\x9f\x98\x80", b"\xff" * 8, b"\x7f" * 4,
    b"\0" * 8, b"\x00\x00\xea\x60", b"PK\x05\x06",
)  # fmt: skip


def mutated(seed: bytes, draws: random.Random) -> bytes:
    """A few changes of different kinds; the fewer the likelier."""
    data = bytearray(seed)
    for _ in range(min(1 + int(draws.expovariate(0.7)), 12)):
        at = draws.randrange(len(data) + 1)
        length = min(1 + int(draws.expovariate(0.15)), 60)
        kind = draws.randrange(10)
        if kind == 0 and data:
            data[at % len(data)] ^= 1 << draws.randrange(8)
        elif kind == 1 and data:
            data[at % len(data)] = draws.randrange(256)
        elif kind == 2:
            data[at:at] = draws.choice(TOKENS)
        elif kind == 3:
            token = draws.choice(TOKENS)
            data[at : at + len(token)] = token
        elif kind == 4:
            del data[at : at + length]
        elif kind == 5:
            other = draws.randrange(len(data) + 1)
            data[at:at] = data[other : other + length]
        elif kind == 6 and draws.random() < 0.2:
            del data[at:]
        elif kind == 7:
            data = _without_a_number(data, draws)
        elif kind == 8:
            lines = bytes(data).split(b"\n")
            rows = draws.randrange(len(lines)), draws.randrange(len(lines))
            lines[rows[0]], lines[rows[1]] = lines[rows[1]], lines[rows[0]]
            data = bytearray(b"\n".join(lines))
        else:
            data[at : at + length] = draws.randbytes(length)
    return bytes(data)


def _without_a_number(data: bytearray, draws: random.Random) -> bytearray:
    """One of the numbers in a text becomes something else."""
    found = list(_NUMBER.finditer(bytes(data)))
    if found:
        one = draws.choice(found)
        data[one.start() : one.end()] = draws.choice(TOKENS)
    return data


class Hang(BaseException):
    """A reader took too long."""


def _alarm(_number: int, _frame: FrameType | None) -> None:
    raise Hang


def attempt(kind: Kind, data: bytes) -> str | None:
    """What is wrong with how `data` was read, None if nothing is."""
    kind.file.write_bytes(data)
    signal.alarm(HANG_S)
    try:
        kind.read()
    except PolemapError as error:
        return f"message of {len(str(error))} letters" if len(str(error)) > 20_000 else None
    except Hang:
        return "hang"
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)
        places = [frame for frame in last if "polemap" in frame.filename] or last
        place = f"{Path(places[-1].filename).name}:{places[-1].lineno}"
        return f"{type(error).__name__} at {place}: {str(error)[:150]}"
    finally:
        signal.alarm(0)
    return None


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    signal.signal(signal.SIGALRM, _alarm)
    warnings.simplefilter("ignore")


def fuzz(seconds: float, seed: int, shared: Any, place: str, only: str | None) -> None:
    """Try inputs for a time; in a child process. `shared` takes counts and findings."""
    _limited()
    folder = Path(place)
    kinds = [kind for kind in make_corpus(folder) if only is None or only in kind.name]
    draws = random.Random(seed)
    ends = time.monotonic() + seconds
    tried: Counter[str] = Counter()
    spent: Counter[str] = Counter({kind.name: 0 for kind in kinds})
    while time.monotonic() < ends:
        # every kind gets the same time, so that the fast ones are tried more
        kind = min(kinds, key=lambda kind: spent[kind.name])
        begin = time.monotonic()
        for _ in range(20):
            data = mutated(kind.seed, draws)
            (folder / "last").write_bytes(kind.name.encode() + b"\0" + data)
            wrong = attempt(kind, data)
            tried[kind.name] += 1
            if wrong is not None:
                shared.put((kind.name, wrong, data))
        kind.file.write_bytes(kind.seed)
        spent[kind.name] += time.monotonic() - begin  # type: ignore[assignment]
    shared.put(("tried", dict(tried), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss))


def campaign(seconds: float, seed: int, out: Path, only: str | None = None) -> int:
    """Fuzz in child processes until the time is over; the number of different findings."""
    findings: dict[tuple[str, str], list[Any]] = {}
    tried: Counter[str] = Counter()
    peak_kb, crashes, begin = 0, 0, time.monotonic()
    round_number = 0
    while (left := seconds - (time.monotonic() - begin)) > 1.0:
        with tempfile.TemporaryDirectory(prefix="fuzz-") as place:
            context = multiprocessing.get_context("spawn")
            shared = context.SimpleQueue()
            round_number += 1
            child = context.Process(
                target=fuzz, args=(min(left, 300.0), seed + round_number, shared, place, only)
            )
            child.start()
            for name, wrong, data in _results(child, shared):
                if name == "tried":
                    tried += Counter(wrong)
                    peak_kb = max(peak_kb, data)
                    continue
                key = (name, re.sub(r"\d+", "N", wrong)[:120])
                findings.setdefault(key, [wrong, 0, data.hex()])[1] += 1
            child.join()
            if child.exitcode:
                crashes += 1
                last = (Path(place) / "last").read_bytes()
                name = last.partition(b"\0")[0].decode()
                key = (name, f"process ended with {child.exitcode}")
                findings.setdefault(key, [key[1], 0, last.partition(b"\0")[2].hex()])[1] += 1
        _write(out, seed, begin, tried, peak_kb, crashes, findings)
    for (name, _), (wrong, count, _data) in sorted(findings.items()):
        print(f"{name}: {wrong} ({count} times)")
    print(
        f"{sum(tried.values())} inputs in {_cpu_seconds() / 3600:.2f} CPU hours, "
        f"{len(findings)} findings, peak {peak_kb // 1024} MB"
    )
    return len(findings)


def _results(child: Any, shared: Any) -> Iterator[tuple[str, Any, Any]]:
    while child.is_alive() or not shared.empty():
        if shared.empty():
            time.sleep(0.05)
        else:
            yield shared.get()


def _write(
    out: Path, seed: int, begin: float, tried: Counter[str], peak_kb: int, crashes: int,
    findings: dict[tuple[str, str], list[Any]],
) -> None:  # fmt: skip
    document = {
        "seed": seed,
        "seconds": round(time.monotonic() - begin),
        # of the children that have ended: what low priority on a busy machine really got
        "cpu_seconds": round(_cpu_seconds()),
        "inputs": sum(tried.values()),
        "by_kind": dict(sorted(tried.items())),
        "peak_mb": peak_kb // 1024,
        "crashes": crashes,
        "findings": [
            {"kind": name, "wrong": wrong, "count": count, "input_hex": data[:20_000]}
            for (name, _), (wrong, count, data) in sorted(findings.items())
        ],
    }
    write_results(out, document)


def _cpu_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _functions(*packages: str) -> list[FunctionType]:
    """Functions and methods of what is imported of some packages: all of Python takes minutes."""
    found: list[FunctionType] = []
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] not in packages:
            continue
        for value in list(vars(module).values()):
            inside = vars(value).values() if isinstance(value, type) else [value]
            found += [
                one for one in inside if isinstance(one, FunctionType) and one.__module__ == name
            ]
    return found


def guided(name: str, seconds: int) -> None:
    """Let atheris drive one reader; it ends the process with a traceback at the first finding."""
    atheris: Any = import_module("atheris")
    for function in _functions("polemap", "yaml"):
        atheris.instrument_func(function)
    place = Path(tempfile.mkdtemp(prefix="fuzz-"))
    _limited()
    kind = next(kind for kind in make_corpus(place) if name in kind.name)
    seeds = place / "seeds"
    seeds.mkdir()
    (seeds / "valid").write_bytes(kind.seed)

    def one_input(data: bytes) -> None:
        wrong = attempt(kind, data)
        if wrong is not None:
            raise RuntimeError(f"{kind.name}: {wrong}")

    atheris.Setup(
        [sys.argv[0], str(seeds), f"-max_total_time={seconds}", "-rss_limit_mb=6000"], one_input
    )
    atheris.Fuzz()


def main() -> int:
    """Command line."""
    # --only takes kinds whose name holds it, --atheris a kind to guide by coverage
    chosen = command_line(
        __doc__,
        seconds=600.0,
        seed=0,
        out=Path(__file__).with_name("readers.json"),
        only=str,
        atheris=str,
    )
    if chosen.atheris:
        guided(chosen.atheris, int(chosen.seconds))
        return 0
    return 1 if campaign(chosen.seconds, chosen.seed, chosen.out, chosen.only) else 0


if __name__ == "__main__":
    sys.exit(main())
