"""The sketch of 7.1 c: the flight area in its map sheet, and the area itself with strips, targets and take-off point."""

from collections.abc import Sequence

import numpy as np
import pyproj
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawn
from matplotlib.patches import Polygon, Rectangle

from campaign.flight.records import FlightPlan
from campaign.manifest import Manifest
from evaluator.documents.map_sheet import Sheet, degrees_minutes_seconds, sheet_at
from evaluator.documents.model import Language, say
from evaluator.model import CampaignData
from evaluator.report.style import INK, figure, sortie_colour

_AREA = "#d1603d"
_MAX_DRAWN = 400  # strips
_STEP_DEG = 30.0 / 3600.0  # between ticks of a sheet's frame


def map_points(manifest: Manifest, lat_lon_deg: Sequence[tuple[float, float]]) -> np.ndarray | None:
    """Easting and northing (n, 2) in the campaign's projection; None where it is not known or does not hold them. [m]"""
    if not lat_lon_deg:
        return None
    try:
        crs = pyproj.CRS.from_epsg(manifest.projection_epsg)
        if not crs.is_projected:
            return None
        transformer = pyproj.Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True)
        latitude, longitude = np.array(lat_lon_deg, dtype=np.float64).T
        points = np.column_stack(transformer.transform(longitude, latitude))
    except pyproj.exceptions.ProjError:
        return None
    return points if np.isfinite(points).all() else None


def sketch(data: CampaignData, plan: FlightPlan, language: Language) -> Drawn:
    """Both drawings side by side; a half that cannot be drawn says why."""
    drawn = figure(7.2, 3.7)
    left, right = drawn.subplots(1, 2, width_ratios=(1.12, 1.0))
    corners = plan.area_lat_lon_deg or (plan.takeoff_lat_lon_deg,)
    latitude, longitude = np.array(corners, dtype=np.float64).mean(axis=0)
    sheet = sheet_at(float(latitude), float(longitude))
    if sheet is None:
        _empty(left, say(language, "测区不在 1:10 000 图幅范围内", "the area lies on no 1:10 000 sheet"))
    else:
        _sheet(left, sheet, plan, language)
    _area(right, data, plan, language)
    return drawn


def _empty(axes: Axes, why: str) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, why, ha="center", va="center", transform=axes.transAxes)


def _sheet(axes: Axes, sheet: Sheet, plan: FlightPlan, language: Language) -> None:
    """The sheet's frame with its corners' coordinates, its neighbours' numbers and the area's place."""
    west, east, south, north = sheet.west_deg, sheet.east_deg, sheet.south_deg, sheet.north_deg
    wide, high = east - west, north - south
    axes.add_patch(Rectangle((west, south), wide, high, fill=False, lw=1.6, ec=INK))
    margin = 0.012 * wide
    axes.add_patch(
        Rectangle((west - margin, south - margin), wide + 2 * margin, high + 2 * margin, fill=False, lw=0.5, ec=INK)
    )
    for k in range(1, round(wide / _STEP_DEG) + 1):
        if west + k * _STEP_DEG < east - 1e-9:
            axes.plot([west + k * _STEP_DEG] * 2, [south, north], lw=0.4, color="#d5d9de", zorder=0)
    for k in range(1, round(high / _STEP_DEG)):
        axes.plot([west, east], [south + k * _STEP_DEG] * 2, lw=0.4, color="#d5d9de", zorder=0)
    small: dict[str, object] = {"fontsize": 6.5, "color": INK}
    for x, ha in ((west, "left"), (east, "right")):
        text = degrees_minutes_seconds(x, 0)
        axes.text(x, north + 3 * margin, text, ha=ha, va="bottom", **small)  # type: ignore[arg-type]
    for y, va in ((south, "bottom"), (north, "top")):
        text = degrees_minutes_seconds(y, 0)
        axes.text(west - 3 * margin, y, text, ha="right", va=va, rotation=90, **small)  # type: ignore[arg-type]
    for dx, dy in ((0, 1), (0, -1), (-1, 0), (1, 0)):
        beside = sheet_at((south + north) / 2 + dy * high, (west + east) / 2 + dx * wide)
        if beside is not None:
            axes.text(
                (west + east) / 2 + dx * 0.68 * wide,
                (south + north) / 2 + dy * 0.68 * high,
                beside.number,
                ha="center",
                va="center",
                rotation=90 * abs(dx),
                fontsize=6.5,
                color="#6b7280",
            )
    area = np.array(plan.area_lat_lon_deg or (plan.takeoff_lat_lon_deg,), dtype=np.float64)[:, ::-1]
    axes.add_patch(Polygon(area, closed=True, fc=_AREA, ec=_AREA, lw=1.0))
    centre = area.mean(axis=0)
    axes.plot(*centre, "o", ms=11, mfc="none", mec=_AREA, mew=1.3)
    inward = -1 if centre[0] > (west + east) / 2 else 1
    axes.annotate(
        say(language, "飞行区域", "flight area"),
        centre,
        xytext=(14 * inward, 10 if centre[1] < (south + north) / 2 else -14),
        textcoords="offset points",
        ha="right" if inward < 0 else "left",
        color=_AREA,
        fontsize=8,
    )
    axes.set(xlim=(west - 0.24 * wide, east + 0.24 * wide), ylim=(south - 0.26 * high, north + 0.26 * high))
    axes.set_aspect(1.0 / np.cos(np.radians((south + north) / 2)))
    axes.set_axis_off()
    axes.set_title(say(language, f"图幅 {sheet.number}（1:10 000）", f"Sheet {sheet.number} (1:10 000)"), loc="center")


def _widths(plan: FlightPlan) -> dict[int, float]:
    """Sorties that fly the same lines lie over one another: the first is drawn widest and shows below the others."""
    numbers = sorted({s.sortie for s in plan.strips})
    return {n: max(1.0, 1.0 + 1.4 * (len(numbers) - 1 - k)) for k, n in enumerate(numbers)}


def _area(axes: Axes, data: CampaignData, plan: FlightPlan, language: Language) -> None:
    """The area in metres of the map projection from its south-western corner, grid north up."""
    corners = map_points(data.manifest, plan.area_lat_lon_deg)
    takeoff = map_points(data.manifest, (plan.takeoff_lat_lon_deg,))
    lines = np.array([[s.start_en_m, s.end_en_m] for s in plan.strips], dtype=np.float64).reshape(-1, 2, 2)
    known = [p for p in (corners, takeoff, lines.reshape(-1, 2) if len(lines) else None) if p is not None]
    if not known:
        _empty(axes, say(language, "没有可绘制的坐标", "no coordinates to draw"))
        return
    base = np.concatenate(known if corners is None else [corners])
    origin, middle = base.min(axis=0), base.mean(axis=0)
    reach = 3.0 * max(float(np.ptp(base, axis=0).max()), 100.0)

    def near(points: np.ndarray) -> np.ndarray:
        """Points that belong on this drawing; a plan with another origin draws nothing kilometres away."""
        return points[(np.abs(points - middle) < reach).all(axis=-1)]

    wide = _widths(plan)
    if corners is not None:
        axes.add_patch(Polygon(corners - origin, closed=True, fc="#f4b94222", ec=_AREA, lw=1.3))
        for k, corner in enumerate(corners, 1):
            away = 7.0 * np.sign(corner - middle)
            axes.annotate(
                str(k), corner - origin, xytext=away, textcoords="offset points", ha="center", va="center", fontsize=8
            )
    for strip, line in zip(plan.strips[:_MAX_DRAWN], lines[:_MAX_DRAWN], strict=True):
        if len(near(line)) < 2:
            continue
        axes.annotate(
            "",
            line[1] - origin,
            line[0] - origin,
            arrowprops={
                "arrowstyle": "-|>",
                "lw": wide[strip.sortie],
                "color": sortie_colour(max(strip.sortie, 1)),
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )
    for kind, marker, zh, en in (
        ("panel", "D", "标准反射靶标", "reference panel"),
        ("frustum", "s", "几何靶标", "geometric target"),
    ):
        points = np.array([[t.easting_m, t.northing_m] for t in data.targets if t.kind == kind]).reshape(-1, 2)
        points = near(points)
        if len(points):
            axes.plot(
                *(points - origin).T, marker, ms=3.2, mfc="none", mec="#1b6ca8" if kind == "panel" else "#3a8f5c", mew=0.9,
                ls="none", label=say(language, zh, en),
            )  # fmt: skip
    if takeoff is not None and len(near(takeoff)):
        axes.plot(
            *(takeoff[0] - origin),
            "^",
            ms=8,
            color="#7b4ea3",
            label=say(language, "起降点", "take-off point"),
            zorder=5,
        )
    for number in sorted({s.sortie for s in plan.strips})[:6]:
        label = say(language, f"第 {number} 架次航线", f"strips of sortie {number}")
        axes.plot([], [], color=sortie_colour(max(number, 1)), lw=1.2, label=label)
    everything = near(np.concatenate(known)) - origin
    low, high = everything.min(axis=0), everything.max(axis=0)
    room = 0.09 * max(float((high - low).max()), 1.0)
    axes.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room), aspect="equal")
    axes.set_xlabel(say(language, "自西南角向东 (m)", "east of the SW corner (m)"))
    axes.set_ylabel(say(language, "自西南角向北 (m)", "north of the SW corner (m)"))
    axes.set_title(say(language, "飞行区域（坐标北向上）", "Flight area (grid north up)"), loc="center")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, fontsize=7)
