"""The form at the head of an observation handbook: range, weather, time, targets and sensors as the campaign records them."""

from collections.abc import Sequence

import numpy as np

from campaign.flight.records import EnvironmentRow
from campaign.survey import SurveyedTarget
from evaluator.documents.handbooks_common import beijing, span
from evaluator.documents.model import Cell, Figure, Language, say
from evaluator.documents.phrases import not_stated
from evaluator.model import CampaignData


def conditions(data: CampaignData | None, kind: str, language: Language) -> list[tuple[Cell, ...]]:
    unknown = not_stated(language)
    chosen = [t for t in data.targets if t.kind == kind] if data else []
    number: Cell = Figure(value=len(chosen), decimals=0)
    camera = data.camera.name if data and data.camera else unknown
    lidar = data.lidar.name if data and data.lidar else unknown
    rows: list[tuple[Cell, ...]] = [
        (say(language, "检测场范围", "Range"), _extent(data, language), say(language, "天气条件", "Weather"), unknown),
        (
            say(language, "温度", "Temperature"),
            _range_of(data, "temperature_c", 1, "℃", language),
            say(language, "风速", "Wind speed"),
            _range_of(data, "wind_speed_m_s", 1, "m/s", language),
        ),
    ]
    if kind == "panel":
        rows.append(
            (
                say(language, "辐射靶标反射率范围", "Reflectance of the panels"),
                _reflectances(chosen, language),
                say(language, "靶标布设个数", "Number of panels"),
                number,
            )
        )
        rows.append(
            (
                say(language, "检测场典型地物", "Typical ground objects"),
                unknown,
                say(language, "观测起讫时间", "Observed from, to"),
                _times(data, language),
            )
        )
    else:
        rows.append(
            (
                say(language, "检测靶标布设个数", "Number of targets"),
                number,
                say(language, "观测起讫时间", "Observed from, to"),
                _times(data, language),
            )
        )
    rows += [
        (say(language, "光学遥感传感器型号", "Camera"), camera, say(language, "激光雷达型号", "LiDAR"), lidar),
        (
            say(language, "光照度", "Illuminance"),
            _range_of(data, "illuminance_lx", 0, "lx", language),
            say(language, "相对湿度；气压", "Humidity; pressure"),
            say(language, "；", "; ").join(
                (
                    _range_of(data, "relative_humidity_percent", 0, "%", language),
                    _range_of(data, "pressure_hpa", 0, "hPa", language),
                )
            ),
        ),
        (
            say(language, "无人机平台", "Platform"),
            data.rig.platform if data and data.rig else unknown,
            say(language, "坐标系与高程基准", "Datum"),
            f"EPSG:{data.manifest.projection_epsg}, EPSG:{data.manifest.height_epsg}" if data else unknown,
        ),
    ]
    return rows


def _extent(data: CampaignData | None, language: Language) -> str:
    if data is None:
        return not_stated(language)
    m = data.manifest
    at = f"{m.latitude_deg:.5f}°N, {m.longitude_deg:.5f}°E"
    parts = []
    if data.targets:
        east, north = np.array([[t.easting_m, t.northing_m] for t in data.targets]).T
        size = f"{np.ptp(east):.1f} m × {np.ptp(north):.1f} m"
        parts.append(say(language, f"靶标区 {size}", f"targets within {size}"))
    if data.plan is not None:
        parts.append(say(language, f"测区 {data.plan.area_m2:.0f} m²", f"flight area {data.plan.area_m2:.0f} m²"))
    parts.append(say(language, f"原点 {at}", f"origin {at}"))
    return say(language, "；", "; ").join(parts)


def _range_of(data: CampaignData | None, name: str, decimals: int, unit: str, language: Language) -> str:
    """Least and greatest value of one column of the environment records."""
    rows: list[EnvironmentRow] = [row for s in data.sorties for row in s.environment] if data else []
    values = [v for v in (getattr(row, name) for row in rows) if v is not None]
    return span(min(values), max(values), decimals, unit, language) if values else not_stated(language)


def _reflectances(panels: Sequence[SurveyedTarget], language: Language) -> str:
    levels = sorted({p.nominal_reflectance_percent for p in panels if p.nominal_reflectance_percent is not None})
    if not levels:
        return not_stated(language)
    listed = say(language, "、", ", ").join(f"{v:g} %" for v in levels)
    return span(levels[0], levels[-1], 0, "%", language) + say(language, f"（标称 {listed}）", f" (nominal {listed})")


def _times(data: CampaignData | None, language: Language) -> str:
    """From the first to the last exposure or trajectory record, Beijing time."""
    if data is None:
        return not_stated(language)
    ends: list[float] = []
    for s in data.sorties:
        ends += [e.gps_time_s for e in s.exposures]
        if s.trajectory is not None:
            ends += [float(s.trajectory.gps_time_s[0]), float(s.trajectory.gps_time_s[-1])]
    if not ends:
        return not_stated(language)
    first, last = (beijing(t, data.manifest.gps_minus_utc_s) for t in (min(ends), max(ends)))
    end = f"{last:%H:%M:%S}" if first.date() == last.date() else f"{last:%Y-%m-%d %H:%M:%S}"
    ends_text = say(language, f"—{end}（北京时间", f" to {end} (Beijing time")
    flown = any(s.trajectory is not None for s in data.sorties)
    runs = say(language, "，含航线之外的飞行", "; flight outside the strips included") if flown else ""
    return f"{first:%Y-%m-%d %H:%M:%S}{ends_text}{runs}{say(language, '）', ')')}"
