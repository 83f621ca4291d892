"""The page: scene as JSON, script, style and font put into one file that asks nobody for anything."""

import base64
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from campaign.writing.atomic import complete_file
from evaluator.documents.cells import TITLE_LENGTH, clean, one_line
from evaluator.frames import WorldFrame
from evaluator.report.style import font_uri
from evaluator.results import Evaluation, plain
from evaluator.view import colours, facts, flight, solids
from evaluator.view.model import Cloud, TruthErrors
from evaluator.view.pack import ERROR_DECADES, LEAST_ERROR_M, REFLECTANCE_STEP, base64_text, pack
from evaluator.view.points import sample_cloud
from evaluator.view.terrain import Terrain, best_map, grid_terrain
from evaluator.view.words import Language, words

HERE = Path(__file__).parent
SCRIPTS = ("maths.js", "draw.js", "scene.js", "orbit.js", "view.js")
_NO_HEIGHT = 65535


def _origin(evaluation: Evaluation, cloud: Cloud, poses: list[flight.CameraPose]) -> np.ndarray:
    """Whole metres of map coordinates (3,) from which the page counts: the targets' middle, else that of anything there is."""
    data = evaluation.data
    if data is not None and data.targets:
        places = np.array([[t.easting_m, t.northing_m, t.height_m] for t in data.targets])
    elif cloud.shown:
        places = cloud.joined("map_m")
    elif poses:
        places = np.array([p.centre_m for p in poses])
    else:
        return WorldFrame(data.manifest).map_from_world(np.zeros(3)).round() if data is not None else np.zeros(3)
    middle = (places.min(axis=0) + places.max(axis=0)) / 2.0
    return np.asarray(np.floor(middle))


def _cloud_block(cloud: Cloud, origin: np.ndarray) -> dict[str, Any] | None:
    packed = pack(cloud, origin)
    if packed is None:
        return None
    heights = best_map(cloud)[:, 2] - origin[2]
    bright = cloud.joined("reflectance")
    known = bright[np.isfinite(bright)]
    return {
        "tiles": [{"low": low, "step": step, "count": count} for low, step, count in packed.tiles],
        "place": base64_text(packed.place),
        "shift": base64_text(packed.shift) if packed.shift_step_m > 0.0 else None,
        "shift_step": packed.shift_step_m,
        "strip": base64_text(packed.strip),
        "reflectance": base64_text(packed.reflectance) if known.size else None,
        "reflectance_by": cloud.reflectance_by,
        "reflectance_step": REFLECTANCE_STEP,
        "reflectance_range": _range(known, 0.0, 1.0),
        "error": [base64_text(e) if e.any() else None for e in packed.error],
        "error_least": LEAST_ERROR_M,
        "error_decades": ERROR_DECADES,
        "height_range": _range(heights, 0.0, 1.0),
        "shown": cloud.shown,
        "total": cloud.total,
    }


def _range(values: np.ndarray, low: float, high: float) -> tuple[float, float]:
    """Where all but 1 % of the values lie, at each end; never of no length."""
    if not values.size:
        return low, high
    a, b = (float(v) for v in np.quantile(values, [0.01, 0.99]))
    return (a, b) if b - a > 1e-3 else (a - 0.5, b + 0.5)


def _terrain_block(terrain: Terrain | None, origin: np.ndarray) -> dict[str, Any] | None:
    if terrain is None:
        return None
    height = terrain.height_m - origin[2]
    low, high = float(np.nanmin(height)), float(np.nanmax(height))
    step = max((high - low) / (_NO_HEIGHT - 1), 1e-4)
    code = np.where(np.isfinite(height), np.round((np.nan_to_num(height, nan=low) - low) / step), _NO_HEIGHT)
    bright = np.clip(np.nan_to_num(terrain.reflectance) * 200.0, 0, 255)
    return {
        "low": (terrain.low_m - origin[:2]).tolist(),
        "cell": terrain.cell_m,
        "rows": height.shape[0],
        "columns": height.shape[1],
        "base": low,
        "step": step,
        "height": base64_text(code.clip(0, _NO_HEIGHT).astype(np.uint16)),
        "reflectance": base64_text(bright.astype(np.uint8)),
    }


def _target_blocks(
    evaluation: Evaluation,
    results: Mapping[str, Any],
    terrain: Terrain | None,
    origin: np.ndarray,
    text: Mapping[str, str],
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """(targets, the templates that they share)."""
    targets: list[dict[str, Any]] = []
    places: dict[tuple[str, float], int] = {}
    for t in evaluation.data.targets if evaluation.data else ():
        key = solids.form(t)
        place = places.setdefault(key, len(places))
        ground = terrain.below(t.easting_m, t.northing_m) if terrain is not None else None
        rows, short = facts.target_rows(t, evaluation, results, text)
        targets.append(
            {
                "id": t.id,
                "kind": t.kind,
                "at": (np.array([t.easting_m, t.northing_m, t.height_m]) - origin).tolist(),
                "azimuth": float(np.radians(t.azimuth_deg)),
                "size": t.size_m,
                "grey": (t.nominal_reflectance_percent or 50.0) / 100.0,
                "template": place,
                "stand": 0.0 if ground is None else float(np.clip(t.height_m - ground, 0.0, 20.0)),
                "rows": rows,
                "short": short,
            }
        )
    templates = [
        {"xyz": base64_text(shape.xyz), "grey": shape.grey.tolist(), "top": shape.top}
        for shape in (solids.template(*key) for key in places)
    ]
    return targets, templates


def build_scene(
    evaluation: Evaluation, results: Mapping[str, Any], truth_errors: TruthErrors | None, language: Language
) -> dict[str, Any]:
    """Everything that the page draws and says, in JSON's own types; no path of the machine in it."""
    text, data = words(language), evaluation.data
    cloud = sample_cloud(evaluation, truth_errors)
    terrain = grid_terrain(cloud)
    poses, problems = flight.cameras(evaluation)
    origin = _origin(evaluation, cloud, poses)
    targets, templates = _target_blocks(evaluation, results, terrain, origin, text)
    tracks = flight.paths(evaluation)
    sorties = sorted({s.folder.number for s in data.sorties}) if data else []
    points = _cloud_block(cloud, origin)
    notes = [text["scale_note"]]
    if points is not None:
        notes.insert(0, text["shown_of"].format(shown=f"{cloud.shown:,}", total=f"{cloud.total:,}"))
        notes += [text["error_note"]] if any(points["error"]) else []
    scene = {
        "words": text,
        "origin": origin.tolist(),
        "cloud": points,
        "strips": [{"sortie": s.sortie, "strip": s.strip} for s in cloud.strips],
        "sorties": [{"number": n, "colour": colours.group_colour(k)} for k, n in enumerate(sorties)],
        "groups": colours.GROUPS,
        "terrain": _terrain_block(terrain, origin),
        "targets": targets,
        "templates": templates,
        "tracks": [
            {
                "sortie": t.sortie,
                "places": base64_text((t.map_m - origin).astype(np.float32)),
                "strip": base64_text((t.strip >= 0).astype(np.uint8)),
            }
            for t in tracks
        ],
        "cameras": [
            {
                "image": p.image,
                "sortie": p.sortie,
                "at": (p.centre_m - origin).round(4).tolist(),
                "corners": None if p.corners_m is None else p.corners_m.round(4).tolist(),
                "rows": facts.image_rows(p, text),
            }
            for p in poses
        ],
        "scales": {key: colours.scale(name) for key, name in colours.SCALES.items()},
        "notes": [*notes, *cloud.problems, *problems],
    }
    made: dict[str, Any] = _clean(plain(scene, evaluation.root))
    return made


def _clean(value: Any) -> Any:
    """The same with texts that turn no reading direction and hold no control character."""
    if isinstance(value, dict):
        return {k: _clean(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_clean(v) for v in value]
    return clean(value, len(value) + 1) if isinstance(value, str) else value


def render_view(
    evaluation: Evaluation, results: Mapping[str, Any], truth_errors: TruthErrors | None, language: Language
) -> str:
    """The page as one text."""
    text = words(language)
    scene = json.dumps(
        build_scene(evaluation, results, truth_errors, language),
        ensure_ascii=False,
        separators=(",", ":"),
        allow_nan=False,
    )
    for character, code in (("&", "\\u0026"), ("<", "\\u003c"), (">", "\\u003e")):  # no markup inside the block
        scene = scene.replace(character, code)
    script = "(function () {\n'use strict';\n" + "".join((HERE / name).read_text() for name in SCRIPTS) + "})();\n"
    title = evaluation.data.manifest.title if evaluation.data is not None else ""
    chinese = "U+2E80-9FFF,U+F900-FAFF,U+FF00-FFEF"
    said = "".join(text.values()) + (title or "") + evaluation.campaign
    face = f"@font-face{{font-family:'View SC';src:url({font_uri(said)}) format('woff');unicode-range:{chinese}}}\n"
    style = face + (HERE / "view.css").read_text()
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template("page.html.j2").render(
        language="zh-CN" if language == "zh" else "en",
        words=text,
        campaign=one_line(evaluation.campaign, TITLE_LENGTH),
        title=one_line(title or "", TITLE_LENGTH),
        synthetic=bool(results.get("synthetic", evaluation.synthetic)),
        scene=scene,
        script=script,
        style=style,
        script_hash=_hash(script),
        style_hash=_hash(style),
    )


def _hash(content: str) -> str:
    """As a content security policy names what may run."""
    return "sha256-" + base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()


def write_view(
    path: Path,
    evaluation: Evaluation,
    results: Mapping[str, Any],
    truth_errors: TruthErrors | None = None,
    language: Language = "zh",
) -> None:
    """Writes view.html: the range in 3D, one file that opens from disk and makes no request.

    Parameters
    ----------
    path : Path
        File to write.
    evaluation : Evaluation
        With `data`, the campaign as read; the strips' points are read from its folder.
    results : dict
        Contents of results.json, for the figures of each target.
    truth_errors : TruthErrors, optional
        `evaluator.scores.score_points.point_errors(root)`; None for a flown campaign.
    language : "zh" or "en"
    """
    page = render_view(evaluation, results, truth_errors, language)
    with complete_file(path) as work:
        work.write_bytes(page.encode())
