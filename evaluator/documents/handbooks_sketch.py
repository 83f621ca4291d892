"""The sketch of the layout in appendix A: every target with its name, north, scale, the tracks flown. Nothing is measured here."""

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from evaluator.documents.model import Language, Picture, say
from evaluator.frames import WorldFrame
from evaluator.model import CampaignData
from evaluator.report.style import INK, figure, sortie_colour, style

_STEP_S = 0.5  # between drawn points of a track


def layout_sketch(data: CampaignData, kind: str, language: Language) -> Picture | None:
    """Targets of one kind by name, the others without; None where the survey holds none of that kind."""
    if not any(t.kind == kind for t in data.targets):
        return None
    with style():
        drawn = _draw(data, kind, language)
        svg, png = io.BytesIO(), io.BytesIO()
        drawn.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
        drawn.savefig(png, format="png", dpi=160, metadata={"Software": None})
    caption = {
        "panel": say(language, "图 1　辐射靶标布设略图", "Figure 1  Layout of the reflectance panels"),
        "frustum": say(language, "图 1　几何一致性检测靶标布设略图", "Figure 1  Layout of the geometric targets"),
    }.get(kind, "")
    return Picture(svg=svg.getvalue(), png=png.getvalue(), caption=caption, width_mm=150.0)


def _draw(data: CampaignData, kind: str, language: Language) -> Drawing:
    frame = WorldFrame(data.manifest)
    named = [t for t in data.targets if t.kind == kind]
    others = [t for t in data.targets if t.kind != kind]
    place = frame.world_from_map(np.array([[t.easting_m, t.northing_m, t.height_m] for t in named]))
    drawn = figure(6.4, 5.4)
    axes = drawn.add_subplot()
    _tracks(data, frame, axes, language)
    if others:
        elsewhere = frame.world_from_map(np.array([[t.easting_m, t.northing_m, t.height_m] for t in others]))
        axes.plot(
            elsewhere[:, 0],
            elsewhere[:, 1],
            "+",
            color="#9aa1ab",
            ms=5,
            mew=0.8,
            label=say(language, "其他靶标", "other targets"),
        )
    if kind == "panel":
        shade = [str(np.clip((t.nominal_reflectance_percent or 0.0) / 100.0, 0.0, 1.0)) for t in named]
        label = say(language, "辐射靶标（灰度：标称反射率）", "panels (shade: nominal reflectance)")
        axes.scatter(place[:, 0], place[:, 1], c=shade, marker="s", s=46, ec=INK, lw=0.8, label=label, zorder=3)
    else:
        label = say(language, "几何一致性靶标", "geometric targets")
        axes.scatter(place[:, 0], place[:, 1], c="white", marker="s", s=46, ec="#b3261e", lw=1.2, label=label, zorder=3)
    for target, (east, north, _) in zip(named, place, strict=True):
        axes.annotate(
            target.id, (east, north), (0, 5.5), textcoords="offset points", ha="center", fontsize=6.5, zorder=4
        )
    reach = 0.5 * max(float(np.ptp(place[:, 0])), float(np.ptp(place[:, 1])), 10.0) * 1.25
    middle = 0.5 * (place[:, :2].min(axis=0) + place[:, :2].max(axis=0))
    axes.set(xlim=(middle[0] - 1.18 * reach, middle[0] + 1.18 * reach), ylim=(middle[1] - reach, middle[1] + reach))
    axes.set(
        aspect="equal",
        xlabel=say(language, "东向，自原点起 [m]", "east of the origin [m]"),
        ylabel=say(language, "北向，自原点起 [m]", "north of the origin [m]"),
    )
    axes.annotate(
        say(language, "北", "N"),
        xy=(0.965, 0.97),
        xytext=(0.965, 0.86),
        xycoords="axes fraction",
        ha="center",
        va="center",
        arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.2},
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.11), ncols=3)
    return drawn


def _tracks(data: CampaignData, frame: WorldFrame, axes: Axes, language: Language) -> None:
    for sortie in data.sorties:
        t = sortie.trajectory
        if t is None or t.gps_time_s.size < 2:
            continue
        number = sortie.folder.number
        time = np.arange(t.gps_time_s[0], t.gps_time_s[-1], _STEP_S)
        world = frame.world_from_geodetic(t.latitude_rad, t.longitude_rad, t.ellipsoid_height_m)
        east, north = (np.interp(time, t.gps_time_s, world[:, k]) for k in (0, 1))
        label = say(language, f"第 {number} 架次航迹", f"track of sortie {number}")
        axes.plot(east, north, color=sortie_colour(number), lw=0.7, alpha=0.55, label=label)
