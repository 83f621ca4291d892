"""Names of parameters and figures for people: code names in words, Chinese or English.

The names themselves stand in `term_table`, sentences in `texts`.
"""

import re

from evaluator.documents.model import Language, say
from evaluator.report.term_table import NAMES

_SENSORS = {
    "camera_from_lidar": "激光雷达→相机",
    "boards_camera": "相机（标定板）",
    "camera": "相机",
    "lidar": "激光雷达",
}
_AXES = {"roll": "横滚", "pitch": "俯仰", "yaw": "偏航", "x": "x", "y": "y", "z": "z"}
_KINDS = {"boresight": "安置角误差", "lever_arm": "偏心分量"}
_MOUNTING = re.compile(
    r"(camera_from_lidar|boards_camera|camera|lidar)_(?:(boresight|lever_arm)_)?(roll|pitch|yaw|x|y|z)"
)
_STRIPS = (
    (re.compile(r"^opposite heading$"), "对向航线"),
    (re.compile(r"^perpendicular heading$"), "垂直航向的航线"),
    (re.compile(r"^another height \((.+) m\)$"), r"另一航高（\1 m）"),
    (re.compile(r"^another speed \((.+) m/s\)$"), r"另一速度（\1 m/s）"),
)
_METHODS = (
    (re.compile(r"^bootstrap over images, (\d+) fixed draws.*$"), r"对影像自助法重抽样 \1 次（标定结果固定）"),
    (
        re.compile(r"^propagation of the covariance of the corrected ranges.*$"),
        "由改正后测距与相对真值的协方差（扫描与读数离散、证书、归心元素、K₂ 和 R₂）传播至 m_j，正态分布",
    ),
    (re.compile(r"^bootstrap over (\d+) panels, (\d+) resamples$"), r"对 \1 个标准反射靶标自助法重抽样 \2 次"),
    (re.compile(r"^bootstrap over targets and strips, (\d+) draws$"), r"对靶标与航线自助法重抽样 \1 次"),
    (
        re.compile(r"^chi-square with n - 1 degrees of freedom for the worst channel.*$"),
        "最大波段的 χ² 分布（自由度 n − 1，各影像偏差视为独立正态）；标准差 = 数值 / √(2(n − 1))",
    ),
)


def parameter(name: str, language: Language) -> str:
    """A parameter's or figure's code name in words."""
    if name in NAMES:
        return say(language, *NAMES[name])
    found = _MOUNTING.fullmatch(name)
    if language == "zh" and found:
        sensor, kind, axis = found.groups()
        if kind is None and sensor != "camera_from_lidar":
            return name.replace("_", " ")
        return " ".join(p for p in (_SENSORS[sensor], _KINDS.get(kind or "", ""), _AXES[axis]) if p)
    if language == "zh" and name.startswith("camera_"):
        return f"相机 {name.removeprefix('camera_').removesuffix('_px')}"
    return name.replace("_", " ")


def strip(name: str, language: Language) -> str:
    """A strip that would help, as `helping_strip` names it."""
    return _translated(name, _STRIPS) if language == "zh" else name


def method(text: str, language: Language) -> str:
    """How an interval was computed; an unknown way stays English."""
    return _translated(text, _METHODS) if language == "zh" else text


def short(name: str, language: Language) -> str:
    """A mounting parameter for the axes of a matrix: sensor and axis, which say enough there."""
    found = _MOUNTING.fullmatch(name)
    if not found:
        return parameter(name, language)
    sensor, _, axis = found.groups()
    if sensor in ("camera_from_lidar", "boards_camera"):
        return _AXES[axis] if language == "zh" else axis
    return f"{_SENSORS[sensor]} {_AXES[axis]}" if language == "zh" else f"{sensor} {axis}"


def _translated(text: str, table: tuple[tuple[re.Pattern[str], str], ...]) -> str:
    for pattern, words in table:
        found = pattern.match(text)
        if found:
            return found.expand(words)
    return text
