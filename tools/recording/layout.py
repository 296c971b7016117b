"""The Foxglove layout that shows a recording: from above, picture, plots, health."""

from __future__ import annotations

from typing import Any

_SECOND_COLUMN_PERCENT = 58


def layout(*, with_pictures: bool, on_earth: bool, with_poles: bool) -> dict[str, Any]:
    """What Foxglove's "Import from file" takes."""
    panels: dict[str, Any] = {"3D!above": _view()}
    if with_poles:
        panels["Plot!poles"] = _plot("Poles matched and seen", ["/health.matched", "/health.seen"])
        panels["Plot!sd"] = _plot("Position sd (m)", ["/health.position_sd_major_m"])
        panels["DiagnosticStatusPanel!health"] = {
            "topicToRender": "/diagnostics",
            "selectedHardwareId": "polemap",
            "selectedName": "polemap: localization",
        }
    panels["Plot!speed"] = _plot(
        "Speed (m/s), yaw rate (rad/s)",
        [f"/localization/pose.twist.twist.{axis}" for axis in ("linear.x", "angular.z")],
    )
    right: Any = _stack(*(name for name in panels if name != "3D!above"))
    left: Any = "3D!above"
    if with_pictures:
        panels["Image!left"] = {
            "imageMode": {
                "imageTopic": "/camera/left/compressed",
                "calibrationTopic": "/camera/left/camera_info",
                "annotations": {"/camera/left/annotations": {"visible": True}},
            }
        }
        left = _split("Image!left", left, "column", 40)
    if on_earth:
        panels["map!place"] = {"center": None, "layer": "map", "followTopic": "/localization/fix"}
        right = _split(right, "map!place", "column", 70)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split(left, right, "row", _SECOND_COLUMN_PERCENT),
    }


def _view() -> dict[str, Any]:
    shown = ("/map/poles", "/seen/poles", "/car", "/localization/pose")
    colours = {"kf": "#2f7ed8", "pf": "#8bbc21", "reference": "#888888"}
    return {
        "cameraState": {"perspective": True, "distance": 60, "phi": 45, "thetaOffset": 90},
        "followMode": "follow-position",
        "followTf": "base_link",
        "layers": {"grid": {"layerId": "foxglove.Grid", "visible": True, "divisions": 10,
                            "size": 100, "frameId": "map", "instanceId": "grid"}},
        "topics": {
            **{topic: {"visible": True} for topic in shown},
            **{f"/path/{name}": {"visible": True, "gradient": [colour, colour], "lineWidth": 0.15}
               for name, colour in colours.items()},
        },
    }  # fmt: skip


def _plot(title: str, paths: list[str]) -> dict[str, Any]:
    return {
        "title": title,
        "paths": [
            {"value": path, "enabled": True, "timestampMethod": "receiveTime"} for path in paths
        ],
        "showLegend": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _split(first: Any, second: Any, direction: str, percent: int) -> dict[str, Any]:
    return {
        "first": first, "second": second, "direction": direction, "splitPercentage": percent,
    }  # fmt: skip


def _stack(*panels: str) -> Any:
    """Panels below one another, of one height."""
    if len(panels) == 1:
        return panels[0]
    return _split(panels[0], _stack(*panels[1:]), "column", round(100 / len(panels)))
