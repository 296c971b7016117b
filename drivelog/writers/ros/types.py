"""The types of the messages that polemap writes: ROS 2's own, Foxglove's, and one for poles.

Every MCAP file carries the definitions of its messages, so that no reader has to know them.
Foxglove's are those of https://github.com/foxglove/foxglove-sdk (schemas/ros2), fields in order.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from polemap.extras import need

_FOXGLOVE = {
    "Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a",
    "Point2": "float64 x\nfloat64 y",
    "KeyValuePair": "string key\nstring value",
    "ArrowPrimitive": """geometry_msgs/Pose pose
float64 shaft_length
float64 shaft_diameter
float64 head_length
float64 head_diameter
foxglove_msgs/Color color""",
    "CubePrimitive": (
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\nfoxglove_msgs/Color color"
    ),
    "SpherePrimitive": (
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\nfoxglove_msgs/Color color"
    ),
    "CylinderPrimitive": """geometry_msgs/Pose pose
geometry_msgs/Vector3 size
float64 bottom_scale
float64 top_scale
foxglove_msgs/Color color""",
    "LinePrimitive": """uint8 type
geometry_msgs/Pose pose
float64 thickness
bool scale_invariant
geometry_msgs/Point[] points
foxglove_msgs/Color color
foxglove_msgs/Color[] colors
uint32[] indices""",
    "TriangleListPrimitive": """geometry_msgs/Pose pose
geometry_msgs/Point[] points
foxglove_msgs/Color color
foxglove_msgs/Color[] colors
uint32[] indices""",
    "TextPrimitive": """geometry_msgs/Pose pose
bool billboard
float64 font_size
bool scale_invariant
foxglove_msgs/Color color
string text""",
    "ModelPrimitive": """geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
foxglove_msgs/Color color
bool override_color
string url
string media_type
uint8[] data""",
    "SceneEntityDeletion": "builtin_interfaces/Time timestamp\nuint8 type\nstring id",
    "SceneEntity": """builtin_interfaces/Time timestamp
string frame_id
string id
builtin_interfaces/Duration lifetime
bool frame_locked
foxglove_msgs/KeyValuePair[] metadata
foxglove_msgs/ArrowPrimitive[] arrows
foxglove_msgs/CubePrimitive[] cubes
foxglove_msgs/SpherePrimitive[] spheres
foxglove_msgs/CylinderPrimitive[] cylinders
foxglove_msgs/LinePrimitive[] lines
foxglove_msgs/TriangleListPrimitive[] triangles
foxglove_msgs/TextPrimitive[] texts
foxglove_msgs/ModelPrimitive[] models""",
    "SceneUpdate": (
        "foxglove_msgs/SceneEntityDeletion[] deletions\nfoxglove_msgs/SceneEntity[] entities"
    ),
    "CircleAnnotation": """builtin_interfaces/Time timestamp
foxglove_msgs/Point2 position
float64 diameter
float64 thickness
foxglove_msgs/Color fill_color
foxglove_msgs/Color outline_color""",
    "PointsAnnotation": """builtin_interfaces/Time timestamp
uint8 type
foxglove_msgs/Point2[] points
foxglove_msgs/Color outline_color
foxglove_msgs/Color[] outline_colors
foxglove_msgs/Color fill_color
float64 thickness""",
    "TextAnnotation": """builtin_interfaces/Time timestamp
foxglove_msgs/Point2 position
string text
float64 font_size
foxglove_msgs/Color text_color
foxglove_msgs/Color background_color""",
    "ImageAnnotations": """foxglove_msgs/CircleAnnotation[] circles
foxglove_msgs/PointsAnnotation[] points
foxglove_msgs/TextAnnotation[] texts""",
}  # fmt: skip
_POLEMAP = {
    # poles that a detector reports at one moment, in the frame of the header (the vehicle's)
    "Pole": """float64 x_m
float64 y_m
float64 var_x_m2
float64 var_y_m2
float64 cov_xy_m2
float64 width_m
float64 probability""",
    "PoleScan": "std_msgs/Header header\npolemap_msgs/Pole[] poles",
    # what a particle filter's pose rests on; healthy is 0 or 1, NaN what is not known
    "Health": """std_msgs/Header header
float64 matched
float64 seen
float64 in_view
float64 n_eff
float64 position_sd_major_m
float64 healthy""",
}


class MessageTypes:
    """Makes, serializes (CDR) and describes messages by the names of their types."""

    def __init__(self) -> None:
        typesys: Any = need("rosbags.typesys")
        self._store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        for package, definitions in (("foxglove_msgs", _FOXGLOVE), ("polemap_msgs", _POLEMAP)):
            known: dict[str, Any] = {}
            for name, text in definitions.items():
                known |= typesys.get_types_from_msg(text, f"{package}/msg/{name}")
            self._store.register(known)

    def make(self, type_name: str, **fields: Any) -> Any:
        """A message of a type such as `nav_msgs/msg/Odometry`; every field must be given."""
        return self._store.types[type_name](**fields)

    def serialize(self, message: Any) -> bytes:
        """The message as CDR."""
        return bytes(self._store.serialize_cdr(message, message.__msgtype__))

    def definition(self, type_name: str) -> str:
        """The definition of a type and of all that it is made of, as MCAP's `ros2msg` wants it."""
        text: str = self._store.generate_msgdef(type_name, ros_version=2)[0]
        return text


@cache
def message_types() -> MessageTypes:
    """The types; made once, which takes half a second.

    Raises:
        MissingExtraError: rosbags is not installed.
    """
    return MessageTypes()


def type_of(message: Any) -> str:
    """The name of a message's type."""
    name: str = message.__msgtype__
    return name


def named_values(values: Mapping[str, str]) -> list[Any]:
    """Pairs for `metadata` of Foxglove's messages."""
    make = message_types().make
    return [make("foxglove_msgs/msg/KeyValuePair", key=k, value=v) for k, v in values.items()]
