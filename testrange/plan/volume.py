"""How many bytes the campaign will fill. Counts are the plan's; bytes a record are those of the folder's own formats."""

import numpy as np

from simulator.flight import rig
from simulator.flight.georeference import beams_world
from simulator.lidar.scanner import scanner_from
from testrange.plan.beams import Passes
from testrange.plan.model import Volume
from testrange.plan.rehearsal import Rehearsal

LAS_RECORD_BYTES = 59 + 17  # PDRF 9 and the extra bytes of campaign.flight.las
LAZ_RECORD_BYTES = 13.3  # PDRF 6 with extra bytes, compressed: as measured on simulated strips
TRUTH_RECORD_BYTES = 26.0  # truth/returns_*.npz, compressed: as measured
JPEG_BYTES_PIXEL = 0.22  # previews: as measured
EPOCH_BYTES = 136 + 80 + 134  # trajectory: SBET, smrmsg, CSV
TIFF_HEADER_BYTES = 1600
EVERY = 61  # pulse of a strip looked at, to count the packets near targets


def _near_share(rehearsal: Rehearsal, sortie: int, strip: int) -> float:
    """Share of a strip's pulses whose waveform is kept: all of them, or those that fall near a target."""
    config = rehearsal.config
    if config.recording.waveforms == "all":
        return 1.0
    flown = rehearsal.sorties[sortie - 1]
    motion, line = rehearsal.estimated[sortie - 1], flown.strips[strip - 1]
    scanner = scanner_from(config.lidar)
    pulses = scanner.pulses(np.arange(0, scanner.pulse_count(line.end_s - line.start_s), EVERY))
    origin, direction, _ = beams_world(
        motion, line.start_s + pulses.time_s, rig.nominal_lidar(config), pulses.direction_lidar
    )
    down = np.minimum(direction[:, 2], -0.05)
    ground = origin[:, :2] - (origin[:, 2] / down)[:, None] * direction[:, :2]
    near = np.zeros(len(ground), bool)
    for target in rehearsal.scene.targets:
        reach = target.size_m + config.recording.target_margin_m + 0.1
        near |= np.sum((ground - target.mark_m[:2]) ** 2, axis=1) <= reach**2
    return float(near.mean())


def expected_volume(rehearsal: Rehearsal, passes: Passes | None) -> Volume:
    """Bytes on the disk of a simulation; a field campaign delivers all but truth/ and the previews."""
    config = rehearsal.config
    pixels = config.camera.width_px * config.camera.height_px
    image_bytes = pixels * len(config.camera.bands) * 2 + TIFF_HEADER_BYTES
    returns = waveforms = 0
    if passes is not None:
        returns = sum(passes.pulses.values())
        waveforms = round(sum(n * _near_share(rehearsal, *key) for key, n in passes.pulses.items()))
    epochs = sum(len(s.motion.gps_time_s) for s in rehearsal.sorties)
    bench = 0
    if "bench" in config.campaign.parts:
        window = config.bench.sphere.window_px or (config.camera.width_px, config.camera.height_px)
        area = min(window[0], config.camera.width_px) * min(window[1], config.camera.height_px)
        sphere = 2 * config.bench.sphere.images * area * len(config.camera.bands) * 2
        bench = sphere + len(rehearsal.data.bench.board_log) * image_bytes
    return Volume(
        images=rehearsal.images * image_bytes,
        previews=round(rehearsal.images * pixels * JPEG_BYTES_PIXEL),
        points=round(returns * (LAS_RECORD_BYTES + LAZ_RECORD_BYTES)),
        waveforms=waveforms * config.lidar.samples * 2,
        trajectory=epochs * EPOCH_BYTES,
        bench=bench,
        truth=round(returns * TRUTH_RECORD_BYTES),
        image_count=rehearsal.images,
        return_count=returns,
        waveform_count=waveforms,
    )
