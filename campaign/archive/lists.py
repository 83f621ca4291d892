"""What an archive says of itself: item list of 10.3 a-e (CSV, HTML), test items, RO-Crate metadata. Text only, no files copied."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

from campaign.archive.font import font_face
from campaign.formats.text import read_bounded
from campaign.manifest import Manifest

CATEGORIES = {
    "a": ("检测项目清单", "item list"),
    "b": ("光学遥感影像数据", "images of the optical sensor"),
    "c": ("激光雷达点云数据", "LiDAR point clouds"),
    "d": ("检测报告", "test report"),
    "e": ("其他资料", "other material"),
}
MAX_RESULTS_BYTES = 50_000_000
_MIME = {
    ".csv": "text/csv",
    ".docx": "application/vnd.openxmlformats-officedocument.wordprocessingml.document",
    ".html": "text/html",
    ".jpg": "image/jpeg",
    ".json": "application/json",
    ".las": "application/vnd.las",
    ".laz": "application/vnd.laszip",
    ".pdf": "application/pdf",
    ".ply": "model/ply",
    ".png": "image/png",
    ".tif": "image/tiff",
    ".tiff": "image/tiff",
    ".toml": "application/toml",
    ".txt": "text/plain",
}
# First match of (start, part of the path, suffixes) says what a file of the campaign is: category, Chinese, English.
_CONTENT: tuple[tuple[str, str, tuple[str, str, str]], ...] = (
    ("sorties/", "/images/exposures.csv", ("b", "曝光记录", "exposures")),
    ("sorties/", "/images/", ("b", "影像", "image")),
    ("sorties/", "/lidar/", ("c", "航线点云", "point cloud of a strip")),
    ("ranging/scans/", "", ("c", "测距检测扫描", "scan of the ranging line")),
    ("ranging/", "", ("e", "测距检测观测记录", "readings of the ranging line")),
    ("bench/", ".csv", ("b", "室内检测影像记录", "log of a bench's images")),
    ("bench/", ".json", ("e", "室内检测条件", "conditions of a bench")),
    ("bench/", "", ("b", "室内检测影像", "image of a bench")),
    ("sorties/", "/trajectory", ("e", "航迹", "trajectory")),
    ("sorties/", "/smrmsg", ("e", "航迹精度", "accuracy of the trajectory")),
    ("sorties/", "/observations", ("e", "观测记录", "observations of targets")),
    ("sorties/", "/environment", ("e", "环境记录", "environment")),
    ("survey/", "", ("e", "检测场测量资料", "survey of the range")),
    ("sensors/", "", ("e", "传感器资料", "sensors' sheets")),
    ("plan.json", "", ("e", "飞行计划", "flight plan")),
    ("manifest.json", "", ("e", "文件清单与坐标、时间系统", "list of files, frames and time systems")),
    ("truth/", "", ("e", "仿真真值", "truth of the simulation")),
)


@dataclass(frozen=True, kw_only=True)
class Item:
    """One payload file; `path` is relative to data/."""

    path: str
    size: int
    sha256: str

    @property
    def content(self) -> tuple[str, str, str]:
        """Category a-e of 10.3, and what the file is in Chinese and English."""
        if self.path.startswith("results/"):
            return "d", "检测报告与结果", "report and results"
        inner = self.path.removeprefix("campaign/")
        for start, part, content in _CONTENT:
            if inner.startswith(start) and part in inner:
                return content
        return "e", "其他", "other"


OWN = (
    ("item_list.csv", "归档清单", "list of the archive's files"),
    ("item_list.html", "归档清单", "list of the archive's files"),
    ("test_items.csv", "检测项目", "test items with results"),
    ("ro-crate-metadata.json", "元数据", "metadata (RO-Crate 1.1)"),
)


def item_csv(items: Sequence[Item]) -> str:
    """item_list.csv; begins with a byte order mark, so that spreadsheets show Chinese."""
    rows: list[Sequence[object]] = [("category", "类别", "path", "bytes", "sha256", "内容", "content")]
    rows += [("a", CATEGORIES["a"][0], name, "", "", zh, en) for name, zh, en in OWN]
    for item in _sorted(items):
        category, zh, en = item.content
        rows.append((category, CATEGORIES[category][0], item.path, item.size, item.sha256, zh, en))
    return "\ufeff" + _csv(rows)


def indicators_csv(manifest: Manifest, results: Path | None) -> str:
    """test_items.csv: every indicator with value and grade, as in results.json; without results the header alone."""
    rows: list[Sequence[object]] = [("campaign", "id", "clause", "名称", "name", "value", "unit", "等级", "grade")]
    for key, block in _indicators(results).items():
        cells = (block.get(k) for k in ("clause", "name_zh", "name", "value", "unit", "grade_zh", "grade"))
        rows.append((manifest.campaign, key, *("" if c is None else c for c in cells)))
    return "\ufeff" + _csv(rows)


def item_html(manifest: Manifest, items: Sequence[Item], results: Path | None) -> str:
    """item_list.html: one readable page, Chinese and English, nothing loaded from elsewhere."""
    title = f"{manifest.campaign} 归档清单 / archive"
    out = [
        '<!doctype html>\n<html lang="zh">\n<head>\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<h1>{escape(title)}</h1>",
        f"<p>{escape(manifest.title)} · {escape(manifest.start_time)} · GB/T 41450-2022, 10.3</p>",
    ]
    if manifest.synthetic:
        out.append("<p><strong>虚拟检测场仿真数据 / synthetic data of a virtual range</strong></p>")
    out.append("<h2>检测项目 / test items</h2>")
    out.append(_test_items(results))
    out.append("<h2>归档材料 / material</h2>")
    head = ("", "内容", "content", "文件 / files", "字节 / bytes")
    out.append(_table(head, [_total(c, items) for c in CATEGORIES], numbers=2))
    for category, (zh, en) in CATEGORIES.items():
        rows: list[tuple[object, ...]] = [(n, z, e, "") for n, z, e in OWN] if category == "a" else []
        rows += [(i.path, *i.content[1:], f"{i.size:,}") for i in _sorted(items) if i.content[0] == category]
        if rows:
            out.append(f"<h3>{category}) {zh} / {en}</h3>")
            out.append(_table(("文件 / file", "内容", "content", "字节 / bytes"), rows, numbers=1))
    out.append("<p>SHA-256: item_list.csv, manifest-sha256.txt (BagIt)</p>\n</body>\n</html>\n")
    page = "\n".join(out)
    return page.replace("<style>", f"<style>{font_face(page, _FAMILY)}", 1)


def ro_crate(manifest: Manifest, items: Sequence[Item]) -> str:
    """ro-crate-metadata.json."""
    m = manifest
    files: list[tuple[str, int | None, str, str, str]] = [(i.path, i.size, *i.content) for i in _sorted(items)]
    files += [(name, None, "a", zh, en) for name, zh, en in OWN if name != "ro-crate-metadata.json"]
    graph: list[dict[str, Any]] = [
        {
            "@id": "ro-crate-metadata.json",
            "@type": "CreativeWork",
            "about": {"@id": "./"},
            "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
        },
        {
            "@id": "./",
            "@type": "Dataset",
            "name": m.title or m.campaign,
            "identifier": m.campaign,
            "description": "多传感器一致性检测归档材料 / archived material of a multi-sensor consistency test"
            + (" (虚拟检测场仿真数据 / synthetic data of a virtual range)" if m.synthetic else ""),
            "datePublished": m.date,
            "temporalCoverage": m.start_time,
            "contentLocation": {"@id": "#site"},
            "about": {"@id": "#standard"},
            "license": {"@id": "#rights"},
            "hasPart": [{"@id": quote(path)} for path, *_ in files],
        },
        {"@id": "#site", "@type": "Place", "geo": {"@id": "#origin"}},
        {
            "@id": "#origin",
            "@type": "GeoCoordinates",
            "latitude": m.latitude_deg,
            "longitude": m.longitude_deg,
            "elevation": m.ellipsoid_height_m,
        },
        {"@id": "#standard", "@type": "CreativeWork", "name": "GB/T 41450-2022"},
        {"@id": "#rights", "@type": "CreativeWork", "name": "not stated in the campaign folder"},
    ]
    for path, size, category, zh, en in files:
        entity: dict[str, Any] = {"@id": quote(path), "@type": "File", "name": PurePosixPath(path).name}
        entity["description"] = f"{category}) {CATEGORIES[category][0]}: {zh} / {en}"
        mime = _MIME.get(PurePosixPath(path).suffix.lower())
        if mime:
            entity["encodingFormat"] = mime
        if size is not None:
            entity["contentSize"] = str(size)
        graph.append(entity)
    content = {"@context": "https://w3id.org/ro/crate/1.1/context", "@graph": graph}
    return json.dumps(content, ensure_ascii=False, indent=1, allow_nan=False) + "\n"


def results_campaign(results: Path | None) -> str | None:
    """The campaign that results.json names; None where there is no readable one."""
    owner = _results(results).get("campaign")
    return owner if isinstance(owner, str) else None


def _sorted(items: Sequence[Item]) -> list[Item]:
    return sorted(items, key=lambda i: (i.content[0], i.path))


def _csv(rows: Sequence[Sequence[object]]) -> str:
    buffer = io.StringIO(newline="")
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()


def _results(results: Path | None) -> dict[str, Any]:
    """results.json, unchecked; empty where there is none."""
    path = None if results is None else results / "results.json"
    if path is None or not path.is_file():
        return {}
    try:
        content = json.loads(read_bounded(path, MAX_RESULTS_BYTES))
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _indicators(results: Path | None) -> dict[str, dict[str, Any]]:
    """The indicators of results.json, unchecked but for their form."""
    found = _results(results).get("indicators")
    return {str(k): v for k, v in found.items() if isinstance(v, dict)} if isinstance(found, dict) else {}


def _test_items(results: Path | None) -> str:
    rows = [
        (b.get("clause", ""), b.get("name_zh", key), b.get("name", key), _value(b), b.get("grade_zh", ""))
        for key, b in _indicators(results).items()
    ]
    if not rows:
        return "<p>未评价 / not evaluated</p>"
    return _table(("条款 / clause", "检测项目", "item", "值 / value", "等级 / grade"), rows)


def _value(block: dict[str, Any]) -> str:
    value = block.get("value")
    return f"{value:.5g} {block.get('unit', '')}" if isinstance(value, int | float) else "–"


def _total(category: str, items: Sequence[Item]) -> tuple[object, ...]:
    own = [i for i in items if i.content[0] == category]
    zh, en = CATEGORIES[category]
    return (
        f"{category})",
        zh,
        en,
        len(own) + (len(OWN) if category == "a" else 0),
        f"{sum(i.size for i in own):,}" if own else "",
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[object]], numbers: int = 0) -> str:
    """`numbers`: how many of the last columns are set flush right."""
    first = len(head) - numbers

    def line(tag: str, cells: Sequence[object]) -> str:
        marked = (
            f"<{tag}{' class=n' if k >= first else ''}>{escape(str(cell))}</{tag}>" for k, cell in enumerate(cells)
        )
        return f"<tr>{''.join(marked)}</tr>"

    body = "\n".join(line("td", row) for row in rows)
    return f"<div><table>\n{line('th', head)}\n{body}\n</table></div>"


_FAMILY = "Archive Chinese"
_STYLE = (
    "body{font:15px/1.5 'Archive Chinese',system-ui,sans-serif;max-width:64em;margin:2em auto;"
    "padding:0 1em;color:#222}table{border-collapse:collapse}div{overflow-x:auto}td,th{border-bottom:1px solid #ddd;"
    "padding:.2em .8em .2em 0;text-align:left;vertical-align:top;white-space:nowrap}.n{text-align:right}"
    "h3{margin-bottom:.3em}"
)
