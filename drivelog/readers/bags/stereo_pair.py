"""Which two picture topics are left and right, and which calibration belongs to each."""

from __future__ import annotations

import re

from polemap.drivelog.readers.bags import mapping as m
from polemap.drivelog.readers.bags.index import LogIndex, Topic

# what stands in the names of left and right, the surest first
_SIDES = (
    ("left", "right"), ("l", "r"), ("00", "01"), ("0", "1"), ("02", "03"), ("2", "3"), ("1", "2"),
)  # fmt: skip
_NO_PICTURE = re.compile(
    r"depth|disparity|mask|label|semantic|segment|confidence|thumbnail|overlay|debug|annotat|theora"
)
_COMPRESSED = re.compile(r"compressed|jpe?g|png")


def guess_pair(index: LogIndex, uses: dict[str, str]) -> m.CameraPart | tuple[str, ...] | None:
    """The pair, or the left pictures of several that are as likely, or None without any."""
    pictures = []
    for name, topic in index.topics.items():
        if topic.kind != "picture" or topic.count == topic.undecodable:
            continue
        if _NO_PICTURE.search(name.lower()):
            uses[name] = "not used: by its name no picture of a camera"
        else:
            pictures.append(name)
    ranked: dict[tuple[str, str], tuple[int, ...]] = {}
    for left in pictures:
        for right in pictures:
            order = side_order(left, right)
            if order is not None:
                ranked[left, right] = _rank(index, left, right, order)
    if not ranked:
        return _by_calibration(index, pictures)
    best = max(ranked.values())
    pairs = [pair for pair, rank in ranked.items() if rank == best]
    if len(pairs) > 1:
        return tuple(left for left, _ in pairs)
    return _part(index, *pairs[0])


def side_order(left: str, right: str) -> int | None:
    """Which of the `_SIDES` tells two names apart, if nothing else does."""
    ours, theirs = _words(left), _words(right)
    if len(ours) != len(theirs):
        return None
    apart = {(a, b) for a, b in zip(ours, theirs, strict=True) if a != b}
    if len(apart) != 1:
        return None
    pair = apart.pop()
    return _SIDES.index(pair) if pair in _SIDES else None


def _words(name: str) -> list[str]:
    """`/cam0/image_raw` as cam, 0, image, raw."""
    return re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])(Left|Right)", r"\1/\2", name).lower())


def _rank(index: LogIndex, left: str, right: str, order: int) -> tuple[int, ...]:
    infos = [info_of(index, name) for name in (left, right)]
    name = left.lower()
    return (
        all(infos) and infos[0] != infos[1],
        "rect" in name and "unrect" not in name,
        not _COMPRESSED.search(name),
        not re.search("color|colour|rgb", name),
        -order,
    )


def _part(index: LogIndex, left: str, right: str) -> m.CameraPart:
    return m.CameraPart(
        left=m.CameraSide(image=left, info=info_of(index, left)),
        right=m.CameraSide(image=right, info=info_of(index, right)),
    )


def _by_calibration(index: LogIndex, pictures: list[str]) -> m.CameraPart | None:
    """Two cameras whose names say nothing: the right one's projection has the baseline."""
    found = []
    for name in pictures:
        info = info_of(index, name)
        shift = _shift(index.topics[info]) if info else None
        if shift is not None:
            found.append((shift, name))
    if len(found) != 2 or found[0][0] == found[1][0]:
        return None
    (_, right), (_, left) = sorted(found)
    return _part(index, left, right)


def _shift(info: Topic) -> float | None:
    """-baseline of a calibration, in metres."""
    projection = list(getattr(info.first, "p", getattr(info.first, "P", ())))
    if len(projection) != 12 or not projection[0] > 0:
        return None
    return float(projection[3]) / float(projection[0])


def info_of(index: LogIndex, image: str) -> str | None:
    """The calibration in the nearest namespace, or of the same frame where names do not tell."""
    ours = _words(image)
    scores: dict[str, tuple[int, int]] = {}
    for name, topic in index.topics.items():
        if topic.kind != "camera" or topic.first is None:
            continue
        theirs = _words(name)
        shared = next((n for n, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b),
                      min(len(ours), len(theirs)))  # fmt: skip
        if shared and _same_side(ours, theirs):
            scores[name] = (shared, -len(theirs))
    if not scores:
        return None
    best = max(scores.values())
    names = [name for name, score in scores.items() if score == best]
    return names[0] if len(names) == 1 else None


def _same_side(ours: list[str], theirs: list[str]) -> bool:
    """Whether no word of one is the counterpart of a word of the other."""
    for left, right in _SIDES:
        if (left in ours and right in theirs and right not in ours) or (
            right in ours and left in theirs and left not in ours
        ):
            return False
    return True
