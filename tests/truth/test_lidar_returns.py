"""LAS rows of a simulated strip against what is known: place, range, packets, angles, amplitudes, faults."""

import numpy as np
import pytest

from campaign.config import (
    Band,
    Camera,
    CampaignInfo,
    Config,
    Environment,
    Faults,
    Lens,
    Lidar,
    LidarRecording,
    Scanner,
)
from campaign.errors import ConfigError
from campaign.flight.las import Returns
from campaign.truth import TrueReturns
from scenes.model import Layout, Material, Mesh, Scene, Target
from simulator.flight.frames import SiteFrame, rotation_from_rpy
from simulator.flight.motion import Motion, SensorMounting, Strip
from simulator.lidar.radar_equation import received_power_w
from simulator.lidar.strip import HALF_C_M_PS, StripChunk, simulate_strip
from simulator.render import start
from simulator.render.scene import load_scene

CAMERA = Camera(
    width_px=64,
    height_px=64,
    pixel_size_um=4.0,
    nominal_focal_length_mm=10.0,
    lens=Lens(fx_px=100.0, fy_px=100.0, cx_px=32.0, cy_px=32.0),
    bands=(Band(name="green", centre_nm=550.0, fwhm_nm=80.0),),
)
QUIET = {
    "noise_dn": 0.0,
    "shot_noise_dn": 0.0,
    "solar_background_dn": 0.0,
    "gain_jitter": 0.0,
    "range_noise_m": 0.0,
    "encoder_std_deg": 0.0,
    "bit_depth": 16,
    "full_scale_power_nw": 30_000.0,
}
START_S = 400_000_000.0
HEIGHT_M = 50.0
NOMINAL = SensorMounting(rotation=np.eye(3), lever_arm_m=np.array([-0.05, -0.02, 0.12]))
PLATE_M = 3.0  # height of the plate above the ground


def config(lidar: dict | None = None, faults: dict | None = None, **recording: object) -> Config:
    settings = {"prr_hz": 100_000.0, "scanner": Scanner(sector_deg=(-35.0, 35.0), scan_rate_hz=100.0), **QUIET}
    return Config(
        campaign=CampaignInfo(id="strip"),
        camera=CAMERA,
        environment=Environment(visibility_km=1e6),
        lidar=Lidar(**{**settings, **(lidar or {})}),
        faults=Faults(**(faults or {})),
        recording=LidarRecording(**recording),
    )


def material(name: str, reflectance: float, gain: float = 0.0) -> Material:
    return Material(
        name=name,
        wavelength_nm=np.array([400.0, 1700.0]),
        reflectance=np.full(2, reflectance),
        opposition_gain=gain,
    )


def square(x: float, y: float, z: float, half: float) -> np.ndarray:
    return np.array([x, y, z]) + half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])


def plate_scene() -> Scene:
    """Ground of 30 %, and a panel 3 m above it, 4 m east of the line of flight: 48 %, and a quarter more in backscatter."""
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    mesh = Mesh(
        vertices_m=np.concatenate([square(0, 0, 0, 90.0), square(4.0, 0.5, PLATE_M, 1.0)]),
        faces=np.concatenate([faces, faces + 4]).astype(np.int32),
        material=np.array([0, 0, 1, 1], np.int32),
        target=np.array([-1, -1, 0, 0], np.int32),
        part=np.array([-1, -1, 12, 12], np.int8),
    )
    panel = Target(id="P01", kind="panel", mark_m=np.array([4.0, 0.5, PLATE_M]), azimuth_deg=0.0, size_m=2.0)
    layout = Layout(camera_half_m=(1.0, 1.0), lidar_half_m=1.0, cone_half_m=1.0, field_half_m=(1.0, 1.0))
    return Scene(
        mesh=mesh, materials=(material("soil", 0.3), material("grey", 0.48, 0.25)), targets=(panel,), layout=layout
    )


def straight_motion(rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0), duration: float = 10.0) -> Motion:
    """North at 5 m/s over the origin, constant attitude."""
    time = START_S - 1.0 + np.arange(0.0, duration + 2.0, 0.005)
    zero = np.zeros_like(time)
    return Motion(
        gps_time_s=time,
        position_world_m=np.stack([zero, 5.0 * (time - START_S) - 1.0, zero + HEIGHT_M], axis=-1),
        velocity_world_m_s=np.stack([zero, zero + 5.0, zero], axis=-1),
        rpy_rad=np.broadcast_to(np.radians(rpy_deg), (len(time), 3)).copy(),
    )


@pytest.fixture(scope="module")
def world() -> object:
    return load_scene(plate_scene())


def fly(
    world: object,
    settings: Config,
    motion: Motion | None = None,
    mounting: SensorMounting = NOMINAL,
    duration_s: float = 0.5,
) -> list[StripChunk]:
    motion = straight_motion() if motion is None else motion
    strip = Strip(
        sortie=1,
        number=2,
        heading_deg=0.0,
        height_m=HEIGHT_M,
        start_s=START_S,
        end_s=START_S + duration_s,
        exposure_s=(),
    )
    return list(simulate_strip(world, settings, strip, motion, motion, mounting, NOMINAL, SiteFrame(settings.site)))


def only(chunks: list[StripChunk]) -> tuple[Returns, np.ndarray, TrueReturns]:
    assert len(chunks) == 1
    return chunks[0].returns, chunks[0].packets, chunks[0].truth


def scanner_on_map(settings: Config, motion: Motion, gps_time_s: np.ndarray) -> np.ndarray:
    """True origin of the beams, by the frames' own matrices."""
    arm = np.einsum("nij,j->ni", motion.world_from_body(gps_time_s), NOMINAL.lever_arm_m)
    return SiteFrame(settings.site).map_from_world(motion.position(gps_time_s) + arm)


def measured_range(settings: Config, motion: Motion, returns: Returns) -> np.ndarray:
    """From XYZ and the true motion; the map's scale (1.6e-4 here) is taken out by mapping the true ray's end beside it."""
    site = settings.site
    here = scanner_on_map(settings, motion, returns.gps_time_s)
    vector = returns.xyz_m - here
    frame = SiteFrame(site)
    axes = frame.map_from_world(np.concatenate([np.zeros((1, 3)), np.eye(3)])) - frame.map_from_world(np.zeros((1, 3)))
    return np.asarray(np.linalg.norm(vector @ np.linalg.inv(axes[1:]), axis=1))


def test_range_is_unbiased_on_flat_ground(world: object) -> None:
    """Rationale: taking the nearest sub-ray biases slopes by +12.5 mm at 20-30 degrees. Expected: measured minus true range
    has no mean at any incidence up to 30 degrees. Tolerance: 0.5 mm, the issue's; every single return stays within it too.
    """
    settings, motion = config(), straight_motion()
    returns, _, truth = only(fly(world, settings, motion))
    error = measured_range(settings, motion, returns) - truth.range_m
    ground = (truth.target < 0) & (returns.number_of_returns == 1)
    for low in range(0, 30, 5):
        angle = np.abs(returns.encoder_angle_deg)
        rows = ground & (angle >= low) & (angle < low + 5)
        assert rows.sum() > 300
        assert abs(error[rows].mean()) < 2e-4
        assert np.abs(error[rows]).max() < 5e-4


def test_map_coordinates_are_those_of_the_ground(world: object) -> None:
    """Rationale: ENU is not the grid; only the exact projection will do. Expected: every ground return lies on the plane
    z = 0 of the world when its true foot is mapped through pyproj. Tolerance: 0.6 mm, the range's own error."""
    settings, motion = config(), straight_motion((2.0, -3.0, 20.0))
    returns, _, truth = only(fly(world, settings, motion))
    angle = np.radians(returns.encoder_angle_deg.astype(float))
    beam = np.stack([np.zeros_like(angle), np.sin(angle), np.cos(angle)], axis=-1)
    world_from_body = motion.world_from_body(returns.gps_time_s)
    direction = np.einsum("nij,nj->ni", world_from_body, beam)
    origin = motion.position(returns.gps_time_s) + world_from_body @ NOMINAL.lever_arm_m
    ground = (truth.target < 0) & (returns.number_of_returns == 1)
    foot = origin - origin[:, 2:] / direction[:, 2:] * direction
    expected = SiteFrame(settings.site).map_from_world(foot)
    # the encoder angle is stored in single precision: 2e-6 degrees, 2 µm
    assert np.abs((returns.xyz_m - expected)[ground]).max() < 6e-4


def test_packet_peak_is_where_the_record_says(world: object) -> None:
    """Rationale: L is the echo's time in its packet. Expected: the maximum of the packet, refined by a parabola through three
    samples' logarithms, lies at L. Tolerance: 0.1 sample."""
    settings = config()
    returns, packets, _ = only(fly(world, settings))
    alone = np.flatnonzero((returns.number_of_returns == 1) & (returns.packet >= 0))
    wave = packets[returns.packet[alone]] - settings.lidar.baseline_dn
    top = wave.argmax(axis=1)
    rows = np.arange(len(top))
    a, b, c = (np.log(wave[rows, top + k]) for k in (-1, 0, 1))
    peak = top + 0.5 * (a - c) / (a - 2 * b + c)
    assert np.abs(peak - returns.return_location_ps[alone] / 1000.0).max() < 0.1


@pytest.mark.parametrize("faults", [{}, {"range_offset_m": 0.05, "lidar_clock_s": 0.002}])
def test_anchors_of_one_pulse_agree_and_d_points_at_the_scanner(world: object, faults: dict) -> None:
    """Rationale: sample k lies at P + L d - k dt d. Expected: both returns of a pulse give one anchor; d has the length of
    half the speed of light and points at the scanner. Tolerance: 2 mm (map scale 1.6e-4 over 3 m: 0.5 mm); 0.01 degrees.
    """
    settings, motion = config({"divergence_rad": 0.004, "subrays": 37}, faults), straight_motion((1.0, 2.0, 30.0))
    returns, _, _ = only(fly(world, settings, motion))
    first = np.flatnonzero((returns.number_of_returns == 2) & (returns.return_number == 1))
    assert len(first) > 20
    assert np.array_equal(returns.packet[first], returns.packet[first + 1])
    anchor = returns.xyz_m + returns.return_location_ps[:, None].astype(float) * returns.wave_direction_m_ps
    assert np.linalg.norm(anchor[first] - anchor[first + 1], axis=1).max() < 2e-3
    towards = scanner_on_map(settings, motion, returns.gps_time_s) - returns.xyz_m
    d = returns.wave_direction_m_ps.astype(float)
    length = np.linalg.norm(d, axis=1)
    assert np.abs(length / HALF_C_M_PS - 1.0).max() < 1e-6
    assert abs(HALF_C_M_PS / 1.499e-4 - 1.0) < 1e-4
    cosine = (d * towards).sum(axis=1) / length / np.linalg.norm(towards, axis=1)
    sine = np.linalg.norm(np.cross(d, towards), axis=1) / length / np.linalg.norm(towards, axis=1)
    assert cosine.min() > 0.0
    assert np.degrees(sine.max()) < 0.01


def test_second_returns_are_not_on_whole_bins(world: object) -> None:
    """Rationale: a defect seen elsewhere. Expected: second returns of mixed footprints (ground) are as exact as first ones.
    Tolerance: 5 mm: the residual of the other echo's skirt 20 samples away is nil, the footprint's part on the ground has
    another centre than the beam (2 mrad at 35 degrees: 50 m tan(10 deg) 0.5 mrad = 5 mm)."""
    settings, motion = config({"divergence_rad": 0.001}), straight_motion()
    returns, _, truth = only(fly(world, settings, motion))
    second = returns.return_number == 2
    assert second.sum() > 20
    error = measured_range(settings, motion, returns)[second] - truth.range_m[second]
    assert np.abs(error).max() < 5e-3
    assert np.all(truth.target[second] == -1)
    assert np.all(truth.target[np.flatnonzero(second) - 1] == 0)


def test_scan_angle_counts_from_the_vertical_roll_included(world: object) -> None:
    """Rationale: LAS 1.4 R15: from the data's vertical, positive to the right, roll included; 0 everywhere is a defect seen
    elsewhere. Expected: encoder angle minus roll (a right roll turns a nadir beam to the left). Tolerance: 0.006 degrees, the
    field's step (no pitch here)."""
    roll = 4.0
    returns, _, _ = only(fly(world, config(), straight_motion((roll, 0.0, 50.0))))
    assert np.abs(returns.scan_angle_deg - (returns.encoder_angle_deg - roll)).max() < 0.006
    assert returns.scan_angle_deg.max() - returns.scan_angle_deg.min() > 60.0


def test_points_to_the_right_have_positive_angles(world: object) -> None:
    """Rationale: the sign. Expected: flying north, returns with positive scan angles lie east of those with negative ones."""
    returns, _, _ = only(fly(world, config()))
    east = returns.xyz_m[:, 0]
    assert east[returns.scan_angle_deg > 5.0].min() > east[returns.scan_angle_deg < -5.0].max()


def test_amplitude_and_intensity_follow_the_radar_equation(world: object) -> None:
    """Rationale: 16-bit intensities of 0 and 1 are a defect seen elsewhere. Expected: amplitude of ground and panel returns =
    rho cos(alpha) / R^2 times one constant, intensity = 16 times amplitude, reflectance in dB = 10 log10(rho cos alpha).
    Tolerance: 0.1 % (log fit on whole steps of about 1/3000)."""
    settings = config()
    returns, _, truth = only(fly(world, settings))
    alone = returns.number_of_returns == 1
    rho = np.where(truth.target == 0, 0.6, 0.3)
    cosine = np.abs(np.cos(np.radians(returns.encoder_angle_deg)))
    expected = received_power_w(1.0, truth.range_m, rho, cosine, 1.0, 1.0, 1.0)
    ratio = (returns.amplitude / expected)[alone]
    assert ratio.std() / ratio.mean() < 1e-3
    assert np.abs(returns.intensity[alone] / 16.0 - np.minimum(returns.amplitude[alone], 4095.94)).max() <= 1 / 16
    db = 10.0 * np.log10(rho * cosine)
    assert np.abs(returns.reflectance_db - db)[alone].max() < 0.01


def test_faults_move_the_returns_as_stated(world: object) -> None:
    """Rationale: measured = true + offset + scale * true; stamped = true time + clock; gain multiplies power.
    Expected: exactly that, and nothing else changes. Tolerance: 1e-9 s, 0.05 mm, 0.1 %."""
    clean, motion = config(), straight_motion()
    plain, _, truth = only(fly(world, clean, motion))
    faulty = config(faults={"range_offset_m": 0.04, "range_scale": 3e-4, "lidar_gain": 0.8})
    moved, _, _ = only(fly(world, faulty, motion))
    longer = measured_range(faulty, motion, moved) - measured_range(clean, motion, plain)
    alone = plain.number_of_returns == 1
    assert np.abs(longer - 0.04 - 3e-4 * truth.range_m)[alone].max() < 5e-5
    assert np.median(moved.amplitude / plain.amplitude) == pytest.approx(0.8, rel=1e-3)
    late, _, _ = only(fly(world, config(faults={"lidar_clock_s": 0.01}), motion))
    assert np.abs(late.gps_time_s - plain.gps_time_s - 0.01).max() < 1e-7
    shift = late.xyz_m - plain.xyz_m  # 5 m/s north, grid convergence turns 0.05 m by 0.6 degrees
    assert np.abs(np.linalg.norm(shift, axis=1) - 0.05).max() < 1e-4
    assert shift[:, 1].min() > 0.049


def test_boresight_fault_turns_the_true_beam_only(world: object) -> None:
    """Rationale: post-processing knows the nominal mounting. Expected: with a roll error of +0.3 degrees the true beam looks
    further left than the record says: the range at encoder angle t is h / cos(t - 0.3 deg). Tolerance: 0.3 mm."""
    error = np.radians(0.3)
    turned = SensorMounting(rotation=rotation_from_rpy(error, 0.0, 0.0), lever_arm_m=NOMINAL.lever_arm_m)
    _, _, truth = only(chunks := fly(world, config(), mounting=turned))
    angle = np.radians(chunks[0].returns.encoder_angle_deg.astype(float))
    height = HEIGHT_M - NOMINAL.lever_arm_m[2]
    ground = truth.target < 0
    assert np.abs(truth.range_m - height / np.cos(angle - error))[ground].max() < 3e-4


def test_only_target_packets_are_kept_on_request(world: object) -> None:
    """Rationale: packets are most of a campaign's bytes. Expected: "targets" keeps rows and packets within size + margin of the
    target and a cell of 0.2 m more, and every row stays. Tolerance: that cell."""
    every, all_packets, _ = only(fly(world, config()))
    some, packets, _ = only(fly(world, config(waveforms="targets", target_margin_m=1.0)))
    assert np.array_equal(every.xyz_m, some.xyz_m)
    centre = SiteFrame(config().site).map_from_world(np.array([[4.0, 0.5, PLATE_M]]))[0]
    away = np.linalg.norm(every.xyz_m[:, :2] - centre[:2], axis=1)
    stored = some.packet >= 0
    pulse_mates = every.number_of_returns == 1
    assert np.all(stored[away < 2.999])
    assert not np.any(stored[(away > 3.25) & pulse_mates])
    assert np.array_equal(packets[some.packet[stored]], all_packets[every.packet[stored]])
    assert np.all(some.return_location_ps[~stored] == 0.0)
    assert len(packets) == len(np.unique(some.packet[stored]))


def test_ambiguous_ranges_are_refused(world: object) -> None:
    """Rationale: c / (2 PRR) at 3.2 MHz is 46.8 m. Expected: ConfigError that names setting and limit."""
    with pytest.raises(ConfigError, match=r"lidar\.prr_hz.*46\.8"):
        fly(world, config({"prr_hz": 3.2e6}), duration_s=0.01)


def test_short_ranges_are_dropped(world: object) -> None:
    """Rationale: an instrument is blind close by. Expected: with min_range 48 m the plate (47 m) vanishes and the ground
    stays."""
    _, _, truth = only(fly(world, config({"min_range_m": 48.0})))
    assert truth.range_m.min() > 47.9
    assert not np.any(truth.target == 0)


def test_motion_must_cover_the_strip(world: object) -> None:
    """Rationale: extrapolated poses are silent nonsense. Expected: ConfigError naming the strip."""
    with pytest.raises(ConfigError, match="sortie 1 strip 2"):
        fly(world, config(), duration_s=100.0)


def test_same_bytes_for_threads_and_chunks(world: object) -> None:
    """Rationale: results that change with the thread count are a defect seen elsewhere. Expected: identical bytes of rows,
    packets and truth for 1 and 2 threads and chunks of 65 536 and 131 072 pulses. Tolerance: none."""
    noisy = {name: Lidar.model_fields[name].default for name in QUIET} | {
        "prr_hz": 250_000.0,
        "full_scale_power_nw": 3e4,
    }

    def digest(threads: int, pulses: int) -> list[bytes]:
        start(threads)
        chunks = fly(world, config(noisy, pulses_per_chunk=pulses), duration_s=3.0)
        rows = [b"".join(np.ascontiguousarray(getattr(c.returns, f)).tobytes() for c in chunks) for f in fields]
        known = [b"".join(np.ascontiguousarray(getattr(c.truth, f)).tobytes() for c in chunks) for f in truths]
        return [*rows, *known, b"".join(c.packets.tobytes() for c in chunks)]

    fields = [f for f in Returns.__dataclass_fields__ if f != "packet"]
    truths = list(TrueReturns.__dataclass_fields__)
    try:
        reference = digest(2, 65536)
        assert len(reference[0]) > 130_000 * 24
        assert digest(1, 65536) == reference
        assert digest(2, 131072) == reference
    finally:
        start()
