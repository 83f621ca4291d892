"""ROS 2 messages as bytes: XCDR1, little endian, and their definitions as text. Nothing of a campaign in here.

Definitions are those of common_interfaces (std_msgs, geometry_msgs, sensor_msgs) and geometry2 (tf2_msgs), comments left out.
"""

import struct

import numpy as np

_TIME = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec")
_HEADER = ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id")
_VECTOR = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z")
_QUATERNION = ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w")
_POINT = ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z")
_POSE = ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation")
_TRANSFORM = ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation")
_STAMPED = (
    "geometry_msgs/TransformStamped",
    "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
)
_FIELD = ("sensor_msgs/PointField", "string name\nuint32 offset\nuint8 datatype\nuint32 count")
_REGION = (
    "sensor_msgs/RegionOfInterest",
    "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify",
)


def _definition(text: str, *parts: tuple[str, str]) -> str:
    return text + "".join(f"\n{'=' * 80}\nMSG: {name}\n{body}" for name, body in parts) + "\n"


# type name -> definition with those that it refers to
DEFINITIONS = {
    "tf2_msgs/msg/TFMessage": _definition(
        "geometry_msgs/TransformStamped[] transforms", _STAMPED, _HEADER, _TIME, _TRANSFORM, _VECTOR, _QUATERNION
    ),
    "geometry_msgs/msg/PoseStamped": _definition(
        "std_msgs/Header header\ngeometry_msgs/Pose pose", _HEADER, _TIME, _POSE, _POINT, _QUATERNION
    ),
    "sensor_msgs/msg/CompressedImage": _definition(
        "std_msgs/Header header\nstring format\nuint8[] data", _HEADER, _TIME
    ),
    "sensor_msgs/msg/CameraInfo": _definition(
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
        "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi",
        _HEADER,
        _TIME,
        _REGION,
    ),
    "sensor_msgs/msg/PointCloud2": _definition(
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
        "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense",
        _HEADER,
        _TIME,
        _FIELD,
    ),
}
_POINT_FIELD_TYPES = {"<f4": 7, "<f8": 8}


class _Stream:
    """Values in order, each aligned to its own size; alignment counts from behind the encapsulation header."""

    def __init__(self) -> None:
        self._out = bytearray()

    def content(self) -> bytes:
        return b"\0\1\0\0" + bytes(self._out)

    def align(self, size: int) -> None:
        self._out += bytes(-len(self._out) % size)

    def put(self, form: str, *values: float | int | bool) -> None:
        """Values of one struct format character."""
        size = struct.calcsize(f"<{form}")
        for value in values:
            self.align(size)
            self._out += struct.pack(f"<{form}", value)

    def text(self, text: str) -> None:
        raw = text.encode() + b"\0"
        self.put("I", len(raw))
        self._out += raw

    def blob(self, data: bytes) -> None:
        self.put("I", len(data))
        self._out += data

    def header(self, time_ns: int, frame: str) -> None:
        self.put("i", time_ns // 1_000_000_000)
        self.put("I", time_ns % 1_000_000_000)
        self.text(frame)


def transform(time_ns: int, parent: str, child: str, translation_m: np.ndarray, xyzw: np.ndarray) -> bytes:
    """tf2_msgs/TFMessage with one transform: parent_from_child."""
    s = _Stream()
    s.put("I", 1)
    s.header(time_ns, parent)
    s.text(child)
    s.put("d", *translation_m.tolist(), *xyzw.tolist())
    return s.content()


def pose(time_ns: int, frame: str, position_m: np.ndarray, xyzw: np.ndarray) -> bytes:
    """geometry_msgs/PoseStamped."""
    s = _Stream()
    s.header(time_ns, frame)
    s.put("d", *position_m.tolist(), *xyzw.tolist())
    return s.content()


def compressed_image(time_ns: int, frame: str, data: bytes, kind: str = "jpeg") -> bytes:
    """sensor_msgs/CompressedImage."""
    s = _Stream()
    s.header(time_ns, frame)
    s.text(kind)
    s.blob(data)
    return s.content()


def camera_info(time_ns: int, frame: str, size: tuple[int, int], k: np.ndarray, distortion: list[float]) -> bytes:
    """sensor_msgs/CameraInfo: size (width, height), K (3, 3), plumb_bob k1 k2 p1 p2 k3."""
    s = _Stream()
    s.header(time_ns, frame)
    s.put("I", size[1], size[0])
    s.text("plumb_bob")
    s.put("I", len(distortion))
    s.put("d", *distortion)
    s.put("d", *k.ravel().tolist(), *np.eye(3).ravel().tolist())
    s.put("d", *np.hstack([k, np.zeros((3, 1))]).ravel().tolist())
    s.put("I", 0, 0, 0, 0, 0, 0)  # no binning, the whole image
    s.put("?", False)
    return s.content()


def point_cloud(time_ns: int, frame: str, table: np.ndarray) -> bytes:
    """sensor_msgs/PointCloud2 of a structured array (n,) of float32 and float64 fields."""
    s = _Stream()
    s.header(time_ns, frame)
    s.put("I", 1, len(table))
    fields = table.dtype.fields
    assert fields is not None
    s.put("I", len(fields))
    for name, (kind, offset, *_) in fields.items():
        s.text(name)
        s.put("I", offset)
        s.put("B", _POINT_FIELD_TYPES[kind.str])
        s.put("I", 1)
    s.put("?", False)
    s.put("I", table.dtype.itemsize, table.nbytes)
    s.blob(table.tobytes())
    s.put("?", False)  # NaN may stand among reflectances
    return s.content()
