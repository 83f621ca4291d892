"""The LiDAR in flight: every strip fired and written, chunk by chunk. What a pulse does is `simulator.lidar.strip`'s."""

from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from campaign import truth as truth_files
from campaign.errors import ConfigError
from campaign.flight import las
from campaign.folder import CampaignFolder
from campaign.progress import Report
from simulator.flight import rig
from simulator.journal import Journal
from simulator.lidar.strip import StripChunk, simulate_strip
from simulator.world import Range


def fly_lidar(world: Range, place: CampaignFolder, progress: Report, journal: Journal) -> None:
    """Point clouds and waveforms of every strip, and truth/returns_SS_LL.npz."""
    config = world.config
    site = config.site
    origin = world.frame.map_from_world(np.zeros((1, 3)))[0]
    strips = [
        (sortie, estimated, strip)
        for sortie, estimated in zip(world.sorties, world.estimated, strict=True)
        for strip in sortie.strips
    ]
    place.truth.mkdir(exist_ok=True)
    for sortie in world.sorties:
        place.sortie(sortie.number).lidar.mkdir(parents=True, exist_ok=True)
    progress("lidar", 0, len(strips))
    for done, (sortie, estimated, strip) in enumerate(strips, start=1):
        unit = f"strip {sortie.number:02d} {strip.number:02d}"
        if not journal.wants(unit):
            progress("lidar", done, len(strips))
            continue
        folder = place.sortie(sortie.number)
        true_returns = place.truth / f"returns_{sortie.number:02d}_{strip.number:02d}.npz"
        spec = las.LasSpec(
            projection_epsg=site.projection_epsg,
            height_epsg=site.height_epsg,
            creation_date=config.campaign.start_time[:10],
            system_identifier=config.lidar.name[:32],
            offset_m=(round(float(origin[0]), -2), round(float(origin[1]), -2), 0.0),
            sample_count=config.lidar.samples,
            sampling_ps=round(config.lidar.sampling_ns * 1000.0),
            bit_depth=16,
            file_source_id=strip.number,
        )
        chunks = simulate_strip(
            world.render_scene,
            config,
            strip,
            sortie.motion,
            estimated,
            rig.true_lidar(config),
            rig.nominal_lidar(config),
            world.frame,
        )
        with (
            las.StripWriter(folder.strip_las(strip.number), folder.strip_points(strip.number), spec) as writer,
            truth_files.TrueReturnsWriter(true_returns) as truth,
        ):
            write_strip(chunks, writer, truth)
        las_file = folder.strip_las(strip.number)
        journal.finish(unit, [las_file, las_file.with_suffix(".wdp"), folder.strip_points(strip.number), true_returns])
        progress("lidar", done, len(strips))


def write_strip(chunks: Iterable[StripChunk], writer: las.StripWriter, truth: truth_files.TrueReturnsWriter) -> None:
    """Write a strip's chunks as they come, each on a second thread while the next ones are made.

    Raises
    ------
    ConfigError
        There is no return at all.
    """
    waiting: Future[None] | None = None
    with ThreadPoolExecutor(1) as pool:
        for chunk in chunks:
            if waiting is not None:
                waiting.result()
            waiting = pool.submit(writer.write, chunk.returns, chunk.packets)
            truth.write(chunk.truth)
        if waiting is not None:
            waiting.result()
    if truth.count == 0:
        raise ConfigError("no pulse of a strip gave an echo", remedy="check flight.heights_m and lidar.pulse_energy_uj")
