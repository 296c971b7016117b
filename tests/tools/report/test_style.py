"""Pictures of the pages: one for a wide screen, one for a phone."""

from __future__ import annotations

import re

from polemap.tools.report.style import Picture, drawing, finish, legend_above, tidy

LONG = "Normalized error of the output filter: mean 518.66, 100.0 % above 99 %"


def picture(labels: tuple[str, ...], *, even: bool = False) -> Picture:
    with drawing(8.0, 6.0) as figure:
        _, axes = figure.subplots(2, 1)
        for label in labels:
            axes.plot([0.0, 10.0], [0.0, 1.0], label=label)
        if even:
            axes.set_aspect("equal")
        tidy(axes, "x", "y", LONG)
        legend_above(axes)
        return finish(figure, "key", "Title", "Caption")


def size(svg: str) -> tuple[float, float]:
    found = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg)
    assert found is not None
    return float(found[1]), float(found[2])


def test_a_phone_gets_a_narrow_picture_with_text_of_the_same_size() -> None:
    labels = ("tracking", "particle filter, an update", "output filter, a pose taken in")
    made = picture(labels)
    assert size(made.inline) == (576.0, 432.0)
    assert size(made.narrow) == (295.2, 432.0)
    for text in (*labels, "x", "y"):
        assert made.narrow.count(f">{text}</text>") == 1
    fonts = [set(re.findall(r"font-size: ([\d.]+px)", svg)) for svg in (made.inline, made.narrow)]
    assert fonts[0] == fonts[1] != set()
    # a title that is too long for the line goes on in the next
    assert f">{LONG}<" in made.inline
    assert f">{LONG}<" not in made.narrow
    assert not set(re.findall(r'id="([^"]+)"', made.inline)) & set(
        re.findall(r'id="([^"]+)"', made.narrow)
    )


def test_a_map_keeps_its_shape() -> None:
    made = picture(("way",), even=True)
    width, height = size(made.narrow)
    assert abs(height / width - 432.0 / 576.0) < 1e-3
