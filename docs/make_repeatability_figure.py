"""Draws docs/repeatability.svg: run `python docs/make_repeatability_figure.py`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polemap.tools.report.style import FAINT, INK, LAPS, SHADE, drawing, finish

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Three laps of a made-up road, exaggerated across: left the plan, right the deviations."""
    station = np.linspace(0.0, 60.0, 601)
    middle = 6.0 * np.sin(station / 24.0)
    slope = np.gradient(middle, station)
    normal = np.column_stack([-slope, np.ones_like(slope)]) / np.hypot(1.0, slope)[:, None]
    path = np.column_stack([station, middle])
    laps = [
        1.3 * np.sin(station / 9.0 + 0.4),
        -1.1 * np.cos(station / 11.0),
        0.9 * np.sin(station / 7.0 + 2.0) + 4.2 * np.exp(-0.5 * ((station - 42.0) / 3.5) ** 2),
    ]
    mean = np.mean(laps, axis=0)
    with drawing(7.5, 5.2) as figure:
        plan, line = figure.subplots(2, 1, height_ratios=(1.0, 1.5))
        for number, lap in enumerate(laps):
            points = path + lap[:, None] * normal
            plan.plot(*points.T, color=LAPS[number], label=f"lap {number + 1}")
        plan.plot(*path.T, color=INK, lw=1.6, ls="--", label="mean path")
        for row in range(0, 601, 50):
            ends = path[row] + np.array([[-3.0], [3.0]]) * normal[row]
            plan.plot(*ends.T, color=FAINT, lw=0.6)
        row = 200
        foot = path[row] + np.array([[0.0], [laps[0][row]]]) * normal[row]
        plan.plot(*foot.T, color=LAPS[0], lw=3.0)
        plan.annotate("d of lap 1\nat station k", foot.mean(axis=0), (8.0, 8.5), fontsize=8,
                      arrowprops={"arrowstyle": "-", "color": INK, "lw": 0.7})  # fmt: skip
        plan.set_aspect("equal")
        plan.set_title("Stations and normals of the mean path")
        plan.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
        plan.set_xticks([])
        plan.set_yticks([])
        plan.grid(visible=False)
        line.axvspan(33.0, 51.0, color=SHADE, lw=0)
        line.text(33.3, 3.6, "lap 3 evades:\nleft out", fontsize=8, color=INK)
        for number, lap in enumerate(laps):
            line.plot(station, lap, color=LAPS[number])
        kept = np.where((station > 33.0) & (station < 51.0), np.mean(laps[:2], axis=0), mean)
        line.plot(station, kept, color=INK, ls="--", lw=1.4, label="mean of the laps that count")
        for row in range(50, 600, 50):
            for lap in laps[: 2 if 330 < row < 510 else 3]:
                line.plot([station[row]] * 2, [kept[row], lap[row]], color=INK, lw=0.8)
        line.set_title(
            "Deviations from the mean of the laps (thin lines), from which s is computed"
        )
        line.set_xlabel("station k")
        line.set_ylabel("to the left of the mean path")
        line.legend(fontsize=7, loc="lower left")
        picture = finish(figure, "repeatability-definition", "Repeatability", "")
    (HERE / "repeatability.svg").write_text(
        picture.svg.replace("<style", '<rect width="100%" height="100%" fill="#fff"/><style', 1),
        encoding="utf-8",
    )


if __name__ == "__main__":
    main()
