"""What an algorithm that is not ours may return: types, shapes, finite numbers, plausible values; one function a slot.

Each takes the answer and the task and gives the slot's record in the evaluator's own types, or raises `Wrong` with what is
wrong. Nothing of an answer is used before it went through here.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from evaluator.algorithms.slots import (
    EchoTask,
    ExtrinsicTask,
    FoundCameraMounting,
    FoundEchoes,
    FoundMark,
    FoundMountings,
    FoundPanel,
    FoundVertex,
    MarkTask,
    MountingTask,
    PanelTask,
    ReflectanceTask,
    VertexTask,
)

_MOST_ECHOES = 64  # of a packet
_MOST_DN = 1e9
_MOST_PERCENT = 1000.0
_LARGEST_ARM_M = 100.0
_MOST_STD_M = 10.0


class Wrong(Exception):
    """What is wrong with an answer, a clause."""


def _fields(answer: object, record: type, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict[str, Any]:
    """The record's values by name, of the record itself or of a mapping."""
    if isinstance(answer, record):
        return {name: getattr(answer, name) for name in (*required, *optional)}
    if not isinstance(answer, Mapping):
        raise Wrong(f"returned {type(answer).__name__}, expected {record.__name__} or a mapping of its names")
    missing = [name for name in required if name not in answer]
    if missing:
        raise Wrong(f"returned no {missing[0]}, expected {', '.join(required)}")
    unknown = [str(name) for name in answer if name not in (*required, *optional)]
    if unknown:
        raise Wrong(f"returned {unknown[0][:40]!r}, which {record.__name__} does not have")
    return {name: answer[name] for name in (*required, *optional) if name in answer}


def _array(name: str, value: object, shape: tuple[int | None, ...], *, nan: bool = False) -> np.ndarray:
    """A float array of this shape (None: any length), finite."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise Wrong(f"{name} is {type(value).__name__}, not an array of numbers") from None
    if array.ndim != len(shape) or any(want is not None and want != got for want, got in zip(shape, array.shape)):
        wanted = f"({', '.join('n' if s is None else str(s) for s in shape)}{',' if len(shape) == 1 else ''})"
        raise Wrong(f"{name} has the shape {array.shape}, expected {wanted}")
    if np.isinf(array).any() or (not nan and np.isnan(array).any()):
        count = int((~np.isfinite(array)).sum())
        raise Wrong(f"{name} holds {count} of {array.size} values that are not finite")
    return array


def _number(name: str, value: object) -> float:
    return float(_array(name, value, ()))


def _rows(name: str, value: object, count: int) -> np.ndarray:
    """Distinct row numbers below `count`, rising; a mask of `count` booleans serves too."""
    array = np.asarray(value)
    if array.dtype == np.bool_ and array.shape == (count,):
        return np.flatnonzero(array)
    if array.size == 0:
        return np.empty(0, np.int64)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise Wrong(f"{name} is {array.dtype} of shape {array.shape}, expected row numbers or a mask of {count}")
    if array.min() < 0 or array.max() >= count:
        raise Wrong(f"{name} names a row outside 0 to {count - 1}")
    rows = np.unique(array).astype(np.int64)
    if rows.size != array.size:
        raise Wrong(f"{name} names a row twice")
    return rows


def _covariance(name: str, value: object, size: int) -> np.ndarray:
    """Symmetric, with variances above zero and no negative eigenvalue."""
    array = _array(name, value, (size, size))
    if not np.allclose(array, array.T, rtol=1e-6, atol=1e-6 * float(np.abs(array).max())):
        raise Wrong(f"{name} is not symmetric")
    array = 0.5 * (array + array.T)
    std = np.sqrt(np.maximum(np.diag(array), 0.0))
    if (std == 0.0).any():
        raise Wrong(f"{name} has a variance that is not above zero")
    if np.linalg.eigvalsh(array / np.outer(std, std)).min() < -1e-6:
        raise Wrong(f"{name} has a negative eigenvalue")
    return array


def _rotation(name: str, value: object) -> np.ndarray:
    array = _array(name, value, (3, 3))
    if not np.allclose(array @ array.T, np.eye(3), atol=1e-6) or np.linalg.det(array) < 0.0:
        raise Wrong(f"{name} is no rotation")
    return array


def _lever_arm(name: str, value: object) -> np.ndarray:
    array = _array(name, value, (3,))
    if np.abs(array).max() > _LARGEST_ARM_M:
        raise Wrong(f"{name} is {np.abs(array).max():.3g} m, not plausible")
    return array


def echoes(answer: object, task: EchoTask) -> FoundEchoes:
    """Sorted by packet and time."""
    given = _fields(answer, FoundEchoes, ("packet", "amplitude_dn", "centre_ns"), ("fwhm_ns", "baseline_dn"))
    packets, samples = task.samples_dn.shape
    packet = np.asarray(given["packet"])
    if packet.size == 0:
        packet = np.empty(0, np.int64)
    if packet.ndim != 1 or packet.dtype.kind not in "iu":
        raise Wrong(f"packet is {packet.dtype} of shape {packet.shape}, expected (m,) row numbers")
    if packet.size > _MOST_ECHOES * max(packets, 1):
        raise Wrong(f"{packet.size} echoes in {packets} packets, not plausible")
    if packet.size and (packet.min() < 0 or packet.max() >= packets):
        raise Wrong(f"packet names a row outside 0 to {packets - 1}")
    m = packet.size
    amplitude = _array("amplitude_dn", given["amplitude_dn"], (m,))
    centre = _array("centre_ns", given["centre_ns"], (m,))
    if m and np.abs(amplitude).max() > _MOST_DN:
        raise Wrong(f"an amplitude of {np.abs(amplitude).max():.3g} DN is not plausible")
    length = samples * task.sampling_ns
    if m and (centre.min() < -length or centre.max() > 2.0 * length):
        raise Wrong(f"a centre lies far outside its packet of {length:.0f} ns")
    width = _array("fwhm_ns", given["fwhm_ns"], (m,), nan=True) if given.get("fwhm_ns") is not None else None
    base = given.get("baseline_dn")
    order = np.lexsort((centre, packet))
    return FoundEchoes(
        packet=packet[order].astype(np.int64),
        amplitude_dn=amplitude[order],
        centre_ns=centre[order],
        fwhm_ns=None if width is None else width[order],
        baseline_dn=None if base is None else _array("baseline_dn", base, (packets,), nan=True),
    )


def panel(answer: object, task: PanelTask) -> FoundPanel:
    given = _fields(answer, FoundPanel, ("inside", "clear"), ("shift_m", "height_m"))
    count = len(task.points_m)
    inside, clear = (_rows(name, given[name], count) for name in ("inside", "clear"))
    shift = _array("shift_m", given["shift_m"], (2,)) if "shift_m" in given else np.zeros(2)
    height = None if given.get("height_m") is None else _number("height_m", given["height_m"])
    if max(np.abs(shift).max(), abs(height or 0.0)) > _MOST_STD_M:
        raise Wrong(f"moves the panel by {max(np.abs(shift).max(), abs(height or 0.0)):.3g} m, not plausible")
    return FoundPanel(inside=inside, clear=clear, shift_m=shift, height_m=height)


def mark(answer: object, task: MarkTask) -> FoundMark:
    given = _fields(answer, FoundMark, ("uv_px", "covariance_px2"))
    uv = _array("uv_px", given["uv_px"], (2,))
    size = np.array(task.grey.shape[::-1])
    if (uv < 0.0).any() or (uv > size).any():
        raise Wrong(f"uv_px {uv[0]:.1f}, {uv[1]:.1f} lies outside the image of {size[0]} x {size[1]}")
    return FoundMark(uv_px=uv, covariance_px2=_covariance("covariance_px2", given["covariance_px2"], 2))


def vertex(answer: object, task: VertexTask) -> FoundVertex:
    given = _fields(answer, FoundVertex, ("vertex_m", "covariance_m2", "used"), ("faces", "rms_m", "variance_factor"))
    place = _array("vertex_m", given["vertex_m"], (3,))
    if np.abs(place).max() > 3.0 + task.long_edge_m:
        raise Wrong(f"vertex_m is {np.abs(place).max():.3g} m from its stated place, not plausible")
    used = _rows("used", given["used"], len(task.range_m))
    if used.size < 3:
        raise Wrong(f"used names {used.size} returns, a vertex needs 3 at least")
    faces, rms = given.get("faces"), given.get("rms_m")
    factor = _number("variance_factor", given.get("variance_factor", 1.0))
    if factor <= 0.0:
        raise Wrong(f"variance_factor is {factor:g}, expected above zero")
    return FoundVertex(
        vertex_m=place,
        covariance_m2=_covariance("covariance_m2", given["covariance_m2"], 3),
        used=used,
        faces=None if faces is None else int(_number("faces", faces)),
        rms_m=None if rms is None else _number("rms_m", rms),
        variance_factor=factor,
    )


def reflectance(answer: object, task: ReflectanceTask) -> np.ndarray:
    percent = _array("the reflectance", answer, (len(task.at_amplitude_dn),))
    if percent.size and np.abs(percent).max() > _MOST_PERCENT:
        raise Wrong(f"a reflectance of {percent[np.abs(percent).argmax()]:.3g} % is not plausible")
    return percent


def mountings(answer: object, task: ExtrinsicTask) -> FoundMountings:
    given = _fields(
        answer,
        FoundMountings,
        ("camera_rotation", "camera_lever_arm_m", "lidar_rotation", "lidar_lever_arm_m", "covariance"),
    )
    return FoundMountings(
        camera_rotation=_rotation("camera_rotation", given["camera_rotation"]),
        camera_lever_arm_m=_lever_arm("camera_lever_arm_m", given["camera_lever_arm_m"]),
        lidar_rotation=_rotation("lidar_rotation", given["lidar_rotation"]),
        lidar_lever_arm_m=_lever_arm("lidar_lever_arm_m", given["lidar_lever_arm_m"]),
        covariance=_covariance("covariance", given["covariance"], 12),
    )


def camera_mounting(answer: object, task: MountingTask) -> FoundCameraMounting:
    given = _fields(answer, FoundCameraMounting, ("camera_rotation", "camera_lever_arm_m", "covariance"))
    return FoundCameraMounting(
        camera_rotation=_rotation("camera_rotation", given["camera_rotation"]),
        camera_lever_arm_m=_lever_arm("camera_lever_arm_m", given["camera_lever_arm_m"]),
        covariance=_covariance("covariance", given["covariance"], 6),
    )


CHECKS: dict[str, Callable[[object, Any], object]] = {
    "echo_decomposition": echoes,
    "panel_finding": panel,
    "mark_finding": mark,
    "vertex_estimation": vertex,
    "reflectance_model": reflectance,
    "extrinsic_solver": mountings,
    "mounting_solver": camera_mounting,
}
MAY_DECLINE = (
    "panel_finding",
    "mark_finding",
    "vertex_estimation",
)  # a text instead of a record: why nothing was found
