"""Fonts with Chinese glyphs, colours, and figures as data URIs. Nothing here knows what is drawn."""

import base64
import contextlib
import io
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pylopdf_fonts_zh_cn
from fontTools import subset  # type: ignore[import-untyped]
from fontTools.ttLib import TTFont  # type: ignore[import-untyped]
from matplotlib import font_manager
from matplotlib.figure import Figure

from evaluator.c10_1_grading import Grade

SORTIE_COLOURS = ("#1b6ca8", "#d1603d", "#3a8f5c", "#7b4ea3", "#8a6d1d", "#5b6770")
GRADE_COLOURS: dict[Grade, str] = {
    "excellent": "#1a7f4b",
    "good": "#1b6ca8",
    "fair": "#a86a00",
    "ungraded": "#b3261e",
    "not_measured": "#6b7280",
}
GRID = "#d5d9de"
INK = "#1f2937"

_RC: Any = {
    "font.family": ["DejaVu Sans", "Noto Sans SC"],
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.edgecolor": "#6b7280",
    "axes.labelcolor": INK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "svg.fonttype": "path",
    "svg.hashsalt": "testrange",
    "figure.facecolor": "white",
}


def sortie_colour(sortie: int) -> str:
    """The same colour for one sortie in every figure."""
    return SORTIE_COLOURS[(sortie - 1) % len(SORTIE_COLOURS)]


@cache
def _register_font() -> None:
    font_manager.fontManager.addfont(str(pylopdf_fonts_zh_cn.sans_path()))


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Figures made and saved inside have this project's look and can show Chinese."""
    _register_font()
    with matplotlib.rc_context(_RC):
        yield


def figure(width_in: float = 5.3, height_in: float = 3.6) -> Figure:
    """A figure whose text is still legible at the width of a phone. [inches]"""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def _uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def image_uri(jpeg: bytes) -> str:
    """A JPEG as data URI."""
    return _uri("image/jpeg", jpeg)


def svg_uri(drawn: Figure) -> str:
    """The figure as SVG without a date: the same figure, the same bytes."""
    buffer = io.BytesIO()
    drawn.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return _uri("image/svg+xml", buffer.getvalue())


def font_uri(characters: Iterable[str]) -> str:
    """Noto Sans SC cut down to the Chinese ones and their punctuation among `characters`, as WOFF.

    A machine without Chinese fonts shows the report all the same.
    """
    options = subset.Options(layout_features=[], name_IDs=[1, 2, 13, 14], notdef_outline=True, hinting=False)
    cutter = subset.Subsetter(options)
    cutter.populate(unicodes=sorted({ord(c) for c in characters if ord(c) >= 0x2E80}))
    buffer = io.BytesIO()
    with TTFont(Path(pylopdf_fonts_zh_cn.sans_path()), lazy=True, recalcTimestamp=False) as font:
        cutter.subset(font)
        font.flavor = "woff"
        font.save(buffer)
    return _uri("font/woff", buffer.getvalue())


def arrow_limits(size_px: tuple[float, float], *ends_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limit of both axes, so that the image's frame and the ends of all arrows lie inside."""
    points = np.vstack([[[0.0, 0.0], size_px], *ends_px])
    pad = 0.02 * size_px[0]
    return points.min(axis=0) - pad, points.max(axis=0) + pad
