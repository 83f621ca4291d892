"""Simulate one configuration and write its campaign folder: benches and ranging line the day before, then the flight.

Each part stands alone: what is not asked for leaves no trace in the folder.
"""

from importlib.metadata import version
from pathlib import Path

from campaign import manifest, sensors, survey
from campaign import truth as truth_files
from campaign.benches.bench import RoomSheet, write_room
from campaign.config import Config
from campaign.flight import records, trajectory
from campaign.folder import CampaignFolder, SortieFolder
from campaign.progress import Report, silent
from campaign.threads import one_blas_thread
from scenes.model import Scene
from simulator import paperwork, record_truth
from simulator.faults import with_panel_gains, with_true_lens
from simulator.flight import rig
from simulator.flight.frames import SiteFrame
from simulator.flight.motion import Motion
from simulator.flight.navigation import trajectory_of
from simulator.flight.plan import SETTLE_S, Sortie
from simulator.journal import Journal
from simulator.times import BEIJING, gps_time_from_iso, gps_week, utc_from_gps_time
from simulator.world import Range, prepare_range

__all__ = ["prepare_range", "simulate_campaign"]

SOFTWARE = ("testrange", "mitsuba", "drjit", "numpy")
# Before the flight: the sensors are tested one by one before they are tested together (5.1).
SPHERE_BEFORE_S, CHESSBOARD_BEFORE_S, RANGING_BEFORE_S = 86_400.0, 72_000.0, 64_800.0


@one_blas_thread()
def simulate_campaign(
    config: Config,
    out: Path,
    progress: Report = silent,
    only: frozenset[str] | None = None,
    journal: Journal | None = None,
) -> None:
    """Write a complete campaign folder into the existing folder `out`, empty but for what `journal` knows as finished (the caller
    makes it appear or not at all).

    Parameters
    ----------
    only : frozenset of str, optional
        Of "camera", "lidar" (what flies), "bench" or one of it, "sphere", "chessboard", "ranging"; `campaign.parts` of the
        configuration when absent. A flight without any sensor still leaves its trajectory and survey.
    journal : Journal, optional
        What it says is finished is not made again. One that shares makes its units and leaves the rest to another process.
    """
    parts = frozenset(config.campaign.parts) if only is None else only
    parts |= {"sphere", "chessboard"} if "bench" in parts else frozenset()
    place, journal = CampaignFolder(out), journal or Journal()
    start_s = gps_time_from_iso(config.campaign.start_time)
    flies = bool(parts & {"camera", "lidar"}) or not parts & {"sphere", "chessboard", "ranging"}
    progress("scene", 0, 1)
    optics = with_true_lens(config)  # sheets, plan and truth/campaign.toml state the configured lens
    _refuse_early(optics, parts)
    world = prepare_range(config) if flies else None
    progress("scene", 1, 1)
    if not journal.shares:
        _write_sensors(config, place)
    bench = None
    if parts & {"sphere", "chessboard"}:
        bench = _simulate_bench(optics, place, start_s, progress, journal, parts)
    ranging = None
    if "ranging" in parts:
        from simulator.lidar.ranging import simulate_ranging, true_ranging

        simulate_ranging(config, place, start_s - RANGING_BEFORE_S, progress, journal)
        ranging = true_ranging(config)
    scene: Scene | None = None
    motions: dict[int, Motion] = {}
    if world is not None:
        scene, motions = _fly(world, place, parts, progress, journal)
    if journal.shares:
        return
    record_truth.write(config, scene, motions, SiteFrame(config.site), out, bench, ranging)
    _write_manifest(config, start_s, out, progress)


def _refuse_early(config: Config, parts: frozenset[str]) -> None:
    """What cannot be built is refused before the first minute of rendering.

    Raises
    ------
    ConfigError
        A board that does not fit the field, a line that the LiDAR cannot measure.
    """
    if "chessboard" in parts:
        from simulator.bench.placements import plan_placements

        plan_placements(config)
    if "ranging" in parts:
        from simulator.lidar.ranging import prepare_line

        prepare_line(config)


def _simulate_bench(
    config: Config, place: CampaignFolder, start_s: float, progress: Report, journal: Journal, parts: frozenset[str]
) -> truth_files.TrueBench:
    """Sphere and chessboard, or one of them, in one room (6.3)."""
    if not journal.shares:
        _write_room(config, place)
    drift, lens, focus_m = None, None, None
    if "sphere" in parts:
        from simulator.bench.sphere import simulate_sphere

        drift = simulate_sphere(config, place, start_s - SPHERE_BEFORE_S, progress, journal)
    if "chessboard" in parts:
        from simulator.bench.chessboard import simulate_chessboard

        lens, focus_m = simulate_chessboard(config, place, start_s - CHESSBOARD_BEFORE_S, progress, journal)
    return truth_files.TrueBench(lens=lens, focus_distance_m=focus_m, drift_percent_per_h=drift)


def _write_room(config: Config, place: CampaignFolder) -> None:
    room = config.bench.room
    write_room(
        place.room,
        RoomSheet(
            dust_free=room.dust_free,
            single_light_source=room.single_light_source,
            temperature_c=room.temperature_c,
            relative_humidity_percent=room.relative_humidity_percent,
            pressure_hpa=room.pressure_hpa,
            sphere_traceability=config.bench.sphere.traceability,
        ),
    )


def _fly(
    world: Range, place: CampaignFolder, parts: frozenset[str], progress: Report, journal: Journal
) -> tuple[Scene, dict[int, Motion]]:
    """Survey, plan and trajectories, then what the sensors saw."""
    from simulator.camera.fly_camera import fly_camera
    from simulator.lidar.fly_lidar import fly_lidar

    if not journal.shares:
        _write_paperwork(world, place)
    if "camera" in parts:
        fly_camera(world, place, progress, journal)
    if "lidar" in parts:
        fly_lidar(world, place, progress, journal)
    return world.scene, {sortie.number: sortie.motion for sortie in world.sorties}


def _write_paperwork(world: Range, place: CampaignFolder) -> None:
    """Survey, plan, trajectories and the air: seconds, so they are written anew each time."""
    config = world.config
    _write_survey(world, place)
    records.write_plan(place.plan, paperwork.flight_plan(config, world.scene, world.sorties, world.frame))
    for sortie, estimated in zip(world.sorties, world.estimated, strict=True):
        folder = place.sortie(sortie.number)
        folder.root.mkdir(parents=True, exist_ok=True)
        _write_trajectory(world, folder, estimated, sortie)
        records.write_environment(folder.environment, paperwork.environment_rows(config, sortie))


def _write_survey(world: Range, place: CampaignFolder) -> None:
    site = world.config.site
    place.targets.parent.mkdir(parents=True, exist_ok=True)
    targets = paperwork.surveyed_targets(world.config, world.scene, world.frame)
    survey.write_targets(place.targets, targets, site.projection_epsg, site.height_epsg)
    survey.write_gcp_list(place.gcp_list, targets, site.projection_epsg)
    if any(target.kind == "panel" for target in world.scene.targets):
        as_read = with_panel_gains(world.config, world.scene, -1.0)
        survey.write_spectra(place.spectra, paperwork.measured_spectra(world.config, as_read))


def _write_sensors(config: Config, place: CampaignFolder) -> None:
    place.camera.parent.mkdir(parents=True, exist_ok=True)
    sensors.write_sheet(place.camera, rig.camera_sheet(config))
    sensors.write_sheet(place.lidar, rig.lidar_sheet(config))
    sensors.write_sheet(place.rig, rig.rig_sheet(config))


def _write_trajectory(world: Range, folder: SortieFolder, estimated: Motion, sortie: Sortie) -> None:
    written = trajectory_of(estimated, world.frame, world.config)
    week = gps_week(float(world.sorties[0].motion.gps_time_s[0]))
    trajectory.write_sbet(folder.trajectory_sbet, written, week)
    trajectory.write_smrmsg(folder.trajectory_rms, written, week)
    trajectory.write_csv(folder.trajectory_csv, written)


def _write_manifest(config: Config, start_s: float, out: Path, progress: Report) -> None:
    site = config.site
    start = utc_from_gps_time(start_s - SETTLE_S).astimezone(BEIJING)
    manifest.write_manifest(
        out,
        manifest.Manifest(
            campaign=config.campaign.id,
            title=config.campaign.title,
            synthetic=True,
            date=start.date().isoformat(),
            start_time=start.isoformat(timespec="seconds"),
            gps_week=gps_week(start_s - SETTLE_S),
            latitude_deg=site.latitude_deg,
            longitude_deg=site.longitude_deg,
            ellipsoid_height_m=site.ellipsoid_height_m,
            height_anomaly_m=site.height_anomaly_m,
            projection_epsg=site.projection_epsg,
            height_epsg=site.height_epsg,
            software={name: version(name) for name in SOFTWARE},
            files=(),
        ),
        progress,
    )
