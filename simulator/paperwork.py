"""What people would have written down: survey, spectra, flight plan, environment log. Surveyors and meters have errors too."""

import numpy as np

from campaign.config import Config
from campaign.flight.records import EnvironmentRow, FlightPlan, PlannedStrip
from campaign.survey import Spectra, SurveyedTarget
from scenes.model import Scene, Target
from scenes.sunsky import sun_sky
from simulator.faults import faulty_survey
from simulator.flight.frames import SiteFrame
from simulator.flight.navigation import navigation_std
from simulator.flight.plan import Sortie, design_lines, speeds_m_s
from simulator.randomness import Stream, generator
from simulator.times import BEIJING, utc_from_gps_time

ENVIRONMENT_STEP_S = 10.0
LUX_METER_STD = 0.02  # relative, a class A meter after EN 13032-1
STATIC_CHECK_S = 120.0
_MATERIAL_NAMES = {"barium_sulfate": "barium sulfate", "ptfe": "PTFE", "water_based_paint": "water-based paint"}


def surveyed_targets(config: Config, scene: Scene, frame: SiteFrame) -> list[SurveyedTarget]:
    """Every target as the surveyors deliver it: true place plus a draw from the standard deviations that they state."""
    survey = config.targets.survey
    std = np.array([survey.horizontal_std_m, survey.horizontal_std_m, survey.height_std_m])
    rng = generator(config.seed, Stream.SURVEY)
    marks = frame.map_from_world(np.stack([target.mark_m for target in scene.targets]))
    drawn = marks + rng.standard_normal(marks.shape) * std
    places = faulty_survey(config, tuple(target.id for target in scene.targets), drawn)
    return [_surveyed(target, point, std, frame) for target, point in zip(scene.targets, places, strict=True)]


def _surveyed(target: Target, point_m: np.ndarray, std_m: np.ndarray, frame: SiteFrame) -> SurveyedTarget:
    offset = None if target.vertex_m is None else round(float(target.vertex_m[2] - target.mark_m[2]), 6)
    return SurveyedTarget(
        id=target.id,
        kind=target.kind,
        easting_m=round(float(point_m[0]), 5),
        northing_m=round(float(point_m[1]), 5),
        height_m=round(float(point_m[2]), 5),
        easting_std_m=float(std_m[0]),
        northing_std_m=float(std_m[1]),
        height_std_m=float(std_m[2]),
        azimuth_deg=round(frame.grid_azimuth_deg(target.azimuth_deg, target.mark_m), 3),
        size_m=target.size_m,
        nominal_reflectance_percent=target.nominal_reflectance_percent,
        style=target.style,
        thickness_m=target.thickness_m,
        vertex_faces=target.vertex_faces,
        vertex_offset_m=offset,
        mark_radius_m=target.mark_radius_m,
        material=target.material_name,
    )


def measured_spectra(config: Config, scene: Scene) -> Spectra:
    """The field spectrometer's reflectance of every panel, every 5 nm: a level error for each panel and white noise."""
    panels = [target for target in scene.targets if target.spectrum is not None and target.kind == "panel"]
    rng = generator(config.seed, Stream.SPECTRA)
    std = config.targets.survey.spectrometer_std
    wavelength = np.arange(400.0, 1700.1, 5.0)
    columns = []
    for panel in panels:
        assert panel.spectrum is not None
        true = np.interp(wavelength, panel.spectrum.wavelength_nm, panel.spectrum.reflectance)
        level = 1.0 + std * rng.standard_normal()
        columns.append(true * level * (1.0 + 0.3 * std * rng.standard_normal(len(wavelength))))
    return Spectra(
        wavelength_nm=wavelength,
        panel_ids=tuple(panel.id for panel in panels),
        reflectance=np.round(np.stack(columns, axis=1), 6),
    )


def environment_rows(config: Config, sortie: Sortie) -> list[EnvironmentRow]:
    """One row in ten seconds; illuminance from sun and sky at that instant, as a lux meter reads it."""
    environment = config.environment
    rng = generator(config.seed, Stream.ENVIRONMENT, sortie.number)
    times = np.arange(np.floor(sortie.motion.gps_time_s[0]), sortie.motion.gps_time_s[-1], ENVIRONMENT_STEP_S)
    rows = []
    for t in times:
        light = sun_sky(config.site, environment, utc_from_gps_time(float(t)))
        gust = 1.0 + 0.08 * rng.standard_normal()
        rows.append(
            EnvironmentRow(
                gps_time_s=float(t),
                illuminance_lx=round(light.illuminance_lx * (1.0 + LUX_METER_STD * rng.standard_normal() / 4.0), 0),
                wind_speed_m_s=round(max(0.0, environment.wind_speed_m_s * gust), 2),
                wind_from_deg=round((environment.wind_from_deg + 5.0 * rng.standard_normal()) % 360.0, 1),
                temperature_c=round(environment.temperature_c + 0.1 * rng.standard_normal(), 2),
                pressure_hpa=round(environment.pressure_hpa + 0.05 * rng.standard_normal(), 2),
                relative_humidity_percent=round(
                    float(np.clip(environment.relative_humidity_percent + 0.5 * rng.standard_normal(), 0.0, 100.0)), 1
                ),
                satellites=environment.satellites,
            )
        )
    return rows


def map_sheet_10000(latitude_deg: float, longitude_deg: float) -> str:
    """Number of the 1:10 000 sheet (3'45" by 2'30") that holds a place of the northern hemisphere.

    References
    ----------
    GB/T 13989-2012: 1:1 000 000 row letter and column, scale letter G, row and column of 96 by 96 from the north west.
    """
    letter = chr(ord("A") + int(latitude_deg // 4.0))
    column = int(longitude_deg // 6.0) + 31
    row = 96 - int((latitude_deg % 4.0) / (2.5 / 60.0))
    col = int((longitude_deg % 6.0) / (3.75 / 60.0)) + 1
    return f"{letter}{column:02d}G{row:03d}{col:03d}"


def _bench_instruments(config: Config) -> dict[str, str]:
    """Statements of the instruments of table 2 that only benches and ranging line need."""
    found = {}
    if "bench" in config.campaign.parts:
        found["integrating_sphere"] = config.bench.sphere.traceability
    if "ranging" in config.campaign.parts:
        stations = (config.ranging.correction_station, config.ranging.reference_station)
        found["total_station"] = ", ".join(f"{s.name}: {s.class_mm:g} mm class" for s in stations)
    return found


def flight_plan(config: Config, scene: Scene, sorties: tuple[Sortie, ...], frame: SiteFrame) -> FlightPlan:
    """The plan of 7.1 a-g, as it would be filed before the flight."""
    site, flight, camera = config.site, config.flight, config.camera
    strips = []
    ends = []
    for sortie, height, speed in zip(sorties, flight.heights_m, speeds_m_s(config), strict=True):
        for strip, line in zip(sortie.strips, design_lines(config, scene.layout, height), strict=True):
            points = frame.map_from_world(np.stack([line.start_m, line.end_m]))
            ends += [line.start_m, line.end_m]
            strips.append(
                PlannedStrip(
                    sortie=sortie.number,
                    strip=strip.number,
                    heading_deg=line.heading_deg,
                    height_m=height,
                    speed_m_s=speed,
                    start_en_m=(round(float(points[0, 0]), 3), round(float(points[0, 1]), 3)),
                    end_en_m=(round(float(points[1, 0]), 3), round(float(points[1, 1]), 3)),
                    images=len(strip.exposure_s),
                )
            )
    half = np.abs(np.stack(ends)[:, :2]).max(axis=0) + 10.0
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    latitude, longitude, _ = frame.geodetic_from_world(np.column_stack([corners, np.zeros(4)]))
    takeoff = frame.geodetic_from_world(np.array([[-half[0], -half[1], 0.0]]))
    first, last = sorties[0].motion.gps_time_s[0], sorties[-1].motion.gps_time_s[-1]
    start = utc_from_gps_time(float(first)).astimezone(BEIJING)
    position_std, _ = navigation_std(config)
    season = ("winter", "spring", "summer", "autumn")[start.month % 12 // 3]
    return FlightPlan(
        aircraft=config.platform.name,
        aircraft_kind=config.platform.kind,
        takeoff_lat_lon_deg=(
            round(float(np.degrees(takeoff[0][0])), 7),
            round(float(np.degrees(takeoff[1][0])), 7),
        ),
        area_lat_lon_deg=tuple(
            (round(float(np.degrees(a)), 7), round(float(np.degrees(b)), 7))
            for a, b in zip(latitude, longitude, strict=True)
        ),
        area_m2=round(float(4.0 * half[0] * half[1]), 1),
        map_sheet=map_sheet_10000(site.latitude_deg, site.longitude_deg),
        season=season,
        start_time=start.isoformat(timespec="seconds"),
        duration_s=round(float(last - first), 1),
        deadline=start.date().isoformat(),
        requirements=config.campaign.purpose,
        gsd_m=round(  # by the maker's nominal figures: the true lens is nobody's to know
            flight.gsd_m
            if flight.gsd_m is not None
            else min(flight.heights_m) * camera.pixel_size_um * 1e-3 / camera.nominal_focal_length_mm,
            6,
        ),
        site_height_m=round(site.ellipsoid_height_m - site.height_anomaly_m, 4),
        ground_slope_deg=site.slope_deg,
        obstacle_angle_deg=config.environment.obstacle_angle_deg,
        static_check_s=STATIC_CHECK_S,
        static_check_std_m=round(float(np.linalg.norm(position_std)), 4),
        lock_lost=False,
        instruments={
            "reference_panels": f"{_MATERIAL_NAMES[config.targets.panels.material]}; flatness better than 5 % by spectrometer",
            "geometric_targets": (
                f"control survey {1000.0 * np.sqrt(2.0) * config.targets.survey.horizontal_std_m:.1f} mm horizontally, "
                f"{1000.0 * config.targets.survey.height_std_m:.1f} mm in height (standard deviation of a point)"
            ),
            "field_spectrometer": "400-1700 nm, 5 nm",
            **_bench_instruments(config),
        },
        strips=tuple(strips),
    )
