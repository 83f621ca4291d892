"""The scanner's pulses cast at the planned targets: every pulse that comes near one, along the planned path, with numpy alone.

Surfaces are those of the survey's drawing: a panel's top, the two sides of a frustum's four sheets, its base plate, the ground.
What comes out has the form of LAS returns, so that the evaluator's own rooms count them. Left out: supports and rims of the
sheets, several returns of one pulse, and what part of a footprint passes an edge.
"""

from dataclasses import dataclass

import numpy as np

from campaign.flight.las import Returns
from evaluator.georeference import TargetReturns
from scenes.build import site_terrain
from scenes.frustums import VERTEX_PER_EDGE, _sheet_shift_m, plate_edge_m, top_m
from scenes.model import Target
from scenes.spectra import reflectance_at
from simulator.flight import rig
from simulator.flight.georeference import MapPatch, beams_world
from simulator.flight.motion import Motion, Strip
from simulator.lidar.device import detector_from, digitiser_from
from simulator.lidar.radar_equation import extinction_per_km
from simulator.lidar.response import response_constant_dn_m2
from simulator.lidar.scanner import TurningScanner, scanner_from
from simulator.randomness import scene_seed
from testrange.plan.rehearsal import Rehearsal

SLOPE = np.sqrt(2.0)  # rise over run of a frustum's sheets
ROUND_M = 0.1  # about a target's own sphere
NO_SURFACE = -1
PANEL_TOP, PLATE, GROUND = 12, 8, 20  # frustum sheets: 0-3 inner, 4-7 outer


@dataclass(frozen=True, kw_only=True)
class Passes:
    """What every strip sees of every target."""

    returns: dict[tuple[int, int, str], TargetReturns]  # echoes strong enough for the device's own threshold
    faces: dict[tuple[int, int, str], np.ndarray]  # frustums: (4,) echoes on each sheet, both sides
    strip_window_s: dict[tuple[int, int], tuple[float, float]]  # while the beam is near any target
    scan_interval_s: dict[tuple[int, int], float]  # from the first target's middle to the last one's
    longest_range_m: float  # to the ground, within the sector, over all strips
    pulses: dict[tuple[int, int], int]  # fired inside the sector
    amplitude_dn: dict[str, tuple[float, float]]  # panels: least and greatest mean over strips
    near_pulses: int  # whose packets are kept where only targets' are


@dataclass(frozen=True, kw_only=True)
class _Near:
    """Pulses of one strip that come near a target, one row for each pair."""

    index: np.ndarray  # (n,) number of the pulse
    target: np.ndarray  # (n,) into the scene's targets


def _enclosing(rehearsal: Rehearsal) -> tuple[np.ndarray, np.ndarray]:
    """Centres (t, 3) and radii (t,) of spheres about the targets. [m]"""
    frustums = rehearsal.config.targets.frustums
    centre, radius = [], []
    for target in rehearsal.scene.targets:
        height = top_m(frustums) if target.kind == "frustum" else 0.0
        half = plate_edge_m(frustums) / 2.0 if target.kind == "frustum" else target.size_m / 2.0
        centre.append(target.mark_m + np.array([0.0, 0.0, 0.5 * height]))
        radius.append(np.hypot(SLOPE * half, 0.5 * height) + ROUND_M)
    return np.array(centre).reshape(-1, 3), np.array(radius)


@dataclass(frozen=True, kw_only=True)
class _Sight:
    """Every scan line of a strip against every target: (lines, targets)."""

    time_s: np.ndarray  # since the strip's start, when the beam passes the target
    encoder_rad: np.ndarray
    elevation_rad: np.ndarray  # of the target out of the plane of a beam without tilt
    range_m: np.ndarray
    across_m: np.ndarray  # distance from the axis of turning


def _sight(scanner: TurningScanner, rehearsal: Rehearsal, motion: Motion, strip: Strip, place_m: np.ndarray) -> _Sight:
    mounting = rig.nominal_lidar(rehearsal.config)
    lines = np.arange(int(np.ceil((strip.end_s - strip.start_s) * scanner.scan_rate_hz)) + 1)
    encoder = np.zeros((len(lines), len(place_m)))
    for _ in range(3):
        share = (encoder - scanner.start_rad) / scanner.sweep_rad
        time = (lines[:, None] + share) / scanner.scan_rate_hz
        at = np.clip(strip.start_s + time.ravel(), motion.gps_time_s[0], motion.gps_time_s[-1])
        body = motion.world_from_body(at)
        in_body = np.einsum("nji,nj->ni", body, np.tile(place_m, (len(lines), 1)) - motion.position(at))
        x, y, z = ((in_body - mounting.lever_arm_m) @ mounting.rotation).T.reshape(3, *encoder.shape)
        encoder = np.arctan2(y, z)
    distance = np.sqrt(x**2 + y**2 + z**2)
    return _Sight(
        time_s=time,
        encoder_rad=encoder,
        elevation_rad=np.arcsin(np.clip(x / distance, -1.0, 1.0)),
        range_m=distance,
        across_m=np.hypot(y, z),
    )


def _near(scanner: TurningScanner, sight: _Sight, radius_m: np.ndarray, pulses: int) -> _Near:
    """Pulses whose beam passes within a radius of a target."""
    beams = np.asarray(scanner.elevation_rad)
    half = np.arcsin(np.clip(radius_m / sight.range_m, 0.0, 1.0))
    off = np.abs(sight.elevation_rad[..., None] - beams).min(axis=-1)
    step = scanner.sweep_rad * scanner.scan_rate_hz / scanner.prr_hz
    across = np.arctan(radius_m / np.maximum(sight.across_m, 1e-6))
    first = np.floor((sight.encoder_rad - across - scanner.sector_rad[0]) / step).astype(np.int64) - 1
    last = np.ceil((sight.encoder_rad + across - scanner.sector_rad[0]) / step).astype(np.int64) + 1
    kept = scanner.pulses_per_line
    first, last = np.clip(first, 0, kept), np.clip(last, 0, kept)
    line, target = np.nonzero((off <= half) & (last > first))
    low, count = first[line, target], (last - first)[line, target]
    start = np.cumsum(count) - count
    within = np.arange(int(count.sum())) - np.repeat(start - low, count)
    index = np.repeat(line * kept, count) + within
    owner = np.repeat(target, count)
    legal = index < pulses
    index, owner = index[legal], owner[legal]
    if len(beams) > 1:
        tilt = beams[scanner.pulses(index).channel]
        which = np.repeat(line, count)[legal]
        reach = half[which, owner]
        close = np.abs(tilt - sight.elevation_rad[which, owner]) <= reach
        index, owner = index[close], owner[close]
    return _Near(index=index, target=owner)


@dataclass(frozen=True, kw_only=True)
class _Hits:
    """Where beams meet a surface, rows as given."""

    range_m: np.ndarray
    part: np.ndarray
    cosine: np.ndarray  # of the angle of incidence


class _Surfaces:
    """The targets' surfaces in their own axes: x right, y along the azimuth, z up from the mark."""

    def __init__(self, rehearsal: Rehearsal) -> None:
        config, scene = rehearsal.config, rehearsal.scene
        seeded = config.model_copy(update={"seed": scene_seed(config)})
        self._terrain = site_terrain(seeded)
        self._targets = scene.targets
        self._mark = np.array([t.mark_m for t in scene.targets])
        azimuth = np.radians([t.azimuth_deg for t in scene.targets])
        zero, c, s = np.zeros_like(azimuth), np.cos(azimuth), np.sin(azimuth)
        up = np.stack([zero, zero, zero + 1.0], axis=1)
        self._target_from_world = np.stack(
            [np.stack([c, -s, zero], axis=1), np.stack([s, c, zero], axis=1), up], axis=1
        )
        self._frustum = np.array([t.kind == "frustum" for t in scene.targets])
        self._half = np.array([0.5 * t.size_m for t in scene.targets])
        self._frustums = config.targets.frustums
        line_nm = config.lidar.wavelength_nm
        grounds = {m.name: float(reflectance_at(m, line_nm)) * (1.0 + m.opposition_gain) for m in scene.materials}
        self._ground_rho = float(reflectance_at(scene.materials[0], line_nm)) * (
            1.0 + scene.materials[0].opposition_gain
        )
        coating = next((v for k, v in grounds.items() if k == self._frustums.material), 0.9)
        self._rho = np.array([self._reflectance(t, line_nm, coating) for t in scene.targets])

    @staticmethod
    def _reflectance(target: Target, wavelength_nm: float, coating: float) -> float:
        if target.spectrum is None:
            return coating
        return float(reflectance_at(target.spectrum, wavelength_nm)) * (1.0 + target.spectrum.opposition_gain)

    def hit(self, origin_m: np.ndarray, direction: np.ndarray, owner: np.ndarray) -> _Hits:
        turn = self._target_from_world[owner]
        o = np.einsum("nij,nj->ni", turn, origin_m - self._mark[owner])
        d = np.einsum("nij,nj->ni", turn, direction)
        frustum = self._frustum[owner]
        range_m = np.full(len(o), np.inf)
        part = np.full(len(o), NO_SURFACE)
        cosine = np.zeros(len(o))

        def meets(t: np.ndarray, inside: np.ndarray, number: int, cos: np.ndarray) -> None:
            nearer = inside & (t > 0.0) & (t < range_m)
            range_m[nearer], part[nearer], cosine[nearer] = t[nearer], number, cos[nearer]

        down = np.where(np.abs(d[:, 2]) > 1e-9, d[:, 2], 1e-9)
        # tops of panels and boards, base plates of frustums: the plane of the mark
        flat = -o[:, 2] / down
        at = o[:, :2] + flat[:, None] * d[:, :2]
        edge = np.where(frustum, 0.5 * plate_edge_m(self._frustums), self._half[owner])
        on = np.all(np.abs(at) <= edge[:, None], axis=1)
        meets(flat, on & ~frustum, PANEL_TOP, np.abs(d[:, 2]))
        meets(flat, on & frustum, PLATE, np.abs(d[:, 2]))
        if frustum.any():
            self._sheets(o, d, frustum, meets)
        # the ground: level at the height below the beam
        world = origin_m
        height = self._terrain.height(self._mark[owner, 0], self._mark[owner, 1])
        steep = np.where(direction[:, 2] < -1e-6, direction[:, 2], -1e-6)
        for _ in range(2):
            t = (height - world[:, 2]) / steep
            spot = world + t[:, None] * direction
            height = self._terrain.height(spot[:, 0], spot[:, 1])
        t = (height - world[:, 2]) / steep
        meets(t, np.isfinite(t), GROUND, np.abs(direction[:, 2]))
        return _Hits(range_m=range_m, part=part, cosine=cosine)

    def _sheets(self, o: np.ndarray, d: np.ndarray, frustum: np.ndarray, meets) -> None:  # type: ignore[no-untyped-def]
        """The four sheets, each with two sides: z = base + rise * run in the sheet's own vertical plane."""
        f = self._frustums
        b, shift = f.long_edge_m, _sheet_shift_m(f)
        if f.style == "inverted":
            low, high, rise = 0.5 * b * VERTEX_PER_EDGE, b * VERTEX_PER_EDGE, SLOPE
            bases = (0.0, -SLOPE * shift)  # inner, outer
        else:
            low, high, rise = 0.0, 0.5 * b * VERTEX_PER_EDGE, -SLOPE
            bases = (SLOPE * (0.5 * b - shift), SLOPE * 0.5 * b)
        for side, (ux, uy) in enumerate(((0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0))):
            ou, du = ux * o[:, 0] + uy * o[:, 1], ux * d[:, 0] + uy * d[:, 1]
            ov, dv = uy * o[:, 0] - ux * o[:, 1], uy * d[:, 0] - ux * d[:, 1]
            slope = d[:, 2] - rise * du
            slope = np.where(np.abs(slope) > 1e-9, slope, 1e-9)
            for number, base in ((side, bases[0]), (side + 4, bases[1])):
                t = (base + rise * ou - o[:, 2]) / slope
                z, run, lateral = o[:, 2] + t * d[:, 2], ou + t * du, np.abs(ov + t * dv)
                on = frustum & (z >= low) & (z <= high) & (lateral <= run)
                meets(t, on, number, np.abs(slope) / np.sqrt(3.0))

    def reflectance(self, part: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """At the laser's line, towards the source. [1]"""
        return np.where(part == GROUND, self._ground_rho, self._rho[owner])


def _amplitude_dn(rehearsal: Rehearsal, range_m: np.ndarray, reflectance: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Expected peak above the baseline, of a beam that falls on one surface. [DN]"""
    lidar = rehearsal.config.lidar
    scale = response_constant_dn_m2(lidar)
    fade = extinction_per_km(lidar.wavelength_nm * 1e-3, rehearsal.config.environment.visibility_km) * 1e-3
    gain = rehearsal.config.faults.lidar_gain
    return np.asarray(gain * scale * reflectance * cosine * np.exp(-2.0 * fade * range_m) / range_m**2)


def amplitude_limits_dn(rehearsal: Rehearsal) -> tuple[float, float]:
    """Detection threshold and last step, both above the baseline. [DN]"""
    lidar = rehearsal.config.lidar
    detector = detector_from(lidar)
    last = digitiser_from(lidar).full_scale_dn - detector.baseline_dn
    return detector.threshold_sigma * detector.noise_dn, float(last)


def cast_passes(rehearsal: Rehearsal, collect_radius_m: float) -> Passes:
    """Cast every strip's pulses at the targets.

    Parameters
    ----------
    rehearsal : Rehearsal
    collect_radius_m : float
        Horizontal radius about a target within which the evaluator collects returns: it makes the strips' windows. [m]

    Raises
    ------
    ConfigError
        A scanner that cannot be.
    """
    config = rehearsal.config
    scanner = scanner_from(config.lidar)
    assert isinstance(scanner, TurningScanner)
    chart = MapPatch(rehearsal.frame)
    surfaces = _Surfaces(rehearsal)
    centre, radius = _enclosing(rehearsal)
    mounting = rig.nominal_lidar(config)
    threshold, _ = amplitude_limits_dn(rehearsal)
    ids = [t.id for t in rehearsal.scene.targets]
    returns: dict[tuple[int, int, str], TargetReturns] = {}
    faces: dict[tuple[int, int, str], np.ndarray] = {}
    windows: dict[tuple[int, int], tuple[float, float]] = {}
    intervals: dict[tuple[int, int], float] = {}
    fired: dict[tuple[int, int], int] = {}
    amplitudes: dict[str, list[float]] = {}
    longest, near_pulses = 0.0, 0
    for sortie, motion in zip(rehearsal.sorties, rehearsal.estimated, strict=True):
        for strip in sortie.strips:
            key = (sortie.number, strip.number)
            fired[key] = scanner.pulse_count(strip.end_s - strip.start_s)
            longest = max(longest, longest_slant_m(rehearsal, scanner, motion, strip))
            if not ids:
                continue
            sight = _sight(scanner, rehearsal, motion, strip, centre)
            window, interval = _window(scanner, sight, strip, collect_radius_m)
            if window is not None:
                windows[key] = window
            if interval is not None:
                intervals[key] = interval
            near = _near(scanner, sight, radius, fired[key])
            pulses = scanner.pulses(near.index)
            time = strip.start_s + pulses.time_s
            origin, direction, _ = beams_world(motion, time, mounting, pulses.direction_lidar)
            hits = surfaces.hit(origin, direction, near.target)
            amplitude = _amplitude_dn(
                rehearsal, hits.range_m, surfaces.reflectance(hits.part, near.target), hits.cosine
            )
            seen = np.isfinite(hits.range_m) & (amplitude > threshold) & (hits.range_m >= config.lidar.min_range_m)
            noise = np.random.default_rng([config.seed, sortie.number, strip.number]).standard_normal(len(time))
            measured = hits.range_m + config.lidar.range_noise_m * noise
            world = origin + np.where(seen, measured, 0.0)[:, None] * direction
            xyz = chart.relative(world) + chart.origin_m
            for k, name in enumerate(ids):
                mine = near.target == k
                if (top := mine & (hits.part == PANEL_TOP)).any():
                    amplitudes.setdefault(name, []).append(float(amplitude[top].mean()))
                rows = np.flatnonzero(seen & mine)
                if not rows.size:
                    continue
                near_pulses += rows.size
                part = hits.part[rows]
                if rehearsal.scene.targets[k].kind == "frustum":
                    faces[(*key, name)] = np.bincount(part[part < 8] % 4, minlength=4)
                returns[(*key, name)] = TargetReturns(
                    target=name,
                    sortie=key[0],
                    strip=key[1],
                    record=near.index[rows],
                    returns=_rows(
                        xyz[rows],
                        time[rows],
                        amplitude[rows],
                        np.degrees(pulses.encoder_angle_rad[rows]),
                        pulses.channel[rows],
                        strip.number,
                    ),
                )
    return Passes(
        returns=returns,
        faces=faces,
        strip_window_s=windows,
        scan_interval_s=intervals,
        longest_range_m=longest,
        pulses=fired,
        amplitude_dn={name: (min(found), max(found)) for name, found in sorted(amplitudes.items())},
        near_pulses=near_pulses,
    )


def _rows(
    xyz_m: np.ndarray,
    time_s: np.ndarray,
    amplitude_dn: np.ndarray,
    encoder_deg: np.ndarray,
    channel: np.ndarray,
    strip: int,
) -> Returns:
    """LAS rows of single returns without packets."""
    n = len(time_s)
    one, zero = np.ones(n, np.uint8), np.zeros(n, np.float32)
    return Returns(
        xyz_m=xyz_m,
        gps_time_s=time_s,
        intensity=np.clip(np.round(16.0 * amplitude_dn), 0, 65535).astype(np.uint16),
        return_number=one,
        number_of_returns=one,
        scan_angle_deg=zero,
        encoder_angle_deg=encoder_deg.astype(np.float32),
        channel=channel,
        amplitude=amplitude_dn.astype(np.float32),
        pulse_width_ns=zero,
        reflectance_db=zero,
        strip=np.full(n, strip, np.uint16),
        packet=np.full(n, -1, np.int64),
        return_location_ps=zero,
        wave_direction_m_ps=np.zeros((n, 3), np.float32),
    )


def _window(
    scanner: TurningScanner, sight: _Sight, strip: Strip, radius_m: float
) -> tuple[tuple[float, float] | None, float | None]:
    """From the first to the last pulse within a horizontal radius of any target, and the time between the middles of the
    first target and the last; None where no pulse, or one target alone, is in reach."""
    beams = np.asarray(scanner.elevation_rad)
    # along the track, each channel crosses at its own place: the nearest one is what counts
    off = np.abs(np.tan(sight.elevation_rad[..., None]) - np.tan(beams)).min(axis=-1) * sight.across_m
    left, right = scanner.sector_rad
    beside = np.maximum(np.maximum(left - sight.encoder_rad, sight.encoder_rad - right), 0.0) * sight.across_m
    # beyond the sector's edge the nearest point lies at the edge; obliquity widens it on the ground
    beside = beside / np.maximum(np.cos(np.clip(sight.encoder_rad, left, right)), 0.2)
    inside = off**2 + beside**2 <= radius_m**2
    inside &= (sight.time_s >= 0.0) & (strip.start_s + sight.time_s <= strip.end_s)
    if not inside.any():
        return None, None
    chord = np.where(inside, np.sqrt(np.maximum(radius_m**2 - off**2, 0.0)), 0.0)
    reached = chord.sum(axis=0) > 0.0
    middle = (chord * sight.time_s).sum(axis=0)[reached] / chord.sum(axis=0)[reached]
    times = sight.time_s[inside]
    window = (strip.start_s + float(times.min()), strip.start_s + float(times.max()))
    return window, float(np.ptp(middle)) if middle.size > 1 else None


def longest_slant_m(rehearsal: Rehearsal, scanner: TurningScanner, motion: Motion, strip: Strip) -> float:
    """Longest way to level ground at the site's lowest place, over the sector's edges and the strip.

    The ground is taken to go on beyond the modelled terrain as far as 60 degrees off nadir; farther out it ends with the terrain.
    """
    inside = (motion.gps_time_s >= strip.start_s) & (motion.gps_time_s <= strip.end_s)
    time = motion.gps_time_s[inside]
    if not time.size:
        return 0.0
    site = rehearsal.config.site
    edge = np.array([scanner.sector_rad[0], scanner.sector_rad[1]])
    longest = 0.0
    ground = -0.5 * site.extent_m * np.sqrt(2.0) * np.tan(np.radians(site.slope_deg)) - 3.0 * site.relief_m
    mounting = rig.nominal_lidar(rehearsal.config)
    for channel in range(len(scanner.elevation_rad)):
        for angle in edge:
            beam = scanner.direction(np.full(time.size, angle), np.full(time.size, channel))
            origin, direction, _ = beams_world(motion, time, mounting, beam)
            above = origin[:, 2] - ground
            down = -direction[:, 2]
            flat = np.where(down > 0.5, above / np.maximum(down, 1e-9), 0.0)
            ended = np.hypot(site.extent_m / np.sqrt(2.0) + np.hypot(origin[:, 0], origin[:, 1]), above)
            low = np.where(down > 0.0, np.minimum(above / np.maximum(down, 1e-9), ended), 0.0)
            longest = max(longest, float(np.where(down > 0.5, flat, low).max()))
    return longest
