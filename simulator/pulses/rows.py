"""From echoes on the instrument's clock to rows: measured range, place, attributes. What post-processing does with a block.

Several turns: the faults of range stand between `select` and `place`, the map's projection between `place` and `finish`.
"""

import math

import numba
import numpy as np

ALONE_M = 0.05  # a single return this close to the beam's axis is the axis' surface


@numba.njit(cache=True, nogil=True, error_model="numpy")
def select(
    hit: np.ndarray,
    start: np.ndarray,
    count: np.ndarray,
    position: np.ndarray,
    amplitude: np.ndarray,
    sigma: np.ndarray,
    setting: np.ndarray,
    pulse: np.ndarray,
    number: np.ndarray,
    siblings: np.ndarray,
    seen_m: np.ndarray,
    at: np.ndarray,
    peak: np.ndarray,
    width_ns: np.ndarray,
) -> int:
    """Valid echoes of a block in order, each as a row of the arrays from `pulse` on; returns how many.

    `hit`: (n,) whether light came back at all; `start`, `count`, `position`, `amplitude`, `sigma`: from the device. `setting`:
    metres a sample, least range, FWHM a sigma [ns].
    """
    step_m, least_m, fwhm_ns = setting
    rows = 0
    for i in range(len(hit)):
        first = rows
        if hit[i] > 0:
            for k in range(count[i]):
                range_m = (start[i] + position[i, k]) * step_m
                if range_m >= least_m:
                    pulse[rows] = i
                    number[rows] = rows - first + 1
                    seen_m[rows] = range_m
                    at[rows] = position[i, k]
                    peak[rows] = amplitude[i, k]
                    width_ns[rows] = sigma[i, k] * fwhm_ns
                    rows += 1
        for r in range(first, rows):
            siblings[r] = rows - first
    return rows


@numba.njit(cache=True, nogil=True)
def place(pulse: np.ndarray, range_m: np.ndarray, origin: np.ndarray, direction: np.ndarray, world: np.ndarray) -> None:
    """`range_m` along the beam of each row's pulse, as post-processing knows it."""
    for r in range(len(pulse)):
        for c in range(3):
            world[r, c] = origin[pulse[r], c] + range_m[r] * direction[pulse[r], c]


@numba.njit(cache=True, nogil=True)
def inside(world: np.ndarray, low: np.ndarray, cell_m: float, mask: np.ndarray, keep: np.ndarray) -> None:
    """Whether each point's cell in a horizontal raster is set."""
    for r in range(len(world)):
        x, y = math.floor((world[r, 0] - low[0]) / cell_m), math.floor((world[r, 1] - low[1]) / cell_m)
        keep[r] = 0 <= x < mask.shape[0] and 0 <= y < mask.shape[1] and mask[int(x), int(y)]


@numba.njit(cache=True, nogil=True, inline="always")
def _copy(wave: np.ndarray, to: np.ndarray) -> None:
    for k in range(len(wave)):
        to[k] = wave[k]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def finish(
    pulse: np.ndarray,
    keep: np.ndarray,
    at: np.ndarray,
    on_map: np.ndarray,
    scanner_map: np.ndarray,
    map_origin: np.ndarray,
    waves: np.ndarray,
    stored: int,
    sample_ps: float,
    half_c: float,
    xyz: np.ndarray,
    packet: np.ndarray,
    location: np.ndarray,
    towards: np.ndarray,
    packets: np.ndarray,
) -> int:
    """Map coordinates, the packets' direction vector, and the packets that are kept: all of a pulse's rows refer to one.

    `packets`: the chunk's, `stored` of them there already. Returns how many there are now.
    """
    r = 0
    while r < len(pulse):
        last = r
        any_kept = False
        while last < len(pulse) and pulse[last] == pulse[r]:
            any_kept |= keep[last]
            last += 1
        if any_kept:
            _copy(waves[pulse[r]], packets[stored])
        for k in range(r, last):
            i = pulse[k]
            x, y, z = (
                scanner_map[i, 0] - on_map[k, 0],
                scanner_map[i, 1] - on_map[k, 1],
                scanner_map[i, 2] - on_map[k, 2],
            )
            scale = half_c / math.sqrt(x * x + y * y + z * z)
            towards[k, 0], towards[k, 1], towards[k, 2] = x * scale, y * scale, z * scale
            for c in range(3):
                xyz[k, c] = on_map[k, c] + map_origin[c]
            packet[k] = stored if any_kept else -1
            location[k] = at[k] * sample_ps if any_kept else 0.0
        stored += 1 if any_kept else 0
        r = last
    return stored


@numba.njit(cache=True, nogil=True, error_model="numpy")
def attributes(
    pulse: np.ndarray,
    amplitude: np.ndarray,
    time_s: np.ndarray,
    level: np.ndarray,
    encoder_rad: np.ndarray,
    channel: np.ndarray,
    row_time_s: np.ndarray,
    intensity: np.ndarray,
    scan_angle_deg: np.ndarray,
    encoder_deg: np.ndarray,
    row_channel: np.ndarray,
) -> None:
    """What a row takes from its pulse, and the intensity. `level`: (2, n) to the right and down, see `georeference.beams_world`."""
    degrees = 180.0 / math.pi
    last, scan_angle = -1, np.float32(0.0)
    for r in range(len(pulse)):
        i = pulse[r]
        if i != last:
            scan_angle = np.float32(degrees * math.atan2(level[0, i], level[1, i]))
            last = i
        row_time_s[r] = time_s[i]
        intensity[r] = np.uint16(min(max(np.rint(np.float32(16.0) * amplitude[r]), 0.0), 65535.0))
        scan_angle_deg[r] = scan_angle
        encoder_deg[r] = np.float32(degrees * encoder_rad[i])
        row_channel[r] = channel[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def true_surfaces(
    pulse: np.ndarray,
    siblings: np.ndarray,
    seen_m: np.ndarray,
    shift_m: np.ndarray,
    extent_m: np.ndarray,
    axis_row: np.ndarray,
    slot: np.ndarray,
    hit_m: np.ndarray,
    hit_row: np.ndarray,
    face: np.ndarray,
    normal: np.ndarray,
    target: np.ndarray,
    part: np.ndarray,
    range_m: np.ndarray,
    row_normal: np.ndarray,
    row_target: np.ndarray,
    row_part: np.ndarray,
) -> None:
    """Which surface each return came from, and what is known of it; see `caster.Caster.truth`."""
    for r in range(len(pulse)):
        i = pulse[r]
        found_m, row = extent_m[i, 0], axis_row[i]
        if slot[i] >= 0:
            from_m = seen_m[r] - shift_m[i]
            if siblings[r] > 1 or not abs(from_m - found_m) <= ALONE_M:
                best = np.inf
                for s in range(hit_m.shape[1]):
                    off = abs(hit_m[slot[i], s] - from_m)
                    if hit_row[slot[i], s] >= 0 and off < best:
                        best, found_m, row = off, float(hit_m[slot[i], s]), hit_row[slot[i], s]
        range_m[r] = found_m
        f = face[row]
        for c in range(3):
            row_normal[r, c] = normal[f, c]
        row_target[r], row_part[r] = target[f], part[f]
