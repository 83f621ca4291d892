"""Targets as solid bodies, after the survey file and the drawing in docs/conventions.md. Where they stand is the survey's word.

A template is in the target's own frame and in units of its size: x right, y along the azimuth, z up, the surveyed point at the
origin. Targets of one form share a template; the page scales, turns and places it.
"""

from dataclasses import dataclass

import numpy as np

from campaign.survey import SurveyedTarget

VERTEX_PER_EDGE = float(np.sqrt(0.5))  # distance of the faces' common vertex from the large rim, over b (6.2.2 c)
_MARK_SECTORS = 4
_SEGMENTS = 8  # of a circle's quarter
_OWN = -1.0  # stands for the target's own grey: its nominal reflectance
_WHITE, _BLACK, _SHEET, _PLATE = 0.95, 0.06, 0.72, 0.42


@dataclass(frozen=True, kw_only=True)
class Template:
    """Triangles of one form of target."""

    xyz: np.ndarray  # (3 t, 3) float32 corners, in units of the target's size
    grey: np.ndarray  # (t,) 0..1 of each triangle, -1: the target's own

    @property
    def top(self) -> float:
        """Highest point above the surveyed one, in units of the size."""
        return float(self.xyz[:, 2].max())


def _quad(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> list[np.ndarray]:
    return [a, b, c, a, c, d]


def _square(half: float, z: float) -> np.ndarray:
    """Corners (4, 3), counterclockwise seen from above."""
    return np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])


def _ring(half_low: float, z_low: float, half_high: float, z_high: float) -> list[np.ndarray]:
    """Four faces between two squares."""
    low, high = _square(half_low, z_low), _square(half_high, z_high)
    return [v for i in range(4) for v in _quad(low[i], low[(i + 1) % 4], high[(i + 1) % 4], high[i])]


def _slab(half: float, thickness: float) -> list[np.ndarray]:
    """A slab's sides and bottom; its top is another's."""
    return _ring(half, -thickness, half, 0.0) + _quad(*_square(half, -thickness)[::-1])


def _mark(radius: float, z: float) -> tuple[list[np.ndarray], list[float]]:
    """A disc of four sectors: white where x and y have the same sign."""
    corners: list[np.ndarray] = []
    greys: list[float] = []
    for sector in range(_MARK_SECTORS):
        angle = (sector + np.arange(_SEGMENTS + 1) / _SEGMENTS) * np.pi / 2.0
        rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(len(angle), z)], axis=1)
        for k in range(_SEGMENTS):
            corners += [np.array([0.0, 0.0, z]), rim[k], rim[k + 1]]
            greys.append(_WHITE if sector % 2 == 0 else _BLACK)
    return corners, greys


def _template(parts: list[tuple[list[np.ndarray], list[float]]]) -> Template:
    return Template(
        xyz=np.array([v for corners, _ in parts for v in corners], dtype="<f4"),
        grey=np.array([g for _, greys in parts for g in greys]),
    )


def _plain(corners: list[np.ndarray], grey: float) -> tuple[list[np.ndarray], list[float]]:
    return corners, [grey] * (len(corners) // 3)


def form(target: SurveyedTarget) -> tuple[str, float]:
    """What tells templates apart: kind and style, and the mark's radius over the size, rounded (0 where there is none)."""
    if target.kind != "frustum":
        return target.kind, 0.0
    radius = (target.mark_radius_m or 0.0) / target.size_m
    return f"frustum {target.style or 'inverted'}", round(min(max(radius, 0.0), 0.5), 3)


def template(name: str, mark: float) -> Template:
    """The body of a `form`.

    Parameters
    ----------
    name : str
        "panel", "board", "frustum inverted" or "frustum upright".
    mark : float
        Radius of the mark over the long edge b. [-]

    Notes
    -----
    Inverted funnel: large rim up at 0.7071 b, small rim at 0.3536 b, the four face planes meet at the mark. Upright: large
    rim on the plate, vertex 0.7071 b above the mark (6.2.2 c, 9.3.2 g).
    """
    if name == "panel":
        return _template([_plain(_quad(*_square(0.5, 0.0)), _OWN), _plain(_slab(0.5, 0.025), _PLATE)])
    if name == "board":
        squares = [
            _plain(
                _quad(*[np.array([x + dx, y + dy, 0.0]) for dx, dy in ((0, 0), (0.5, 0), (0.5, 0.5), (0, 0.5))]),
                _WHITE if (x < 0.0) == (y < 0.0) else _BLACK,
            )
            for x in (-0.5, 0.0)
            for y in (-0.5, 0.0)
        ]
        return _template([*squares, _plain(_slab(0.5, 0.025), _PLATE)])
    half_small, half_large = 0.25, 0.5
    if name == "frustum upright":
        faces = _ring(half_large, 0.0, half_small, 0.5 * VERTEX_PER_EDGE)
        posts: list[np.ndarray] = []
    else:
        faces = _ring(half_small, 0.5 * VERTEX_PER_EDGE, half_large, VERTEX_PER_EDGE)
        posts = _posts(half_large, VERTEX_PER_EDGE)
    plate = _plain(_quad(*_square(0.55, -0.002)) + [v - [0.0, 0.0, 0.002] for v in _slab(0.55, 0.01)], _PLATE)
    parts = [plate, _plain(faces, _SHEET), _plain(posts, _PLATE)]
    return _template(parts + ([_mark(mark, 0.001)] if mark > 0.0 else []))


def _posts(half: float, top: float) -> list[np.ndarray]:
    """Four thin supports at the large rim's corners."""
    out: list[np.ndarray] = []
    for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        centre = np.array([sx * (half + 0.012), sy * (half + 0.012), 0.0])
        out += [v + centre for v in _ring(0.012, 0.0, 0.012, top)]
    return out
