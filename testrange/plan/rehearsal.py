"""The campaign on paper: what a flown folder would hold before any sensor was switched on, in memory and without a renderer.

The same functions as in a simulation write it (layout, flight, navigation errors, survey, sheets, plan, environment log), so
that a row of the conformity table which needs no observation says the same before and after the flight.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from campaign.benches.bench import BoardExposure, BoardSheet, RoomSheet, SphereExposure
from campaign.config import Config
from campaign.flight.records import Exposure
from campaign.folder import CampaignFolder
from campaign.manifest import Manifest
from evaluator.model import BenchData, CampaignData, RangingData, SortieData
from scenes.build import build_scene
from scenes.chessboard import board_of
from scenes.model import Scene
from scenes.ranging_line import build_line
from scenes.sunsky import sun_sky
from simulator import paperwork
from simulator.bench.placements import bench_f_number, bench_focus_m, plan_placements
from simulator.camera import sensor
from simulator.faults import require_targets, with_true_lens
from simulator.flight import rig
from simulator.flight.frames import SiteFrame
from simulator.flight.motion import Motion
from simulator.flight.navigation import estimate_motion, trajectory_of
from simulator.flight.plan import SETTLE_S, Sortie, fly
from simulator.lidar.ranging import SCENE_KEY, Line, survey_line
from simulator.randomness import Stream, generator, scene_seed
from simulator.times import BEIJING, gps_time_from_iso, gps_week, utc_from_gps_time

# As in simulator.simulate, which cannot be imported without the renderer; a test compares them.
SPHERE_BEFORE_S, CHESSBOARD_BEFORE_S = 86_400.0, 72_000.0
CHESSBOARD_INTERVAL_S = 20.0


@dataclass(frozen=True, kw_only=True)
class Rehearsal:
    """The flight as planned; its path carries the autopilot's sway of the configuration's seed, as a simulation would."""

    config: Config
    frame: SiteFrame
    scene: Scene
    sorties: tuple[Sortie, ...]
    estimated: tuple[Motion, ...]
    exposing: sensor.Exposing | None
    line: Line | None
    data: CampaignData

    @property
    def images(self) -> int:
        """In flight."""
        return sum(len(s.exposures) for s in self.data.sorties)


def flies(config: Config) -> bool:
    """Whether the campaign has a flight."""
    return bool({"camera", "lidar"} & set(config.campaign.parts))


def rehearse(config: Config, folder: Path) -> Rehearsal:
    """Everything that can be written down before the campaign.

    Parameters
    ----------
    config : Config
    folder : Path
        An empty folder: no file of the campaign exists yet.

    Raises
    ------
    ConfigError
        The configuration cannot be built.
    """
    config = with_true_lens(config)
    frame = SiteFrame(config.site)
    seeded = config.model_copy(update={"seed": scene_seed(config)})
    scene = build_scene(seeded)
    sorties: tuple[Sortie, ...] = ()
    exposing = None
    if flies(config):
        require_targets(config, tuple(target.id for target in scene.targets))
        sorties = fly(seeded, scene.layout)
        if "camera" in config.campaign.parts:
            light = sun_sky(config.site, config.environment, utc_from_gps_time(sorties[0].strips[0].start_s))
            exposing = sensor.exposure_gain(config.camera, light)
    line = _line(config) if "ranging" in config.campaign.parts else None
    estimated = tuple(estimate_motion(config, sortie.motion, sortie.number) for sortie in sorties)
    data = CampaignData(
        folder=CampaignFolder(folder),
        manifest=_manifest(config),
        plan=paperwork.flight_plan(config, scene, sorties, frame) if sorties else None,
        targets=tuple(paperwork.surveyed_targets(config, scene, frame)) if sorties else (),
        spectra=paperwork.measured_spectra(config, scene) if sorties and _has_panels(scene) else None,
        camera=rig.camera_sheet(config),
        lidar=rig.lidar_sheet(config),
        rig=rig.rig_sheet(config),
        sorties=tuple(
            _sortie(config, frame, CampaignFolder(folder), sortie, motion, exposing)
            for sortie, motion in zip(sorties, estimated, strict=True)
        ),
        bench=_bench(config) if "bench" in config.campaign.parts else BenchData(),
        ranging=_ranging(config, line) if line is not None else RangingData(),
    )
    return Rehearsal(
        config=config,
        frame=frame,
        scene=scene,
        sorties=sorties,
        estimated=estimated,
        exposing=exposing,
        line=line,
        data=data,
    )


def paper_without_flight(config: Config) -> CampaignData:
    """Place and time alone, of a campaign that cannot be built."""
    return CampaignData(
        folder=CampaignFolder(Path()),
        manifest=_manifest(config),
        plan=None,
        targets=(),
        spectra=None,
        camera=None,
        lidar=None,
        rig=None,
        sorties=(),
    )


def _has_panels(scene: Scene) -> bool:
    return any(target.kind == "panel" for target in scene.targets)


def _manifest(config: Config) -> Manifest:
    site = config.site
    start_s = gps_time_from_iso(config.campaign.start_time) - SETTLE_S
    start = utc_from_gps_time(start_s).astimezone(BEIJING)
    return Manifest(
        campaign=config.campaign.id,
        title=config.campaign.title,
        synthetic=True,
        date=start.date().isoformat(),
        start_time=start.isoformat(timespec="seconds"),
        gps_week=gps_week(start_s),
        latitude_deg=site.latitude_deg,
        longitude_deg=site.longitude_deg,
        ellipsoid_height_m=site.ellipsoid_height_m,
        height_anomaly_m=site.height_anomaly_m,
        projection_epsg=site.projection_epsg,
        height_epsg=site.height_epsg,
        software={},
        files=(),
    )


def _sortie(
    config: Config,
    frame: SiteFrame,
    place: CampaignFolder,
    sortie: Sortie,
    estimated: Motion,
    exposing: sensor.Exposing | None,
) -> SortieData:
    exposures: tuple[Exposure, ...] = ()
    if exposing is not None:
        exposures = tuple(
            Exposure(
                image=f"s{sortie.number:02d}_l{strip.number:02d}_{index + 1:03d}.tif",
                gps_time_s=time + config.faults.camera_clock_s,
                strip=strip.number,
                exposure_time_s=exposing.exposure_time_s,
                gain_e_per_dn=exposing.e_per_dn,
                focus_distance_m=config.camera.focus_distance_m,
            )
            for strip in sortie.strips
            for index, time in enumerate(strip.exposure_s)
        )
    return SortieData(
        folder=place.sortie(sortie.number),
        trajectory=trajectory_of(estimated, frame, config),
        exposures=exposures,
        environment=tuple(paperwork.environment_rows(config, sortie)),
        strips=tuple(s.number for s in sortie.strips) if "lidar" in config.campaign.parts else (),
    )


def _bench(config: Config) -> BenchData:
    """Logs of both benches as they are planned: times, settings, distances; no exposure is known yet."""
    room, sphere, settings = config.bench.room, config.bench.sphere, config.bench.chessboard
    start_s = gps_time_from_iso(config.campaign.start_time)
    count = np.arange(sphere.images)
    stability_s = sphere.wait_s + sphere.stability_interval_s * count
    repeatability_s = stability_s[-1] + sphere.stability_interval_s + sphere.repeatability_interval_s * count
    board, plan, focus_m = board_of(settings), plan_placements(config), bench_focus_m(config)

    def series(times_s: np.ndarray) -> tuple[SphereExposure, ...]:
        return tuple(
            SphereExposure(
                image=f"s_{k + 1:03d}.tif",
                gps_time_s=start_s - SPHERE_BEFORE_S + float(t),
                since_lamp_on_s=float(t),
                f_number=config.camera.f_number,
            )
            for k, t in enumerate(times_s)
        )

    return BenchData(
        room=RoomSheet(
            dust_free=room.dust_free,
            single_light_source=room.single_light_source,
            temperature_c=room.temperature_c,
            relative_humidity_percent=room.relative_humidity_percent,
            pressure_hpa=room.pressure_hpa,
            sphere_traceability=sphere.traceability,
        ),
        stability=series(stability_s),
        repeatability=series(repeatability_s),
        board=BoardSheet(
            inner_columns=board.columns - 1,
            inner_rows=board.rows - 1,
            square_m=board.square_m,
            width_m=board.width_m,
            height_m=board.height_m,
        ),
        board_log=tuple(
            BoardExposure(
                image=f"b_{k + 1:03d}.tif",
                gps_time_s=start_s - CHESSBOARD_BEFORE_S + CHESSBOARD_INTERVAL_S * k,
                distance_m=placement.distance_m,
                focus_distance_m=focus_m,
                f_number=bench_f_number(config),
            )
            for k, placement in enumerate(plan)
        ),
    )


def _line(config: Config) -> Line:
    """The ranging line as it will be set up; how the instruments lean does not show in a plan."""
    seed = scene_seed(config)
    setting = build_line(config, generator(seed, Stream.RANGING, SCENE_KEY))
    return Line(
        config=config,
        setting=setting,
        scene=setting.scene,
        lidar_from_world=np.eye(3),
        station_azimuth_rad=0.0,
        turn_deg=(0.0, 0.0),
    )


def _ranging(config: Config, line: Line) -> RangingData:
    """Readings as two total stations would take them."""
    sheet, readings = survey_line(line, config)
    return RangingData(line=sheet, readings=tuple(readings))
