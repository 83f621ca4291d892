"""Words of a plan in Chinese: its statuses and the rows that are its own. Those of the evaluator: `evaluator.documents.phrases`."""

import re

from evaluator.documents.model import Language, say
from evaluator.documents.phrases import translated
from testrange.plan.remedies import REMEDIES_ZH

__all__ = ["STATUS", "own", "say"]

STATUS: dict[str, tuple[str, str]] = {
    "pass": ("符合", "pass"),
    "fail": ("不符合", "FAIL"),
    "warning": ("注意", "warning"),
    "not_applicable": ("不适用", "n/a"),
    "not_recorded": ("未记录", "no record"),
    "after": ("检测后判定", "after"),
}

# English with groups -> Chinese. The whole text must match.
_OWN: tuple[tuple[str, str], ...] = (
    ("physics", "物理条件"),
    ("configuration", "配置"),
    ("the campaign can be built as configured", "按配置可以建立检测场与飞行"),
    (
        r"faces of the frustums \(6\.2\.2 c, d\) measured as planes that meet in a vertex",
        "棱台各面（6.2.2 c、d）可测为交于公共顶点的平面",
    ),
    (
        r"(\d+) of (\d+) targets, (\d+) of (\d+) passes give a vertex",
        r"\2 个靶标中 \1 个、\4 次扫过中 \3 次可得顶点",
    ),
    (
        r"(\d+) points on a face on average, (\d+) at least \((\w+), sortie (\d+) strip (\d+)\)",
        r"每面平均 \1 点，最少 \2 点（\3，第 \4 架次第 \5 航线）",
    ),
    (r"(\d+) passes: footprint of ([\d.]+) m on faces ([\d.]+) m wide", r"\1 次扫过：光斑 \2 m，面宽仅 \3 m"),
    (r"(\d+) passes: (\d+) returns near the target", r"\1 次扫过：靶标附近仅 \2 个回波"),
    (r"(\d+) passes: (\d+) clean returns on the faces", r"\1 次扫过：各面上可用回波仅 \2 个"),
    (r"(\d+) scans of (\d+) panels", r"每个标准反射靶标扫描 \1 次，共 \2 个"),
    (
        r"three faces with 6 clean points or more, of (\d+) targets or more",
        r"不少于 \1 个靶标，各有三个面、每面不少于 6 点",
    ),
    ("longest slant range to the ground unambiguous", "至地面最长斜距不模糊"),
    (r"≤ ([\d.]+) m, c/\(2·PRR\) with (\d+) channels in turn", r"≤ \1 m，c/(2·PRR)，\2 通道轮流"),
    ("lowest height within the LiDAR's range", "最低航高在激光雷达测程之内"),
    (r"> ([\d.]+) m, its shortest range", r"> \1 m（最短测程）"),
    (
        r"LiDAR's sector \((.*) to (.*)\) passes over every target and echoes return",
        r"激光扫描角 \1 至 \2 扫过全部靶标且有回波",
    ),
    ("every target in every sortie", "每架次全部靶标"),
    ("echoes of the panels between detection threshold and saturation", "标准反射靶标回波介于检测阈值与饱和之间"),
    ("motion blur of the images", "像移"),
    (r"([\d.]+) px at ([\d.]+) m, exposure (.*) s", r"航高 \2 m、曝光 \3 s 时 \1 px"),
    ("no panel saturates the camera", "标准反射靶标影像不饱和"),
    (r"(\d+) % of full scale \((.*)\)", r"满量程的 \1 %（\2）"),
    (
        r"farthest panel of the ranging line \(9\.1\.2 a\) within the unambiguous range",
        "测距基线最远标准反射靶标（9.1.2 a）在不模糊距离之内",
    ),
    (
        r"footprint on the farthest panel of the ranging line \(9\.1\.2 a\)",
        "测距基线最远标准反射靶标（9.1.2 a）上的光斑",
    ),
    (r"≤ ([\d.]+) m, half the panel", r"≤ \1 m，标准反射靶标之半"),
    (
        r"enlarge targets\.frustums\.long_edge_m \((.*) m\), fly lower or slower, or use a LiDAR with .*",
        r"加大 targets.frustums.long_edge_m（现 \1 m）、降低航高或航速，或改用光束更窄、频率更高的激光雷达",
    ),
    (r"begin between (\S+) and (\S+) Beijing time", r"首条航线应在 \1 至 \2（北京时间）开始"),
    (r"sortie (\d+): (\d+) of (\d+)( \(not [^;]*\))?", r"第 \1 架次：\2/\3\4"),
    (r"(\d+) DN \((\w+)\) to (\d+) DN \((\w+)\)", r"\1 DN（\2）至 \3 DN（\4）"),
    (r"(\d+) to (\d+) DN", r"\1 至 \2 DN"),
    (r"([\d.]+) m at ([\d.]+) m", r"\2 m 处 \1 m"),
    (
        r"fly at (\d+) m or lower, or lower lidar\.prr_hz to (\d+)",
        r"航高降至 \1 m 以下，或将 lidar.prr_hz 降至 \2",
    ),
    (r"(.*) as the first strip begins", r"首条航线开始时 \1"),
)
_COMPILED = tuple((re.compile(pattern), words) for pattern, words in _OWN)


def own(text: str, language: Language) -> str:
    """A text of a plan in the reader's language; one that is not known stays English."""
    if language == "en":
        return text
    whole = _known(text)
    if whole is not None:
        return whole
    parts = text.split("; ")
    if len(parts) > 1 and any(_known(part) is not None for part in parts):
        return "；".join(own(part, language) for part in parts)
    return translated(text, language)


def _known(text: str) -> str | None:
    """A text that is the plan's own, in Chinese."""
    if text in REMEDIES_ZH:
        return REMEDIES_ZH[text]
    for pattern, words in _COMPILED:
        found = pattern.fullmatch(text)
        if found:
            return found.expand(words)
    return None
