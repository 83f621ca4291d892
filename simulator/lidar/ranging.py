"""The ranging line of 9.1.2, observed: the LiDAR on a turntable, two total stations, and what is written of them.

The LiDAR's beams, waveforms, detector, noise and faults are those of the flight (`strip.observe`); the turntable only
takes the aircraft's place. The scene stands in `scenes.ranging_line`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from campaign.benches.ranging import (
    RangingLine,
    RangingPanel,
    StationReading,
    TotalStation,
    line_path,
    readings_path,
    scan_path,
    write_line,
    write_readings,
)
from campaign.benches.scans import ScanPoints, joined, write_scan
from campaign.config import Config, TotalStationModel
from campaign.errors import ConfigError
from campaign.folder import CampaignFolder
from campaign.progress import Report
from campaign.threads import one_blas_thread
from campaign.truth import TrueRanging
from scenes.model import Scene
from scenes.ranging_line import RangingScene, build_line, turned
from simulator.flight.motion import Motion, SensorMounting, Strip
from simulator.journal import Journal
from simulator.lidar.radar_equation import unambiguous_range_m
from simulator.lidar.scanner import scanner_from
from simulator.lidar.strip import backscatter, observe, optics_from
from simulator.randomness import Stream, generator, scene_seed
from simulator.times import BEIJING, utc_from_gps_time

if TYPE_CHECKING:
    from simulator.render.scene import RenderScene

MARGIN_DEG = 0.6  # of sector and turn round the panels' corners
MIN_POINTS = 15  # on the farthest panel, in one scan
PAUSE_S = 5.0  # between two scans
SCENE_KEY, STATION_KEY = 9001, 9002  # of the random streams; a scan's key is 0, its number
# The beam turns up and down: lidar z (encoder 0) looks along body x, lidar y (encoder positive) down, lidar x along body y.
UPRIGHT = SensorMounting(
    rotation=np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), lever_arm_m=np.zeros(3)
)


@dataclass(frozen=True, kw_only=True)
class Line:
    """The line as it stands, in the instrument's own axes and about its centre."""

    config: Config  # the LiDAR's scan rate and sector are the line's
    setting: RangingScene  # east, north, up
    scene: Scene  # in the instrument's axes
    lidar_from_world: np.ndarray  # (3, 3)
    station_azimuth_rad: float  # of the stations' zero direction, clockwise from north
    turn_deg: tuple[float, float]  # azimuths in the instrument's axes between which a scan turns


class OwnAxes:
    """Coordinates are written in the axes that the beams are traced in."""

    origin_m = np.zeros(3)

    def relative(self, world_m: np.ndarray) -> np.ndarray:
        return world_m


def true_ranging(config: Config) -> TrueRanging:
    """The faults measured = true + o + s true, solved for the true range: K2 = -o / (1 + s), R2 = -s / (1 + s)."""
    faults = config.faults
    return TrueRanging(
        additive_constant_m=-faults.range_offset_m / (1.0 + faults.range_scale),
        multiplication_constant=-faults.range_scale / (1.0 + faults.range_scale),
    )


def prepare_line(config: Config) -> Line:
    """Build the line and set up the instruments.

    Raises
    ------
    ConfigError
        Panels that do not fit, are too near, lie beyond the unambiguous range, or return too little.
    """
    seed = scene_seed(config)
    rng = generator(seed, Stream.RANGING, SCENE_KEY)
    setting = build_line(config, rng)
    station_azimuth, lean_towards, lean, heading = rng.uniform(0.0, 1.0, 4)
    lidar_from_world = _leaning(
        2.0 * np.pi * heading, 2.0 * np.pi * lean_towards, np.radians(config.ranging.tilt_deg) * np.sqrt(lean)
    )
    corner = setting.corners_m.reshape(-1, 3) @ lidar_from_world.T
    middle = setting.corners_m.mean(axis=(0, 1)) @ lidar_from_world.T
    middle_deg = np.degrees(np.arctan2(middle[0], middle[1]))
    azimuth = (np.degrees(np.arctan2(corner[:, 0], corner[:, 1])) - middle_deg + 180.0) % 360.0 - 180.0 + middle_deg
    down = -np.degrees(np.arctan2(corner[:, 2], np.hypot(corner[:, 0], corner[:, 1])))
    spread = np.asarray(config.lidar.scanner.channel_elevations_deg or (0.0,))
    scanner = config.lidar.scanner.model_copy(
        update={
            "scan_rate_hz": config.ranging.scan_rate_hz,
            "sector_deg": (float(down.min() - MARGIN_DEG), float(down.max() + MARGIN_DEG)),
        }
    )
    line = Line(
        config=config.model_copy(
            update={
                "lidar": config.lidar.model_copy(update={"scanner": scanner}),
                "faults": config.faults.model_copy(update={"lidar_clock_s": 0.0}),  # the turntable is the LiDAR's own
            }
        ),
        setting=setting,
        scene=turned(setting.scene, lidar_from_world),
        lidar_from_world=lidar_from_world,
        station_azimuth_rad=float(2.0 * np.pi * station_azimuth),
        turn_deg=(
            float(azimuth.min() - MARGIN_DEG - spread.max()),
            float(azimuth.max() + MARGIN_DEG - spread.min()),
        ),
    )
    _check(line)
    return line


@one_blas_thread()
def simulate_ranging(
    config: Config, place: CampaignFolder, start_gps_s: float, progress: Report, journal: Journal | None = None
) -> None:
    """Write ranging/ of a campaign folder: line.json, total_station.csv, one point cloud for each scan.

    Raises
    ------
    ConfigError
        See `prepare_line`.
    """
    from simulator.render.scene import load_scene

    line, journal = prepare_line(config), journal or Journal()
    scans = config.ranging.scans
    progress("ranging", 0, scans)
    scan_path(place, 1).parent.mkdir(parents=True, exist_ok=True)
    if not journal.shares:
        sheet, readings = survey_line(line, config)
        write_line(line_path(place), sheet)
        write_readings(readings_path(place), readings)
    render_scene = load_scene(line.scene)
    date = utc_from_gps_time(start_gps_s).astimezone(BEIJING).date().isoformat()
    duration_s = (line.turn_deg[1] - line.turn_deg[0]) / config.ranging.turn_rate_deg_s
    for number in range(1, scans + 1):
        unit = f"scan {number}"
        if not journal.wants(unit):
            progress("ranging", number, scans)
            continue
        start_s = start_gps_s + (number - 1) * (duration_s + PAUSE_S)
        points = joined(list(scan(line, render_scene, number, start_s)))
        write_scan(
            scan_path(place, number),
            points,
            number=number,
            creation_date=date,
            system_identifier=config.lidar.name[:32],
        )
        journal.finish(unit, [scan_path(place, number)])
        progress("ranging", number, scans)


def scan(line: Line, render_scene: "RenderScene", number: int, start_s: float) -> Iterator[ScanPoints]:
    """One scan; every other one turns back."""
    first, last = np.radians(line.turn_deg if number % 2 else line.turn_deg[::-1])
    rate = np.radians(line.config.ranging.turn_rate_deg_s)
    end_s = start_s + abs(last - first) / rate
    time = np.array([start_s - 1.0, end_s + 1.0])
    heading = first + np.sign(last - first) * rate * (time - start_s)
    table = Motion(
        gps_time_s=time,
        position_world_m=np.zeros((2, 3)),
        velocity_world_m_s=np.zeros((2, 3)),
        rpy_rad=np.stack([np.zeros(2), np.zeros(2), heading], axis=-1),
    )
    strip = Strip(sortie=0, number=number, heading_deg=0.0, height_m=0.0, start_s=start_s, end_s=end_s, exposure_s=())
    chunks = observe(
        render_scene,
        line.config,
        strip,
        table,
        table,
        UPRIGHT,
        UPRIGHT,
        OwnAxes(),
        Stream.RANGING,
    )
    for chunk in chunks:
        r = chunk.returns
        yield ScanPoints(
            xyz_m=r.xyz_m,
            gps_time_s=r.gps_time_s,
            intensity=r.intensity,
            amplitude=r.amplitude,
            pulse_width_ns=r.pulse_width_ns,
            reflectance_db=r.reflectance_db,
            return_number=r.return_number,
            number_of_returns=r.number_of_returns,
        )


def survey_line(line: Line, config: Config) -> tuple[RangingLine, list[StationReading]]:
    """What the total stations show, and the sheet of the set-up."""
    ranging, rng = config.ranging, generator(config.seed, Stream.RANGING, STATION_KEY)
    cos_z, sin_z = math.cos(line.station_azimuth_rad), math.sin(line.station_azimuth_rad)
    station_from_world = np.array([[cos_z, -sin_z, 0.0], [sin_z, cos_z, 0.0], [0.0, 0.0, 1.0]])
    eccentricity = np.asarray(ranging.eccentricity_m)
    stated = station_from_world @ eccentricity + ranging.eccentricity_std_m * rng.standard_normal(3)
    readings: list[StationReading] = []
    stations = []
    for model, serves in ((ranging.correction_station, "correction"), (ranging.reference_station, "reference")):
        stations.append(_sheet(model, serves))
        k1 = (model.additive_constant_mm + model.additive_constant_std_mm * rng.standard_normal()) * 1e-3
        r1 = (model.scale_ppm + model.scale_std_ppm * rng.standard_normal()) * 1e-6
        for panel in line.setting.panels:
            sight = station_from_world @ (panel.centre_m + eccentricity)
            for observation in range(1, ranging.observations + 1):
                air = _air(config, rng)
                noise = rng.standard_normal(3)
                distance = float(np.linalg.norm(sight))
                seen = distance + (model.std_mm * 1e-3 + model.std_ppm * 1e-6 * distance) * float(noise[0])
                slope = slope_reading_m(seen, k1, r1, model.reference_index, air_index(model.wavelength_um, *air))
                horizontal = math.degrees(math.atan2(sight[0], sight[1])) + model.angle_std_deg * float(noise[1])
                zenith = math.degrees(math.acos(sight[2] / distance)) + model.angle_std_deg * float(noise[2])
                readings.append(
                    StationReading(
                        station=model.name,
                        panel=panel.id,
                        observation=observation,
                        slope_distance_m=round(slope, 5),
                        horizontal_angle_deg=round(horizontal % 360.0, 5),
                        zenith_angle_deg=round(zenith, 5),
                        temperature_c=air[0],
                        pressure_hpa=air[1],
                        relative_humidity_percent=air[2],
                    )
                )
    sheet = RangingLine(
        stations=tuple(stations),
        panels=tuple(
            RangingPanel(
                id=panel.id, size_m=panel.size_m, nominal_reflectance_percent=ranging.panel_reflectance_percent
            )
            for panel in line.setting.panels
        ),
        eccentricity_m=(round(float(stated[0]), 5), round(float(stated[1]), 5), round(float(stated[2]), 5)),
        eccentricity_std_m=ranging.eccentricity_std_m,
    )
    return sheet, readings


def slope_reading_m(distance_m: float, k1_m: float, r1: float, n0: float, ng: float) -> float:
    """What the instrument shows for a distance: D = S + K1 + R1 S + S (n0 - ng) / ng solved for S. [m]"""
    return (distance_m - k1_m) / (r1 + n0 / ng)


def air_index(wavelength_um: float, temperature_c: float, pressure_hpa: float, humidity_percent: float) -> float:
    """Group refractive index of moist air for light of a distance meter.

    Refractivity at 0 degrees Celsius and 1013.25 hPa, dry, 0.0375 % of CO2: 287.6155 + 4.88660 s + 0.06800 s^2 with
    s = 1 / wavelength^2 in 1/um^2; scaled with density, less 11.27 e / T for vapour.

    References
    ----------
    IUGG, Resolution 3 of the XXII General Assembly, Birmingham 1999. Saturation pressure: WMO-No. 8, Magnus formula.
    """
    s = wavelength_um**-2
    kelvin = temperature_c + 273.15
    vapour_hpa = 0.01 * humidity_percent * 6.112 * math.exp(17.62 * temperature_c / (temperature_c + 243.12))
    dry = (287.6155 + (4.88660 + 0.06800 * s) * s) * (pressure_hpa / 1013.25) * (273.15 / kelvin)
    return 1.0 + 1e-6 * (dry - 11.27 * vapour_hpa / kelvin)


def _air(config: Config, rng: np.random.Generator) -> tuple[float, float, float]:
    """Temperature, pressure and humidity as read off beside the instrument; they change a little from reading to reading."""
    r = config.ranging
    change = rng.standard_normal(3)
    return (
        round(r.temperature_c + 0.3 * float(change[0]), 1),
        round(r.pressure_hpa + 0.2 * float(change[1]), 1),
        round(min(max(r.relative_humidity_percent + float(change[2]), 0.0), 100.0), 1),
    )


def _sheet(model: TotalStationModel, serves: str) -> TotalStation:
    return TotalStation(
        name=model.name,
        model="simulated",
        class_mm=model.class_mm,
        class_ppm=model.std_ppm,
        additive_constant_m=model.additive_constant_mm * 1e-3,
        scale=model.scale_ppm * 1e-6,
        additive_constant_std_m=model.additive_constant_std_mm * 1e-3,
        scale_std=model.scale_std_ppm * 1e-6,
        reference_index=model.reference_index,
        wavelength_um=model.wavelength_um,
        serves=(serves,),
    )


def _leaning(heading_rad: float, towards_rad: float, lean_rad: float) -> np.ndarray:
    """A turn about the vertical after a lean of the axes about a horizontal line."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    axis = np.array([math.cos(towards_rad), math.sin(towards_rad), 0.0])
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    lean = np.eye(3) + math.sin(lean_rad) * cross + (1.0 - math.cos(lean_rad)) * cross @ cross
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ lean


def _check(line: Line) -> None:
    """The farthest panel must be measurable, the nearest too, and no echo ambiguous."""
    config, lidar, ranging = line.config, line.config.lidar, line.config.ranging
    near, far = min(ranging.distances_m), max(ranging.distances_m)
    where = "ranging.distances_m"
    if near <= lidar.min_range_m + 0.5:
        raise ConfigError(
            "a panel stands nearer than the LiDAR measures",
            where=where,
            got=f"{near:g} m",
            expected=f"more than {lidar.min_range_m + 0.5:g} m (lidar.min_range_m + 0.5)",
        )
    limit = unambiguous_range_m(scanner_from(lidar).pulse_interval_s)
    if line.setting.farthest_m > limit:
        raise ConfigError(
            "the wall behind the farthest panel lies beyond the unambiguous range",
            where=where,
            got=f"{far:g} m",
            expected=f"at most {limit - (line.setting.farthest_m - far):.1f} m at lidar.prr_hz = {lidar.prr_hz:g}",
        )
    if lidar.divergence_rad * far > 0.5 * ranging.panel_size_m:
        raise ConfigError(
            "the footprint at the farthest panel is more than half as wide as the panel",
            where=where,
            got=f"{lidar.divergence_rad * far:.2f} m at {far:g} m",
            expected=f"at most {0.5 * ranging.panel_size_m:g} m",
            remedy="shorten the line, enlarge ranging.panel_size_m, or leave ranging out of campaign.parts",
        )
    turns = 2.0 * math.pi * lidar.scanner.turn_share * math.radians(ranging.turn_rate_deg_s)
    points = lidar.prr_hz / turns * (ranging.panel_size_m / far) ** 2
    if points < MIN_POINTS:
        raise ConfigError(
            "too few points fall on the farthest panel",
            where="ranging.turn_rate_deg_s",
            got=f"{points:.1f} points a scan at {far:g} m",
            expected=f"at least {MIN_POINTS}",
            remedy=f"turn at {0.95 * ranging.turn_rate_deg_s * points / MIN_POINTS:.2g} degrees a second or slower",
        )
    step_m = math.radians(ranging.turn_rate_deg_s) / ranging.scan_rate_hz * far
    if step_m > ranging.panel_size_m / 3.0:
        raise ConfigError(
            "fewer than three scan lines cross the farthest panel",
            where="ranging.scan_rate_hz",
            got=f"lines {step_m:.2f} m apart at {far:g} m",
            expected=f"at most {ranging.panel_size_m / 3.0:.2f} m",
        )
    optics = optics_from(lidar, config.environment.visibility_km)
    farthest = max(
        range(len(line.setting.panels)), key=lambda k: float(np.linalg.norm(line.setting.panels[k].centre_m))
    )
    rho = float(
        backscatter(line.scene, lidar.wavelength_nm)[len(line.scene.materials) - len(line.setting.panels) :][farthest]
    )
    peak = optics.scale_dn_m2 * config.faults.lidar_gain * rho * math.exp(-2.0 * optics.extinction_per_m * far) / far**2
    if peak < 2.0 * lidar.threshold_sigma * lidar.noise_dn:
        raise ConfigError(
            "the farthest panel's echo is lost in the noise",
            where=where,
            got=f"{peak:.1f} digitiser steps at {far:g} m",
            expected=f"at least {2.0 * lidar.threshold_sigma * lidar.noise_dn:g}, twice the detection threshold",
            remedy="shorten the line or raise ranging.panel_reflectance_percent",
        )
