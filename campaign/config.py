"""Models of a campaign configuration. Units stand in the names; unknown keys are refused with the nearest known one.

A configuration is one TOML file. `[camera]`, `[lidar]`, `[platform]` and `[site]` may name a ready-made device with
`use = "name"` (configs/sensors, configs/platforms, configs/sites); keys beside `use` override that file's.
Reading, merging and the errors live in `campaign.load`; no default here depends on another value.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Vector3 = tuple[float, float, float]
Part = Literal["camera", "lidar", "bench", "ranging"]
PARTS: tuple[Part, ...] = ("camera", "lidar", "bench", "ranging")


class Model(BaseModel):
    """Frozen; a key that is not a field is an error; NaN and infinity are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class CampaignInfo(Model):
    """Who, where, when."""

    id: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    title: str = "Multi-sensor consistency test"
    start_time: str = Field(
        "2026-06-12T10:30:00+08:00", description="ISO 8601 with UTC offset; first strip begins here"
    )
    operator: str = ""
    purpose: str = ""
    parts: Annotated[tuple[Part, ...], Field(min_length=1, max_length=4)] = Field(
        PARTS, description="what is simulated: the flight of camera and lidar, the indoor benches, the ranging line"
    )


class Site(Model):
    """The range: its origin (world frame ENU), map projection, terrain."""

    name: str = "Range"
    latitude_deg: Annotated[float, Field(ge=-85.0, le=85.0)] = 31.283
    longitude_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 121.213
    ellipsoid_height_m: Annotated[float, Field(ge=-500.0, le=9000.0)] = 18.0
    height_anomaly_m: Annotated[float, Field(ge=-120.0, le=120.0)] = Field(
        11.2, description="ellipsoidal minus normal (1985) height"
    )
    projection_epsg: int = Field(4549, description="CGCS2000 3-degree Gauss-Krueger zone: 4513-4533 or 4534-4554")
    height_epsg: int = Field(5737, description="1985 national height datum")
    slope_deg: Annotated[float, Field(ge=0.0, lt=45.0)] = 1.0
    slope_azimuth_deg: float = Field(135.0, description="direction in which the ground falls, clockwise from north")
    relief_m: Annotated[float, Field(ge=0.0, le=5.0)] = Field(0.03, description="standard deviation of the undulation")
    extent_m: Annotated[float, Field(gt=20.0, le=2000.0)] = Field(240.0, description="edge of the square of terrain")
    ground_material: str = "dry_grass"
    texture_contrast: Fraction = Field(0.25, description="relative standard deviation of the ground's reflectance")
    texture_scale_m: Positive = Field(0.04, description="finest wavelength of the ground's texture")


class Environment(Model):
    """Air and wind, constant over a campaign."""

    visibility_km: Positive = 23.0
    temperature_c: Annotated[float, Field(ge=-60.0, le=60.0)] = 24.0
    pressure_hpa: Annotated[float, Field(ge=400.0, le=1100.0)] = 1010.0
    relative_humidity_percent: Annotated[float, Field(ge=0.0, le=100.0)] = 55.0
    wind_speed_m_s: NonNegative = 3.0
    wind_from_deg: float = Field(120.0, description="direction the wind blows from, clockwise from north")
    aerosol_optical_depth_500nm: NonNegative = 0.12
    precipitable_water_cm: NonNegative = 2.0
    ozone_atm_cm: NonNegative = 0.3
    satellites: Annotated[int, Field(ge=0, le=80)] = 22
    obstacle_angle_deg: Annotated[float, Field(ge=0.0, le=90.0)] = 8.0


class Panels(Model):
    """Reflectance panels (6.2.2 a-b, 8.1.2 a)."""

    size_m: Positive = 1.2
    nominal_reflectance_percent: tuple[float, ...] = (5.0, 20.0, 40.0, 60.0, 100.0)
    count_of_each: Annotated[int, Field(ge=1, le=50)] = 4
    material: Literal["barium_sulfate", "ptfe", "water_based_paint"] = "ptfe"
    thickness_m: Positive = 0.02
    stand_height_m: NonNegative = 0.15
    spectrum_std: NonNegative = Field(0.01, description="relative spread of the level from panel to panel")


class Frustums(Model):
    """Geometric targets (6.2.2 c-g, figure 2). Legs are b/2 and faces stand at 54.74 degrees by the standard's angles."""

    count: Annotated[int, Field(ge=0, le=400)] = 24
    style: Literal["inverted", "upright"] = "inverted"
    long_edge_m: Positive = Field(0.8, description="b, the edge of the large rim")
    thickness_m: NonNegative = Field(0.0015, description="sheet metal")
    mark_radius_m: Positive = 0.16
    stand_heights_m: tuple[NonNegative, ...] = (0.15, 0.6, 1.1)
    material: Literal["barium_sulfate", "ptfe", "water_based_paint"] = "barium_sulfate"


class Boards(Model):
    """2x2 boards: four squares, black and white by turns, flat on low stands. They determine the camera's mounting alone."""

    count: Annotated[int, Field(ge=0, le=100)] = 0
    size_m: Positive = Field(1.0, description="edge of the whole board")
    thickness_m: Positive = 0.02
    stand_height_m: NonNegative = 0.1


class Survey(Model):
    """Standard deviations of the control survey, one axis each."""

    horizontal_std_m: NonNegative = 0.003
    height_std_m: NonNegative = 0.004
    spectrometer_std: NonNegative = Field(0.003, description="relative, of each panel's measured spectrum")


class Targets(Model):
    panels: Panels = Panels()
    frustums: Frustums = Frustums()
    boards: Boards = Boards()
    survey: Survey = Survey()
    layout_margin: Annotated[float, Field(ge=0.0, lt=0.5)] = Field(
        0.10, description="part of the common field kept free at its border"
    )


class Band(Model):
    """One colour channel: a Gaussian response."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    centre_nm: Annotated[float, Field(ge=400.0, le=1000.0)]
    fwhm_nm: Annotated[float, Field(ge=1.0, le=600.0)]


class Lens(Model):
    """Brown-Conrady: radial k1 k2 k3, tangential p1 p2, on normalised image coordinates (OpenCV's order of p1, p2)."""

    fx_px: Positive
    fy_px: Positive
    cx_px: Positive = Field(description="from the image's top left corner: the first pixel's centre is at 0.5")
    cy_px: Positive
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


class Camera(Model):
    """A frame camera: geometry, radiometry (EMVA 1288), and what its maker states."""

    use: str | None = None
    name: str = "camera"
    manufacturer: str = ""
    width_px: Annotated[int, Field(ge=64, le=20000)]
    height_px: Annotated[int, Field(ge=64, le=20000)]
    pixel_size_um: Positive
    nominal_focal_length_mm: Positive
    f_number: Positive = 5.6
    focus_distance_m: Annotated[float, Field(gt=0.0, le=1e6)] = Field(
        50.0, description="setting of the lens in flight; `lens` holds there, from the entrance pupil"
    )
    lens: Lens = Field(description="the true interior orientation; the certificate is a draw around it")
    calibration_std: tuple[float, ...] = Field(
        (0.15, 0.15, 0.15, 0.15, 4e-5, 1.5e-4, 2e-4, 6e-6, 6e-6),
        min_length=9,
        max_length=9,
        description="standard deviations of the certificate: fx fy cx cy k1 k2 k3 p1 p2",
    )
    bands: Annotated[tuple[Band, ...], Field(min_length=1, max_length=3)]
    bit_depth: Annotated[int, Field(ge=8, le=16)] = 14
    black_level_dn: NonNegative = 256.0
    full_well_e: Positive = 50000.0
    read_noise_e: NonNegative = 3.0
    dark_current_e_s: NonNegative = 1.0
    quantum_efficiency: Fraction = 0.5
    prnu: NonNegative = Field(0.004, description="relative pixel to pixel gain spread (flat-fielded residual)")
    dsnu_e: NonNegative = 1.0
    vignetting: Fraction = Field(
        0.0, description="residual relative fall-off at the corner after the maker's correction"
    )
    psf_sigma_px: NonNegative = Field(0.45, description="optics and pixel diffusion, before the pixel's own box")
    exposure_time_s: Positive = 1.0 / 2000.0
    shutter: Literal["global", "rolling"] = "global"
    readout_time_s: NonNegative = Field(0.0, description="first to last row, rolling shutter only")
    exposure_target: Fraction = Field(
        0.80,
        description="part of full scale that a level 100 % reflector shall reach; sets the gain at the first strip",
    )


class Scanner(Model):
    """How the beam moves. `line`: one beam turned by a mirror about the flight axis; `channels`: a spinning fan."""

    type: Literal["line", "channels"] = "line"
    scan_rate_hz: Positive = Field(100.0, description="lines (turns) a second")
    sector_deg: tuple[float, float] = Field((-45.0, 45.0), description="encoder angles kept, 0 = nadir, positive right")
    channel_elevations_deg: tuple[float, ...] = Field((), description="`channels` only: tilt of each beam, along track")
    turn_share: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        1.0, description="share of one turn of the beam per scan line (1: 360 degrees)"
    )


class Lidar(Model):
    """A waveform LiDAR: geometry, radiometry, digitiser, and its own echo detector."""

    use: str | None = None
    name: str = "lidar"
    manufacturer: str = ""
    wavelength_nm: Annotated[float, Field(ge=400.0, le=1700.0)] = 1550.0
    prr_hz: Positive = 300_000.0
    scanner: Scanner = Scanner()
    divergence_rad: Positive = Field(0.0005, description="full angle at 1/e^2 of the peak irradiance")
    subrays: Annotated[int, Field(ge=1, le=1024)] = Field(
        256,
        description="rays that resolve a footprint on edges, rims and leaves; one surface or crease has a closed form",
    )
    pulse_energy_uj: Positive = 0.5
    pulse_fwhm_ns: Positive = 4.0
    aperture_diameter_m: Positive = 0.05
    system_efficiency: Fraction = 0.6
    receiver_fwhm_ns: NonNegative = Field(1.5, description="impulse response of detector and amplifier")
    sampling_ns: Positive = 1.0
    samples: Annotated[int, Field(ge=16, le=1024)] = 64
    bit_depth: Annotated[int, Field(ge=8, le=16)] = 12
    full_scale_power_nw: Positive = Field(46000.0, description="optical power at the digitiser's last step")
    baseline_dn: NonNegative = 60.0
    noise_dn: NonNegative = Field(2.0, description="standard deviation of detector and amplifier noise")
    shot_noise_dn: NonNegative = Field(0.25, description="added variance is this squared times the signal in DN")
    solar_background_dn: NonNegative = 1.0
    gain_jitter: NonNegative = Field(0.01, description="relative pulse energy spread")
    range_noise_m: NonNegative = Field(0.003, description="timing jitter of a pulse, as range")
    threshold_sigma: Positive = 6.0
    max_returns: Annotated[int, Field(ge=1, le=15)] = 5
    min_range_m: NonNegative = 3.0
    stated_precision_m: Positive = 0.005
    stated_accuracy_m: Positive = 0.010
    encoder_std_deg: NonNegative = 0.001
    response_constant_std: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        0.03, description="relative; of the response constant that the laboratory states in sensors/lidar.json"
    )


class Mounting(Model):
    """Nominal mounting of one sensor: what the maker's drawing says."""

    lever_arm_m: Vector3 = Field(
        (0.0, 0.0, 0.0), description="sensor's origin in the body frame, x forward y right z down"
    )
    boresight_deg: Vector3 = Field((0.0, 0.0, 0.0), description="roll pitch yaw of the nominal mounting")


class Platform(Model):
    """The aircraft and the nominal mounting of its sensors."""

    use: str | None = None
    name: str = "multirotor"
    kind: Literal["multirotor", "fixed_wing"] = "multirotor"
    max_acceleration_m_s2: Positive = 2.5
    roll_std_deg: NonNegative = 0.6
    pitch_std_deg: NonNegative = 0.6
    heading_std_deg: NonNegative = 0.4
    attitude_period_s: Positive = 3.0
    track_std_m: NonNegative = Field(0.10, description="how well the autopilot holds the line, one axis")
    pitch_per_speed_deg_s_m: float = Field(-0.3, description="nose-down pitch per m/s of air speed")
    camera: Mounting = Mounting(lever_arm_m=(0.10, 0.03, 0.08))
    lidar: Mounting = Mounting(lever_arm_m=(-0.05, -0.02, 0.12))
    mounting_boresight_std_deg: Positive = Field(1.0, description="how far the true mounting may be off, prior")
    mounting_lever_arm_std_m: Positive = Field(0.10, description="the same for the lever arm")
    mounting_clock_std_s: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        0.0, description="prior of each sensor's clock against navigation; 0: synchronised, not estimated"
    )


class Flight(Model):
    """Strips: every height is one sortie, every heading one strip (or `strips_per_heading`) through the range's centre."""

    heights_m: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=12)] = (45.0, 65.0)
    headings_deg: Annotated[tuple[float, ...], Field(min_length=1, max_length=24)] = (0.0, 180.0, 90.0, 270.0)
    strips_per_heading: Annotated[int, Field(ge=1, le=50)] = 1
    side_overlap: Annotated[float, Field(ge=0.0, lt=0.95)] = 0.7
    speed_m_s: Annotated[float, Field(gt=0.0, le=60.0)] = 5.0
    speeds_m_s: (
        Annotated[tuple[Annotated[float, Field(gt=0.0, le=60.0)], ...], Field(min_length=1, max_length=12)] | None
    ) = Field(
        None, description="one for each of heights_m, in the place of speed_m_s; two speeds tell clocks from lever arms"
    )
    images_per_strip: Annotated[int, Field(ge=1, le=500)] = 2
    image_spacing_m: Positive = Field(6.0, description="between exposures, symmetric about the strip's middle")
    run_in_m: NonNegative = Field(4.0, description="LiDAR on, before and after the range, on each strip")
    gsd_m: Positive | None = Field(None, description="when given, (1) must agree with heights_m within 5 %")


class Navigation(Model):
    """Errors of the post-processed trajectory: first-order Gauss-Markov processes."""

    grade: Literal["apx15", "apx20", "apogee", "perfect", "custom"] = "apogee"
    position_std_m: Vector3 | None = Field(None, description="north east down; only with grade = custom")
    attitude_std_deg: Vector3 | None = Field(None, description="roll pitch heading; only with grade = custom")
    position_correlation_s: Positive = 60.0
    attitude_correlation_s: Positive = 120.0
    rate_hz: Annotated[float, Field(ge=20.0, le=1000.0)] = 200.0
    clock_std_s: NonNegative = 0.0


class Faults(Model):
    """What is wrong with the integration, on purpose. Kept under truth/. Added to the nominal mounting."""

    camera_boresight_deg: Vector3 = (0.0, 0.0, 0.0)
    lidar_boresight_deg: Vector3 = (0.0, 0.0, 0.0)
    camera_lever_arm_m: Vector3 = (0.0, 0.0, 0.0)
    lidar_lever_arm_m: Vector3 = (0.0, 0.0, 0.0)
    camera_clock_s: float = Field(0.0, description="stamped minus true time")
    lidar_clock_s: float = 0.0
    range_offset_m: float = Field(0.0, description="measured = true + offset + scale * true")
    range_scale: float = 0.0
    principal_distance_px: float = Field(
        0.0, description="added to fx and fy of the true lens; the certificate ignores it"
    )
    principal_point_px: tuple[float, float] = Field((0.0, 0.0), description="the same for cx, cy")
    k1: float = Field(0.0, description="the same for k1")
    survey_target: str | None = Field(
        None, description="id of a target whose surveyed place is wrong by survey_error_m"
    )
    survey_error_m: Vector3 = Field((0.0, 0.0, 0.0), description="east north up, added to the surveyed place")
    swapped_targets: tuple[str, str] | None = Field(
        None, description="ids of two targets whose surveyed places are exchanged"
    )
    lidar_gain: Positive = Field(1.0, description="factor on the received power")
    camera_gain: Positive = 1.0
    panel_laser_gain: tuple[tuple[str, Annotated[float, Field(ge=-1.0, le=1.0)]], ...] = Field(
        (),
        description="panel id, and by how much its reflectance at the laser's line rose since the spectrometer read it",
    )
    range_table: tuple[tuple[NonNegative, float], ...] = Field(
        (),
        description="range and error in metres, linear between its rows and constant beyond; added to what is measured",
    )
    image_ripple_px: Annotated[float, Field(ge=0.0, le=20.0)] = Field(
        0.0, description="amplitude of heat shimmer: a wavy displacement of each image, which no lens model holds"
    )
    image_ripple_period_px: Annotated[float, Field(ge=40.0)] = 180.0
    stability_gains: tuple[Positive, ...] = Field(
        (), description="the camera's relative response, image by image of bench/sphere_stability; absent: constant"
    )
    repeatability_gains: tuple[Positive, ...] = Field((), description="the same for bench/sphere_repeatability")


class Render(Model):
    """Samples. Powers of two."""

    samples: Literal[1, 2, 4, 8, 16, 32, 64, 128] = 4
    target_samples: Literal[1, 2, 4, 8, 16, 32, 64, 128, 256, 512] = 32
    bounces: Annotated[int, Field(ge=0, le=8)] = 1
    cache: Annotated[str, Field(min_length=1, pattern=r"^[^\x00]+$")] | None = Field(
        None, description="folder that keeps rendered radiance between runs"
    )
    cache_limit_gb: Positive = Field(50.0, description="of that folder; what was not used for the longest time goes")


class LidarRecording(Model):
    """What of the LiDAR is stored."""

    waveforms: Literal["all", "targets"] = "all"
    target_margin_m: NonNegative = 1.5
    pulses_per_chunk: Literal[65536, 131072, 262144] = 65536


class Room(Model):
    """Air and records of the indoor benches (6.3)."""

    temperature_c: Annotated[float, Field(ge=-20.0, le=60.0)] = 20.0
    relative_humidity_percent: Annotated[float, Field(ge=0.0, le=100.0)] = 60.0
    pressure_hpa: Annotated[float, Field(ge=400.0, le=1100.0)] = 1010.0
    dust_free: bool = True
    single_light_source: bool = True


class Sphere(Model):
    """Integrating sphere (8.2.2): geometry, its stabilised lamp, and how the camera in front of its port behaves."""

    diameter_m: Positive = 0.8
    port_diameter_m: Positive = 0.2
    wall_reflectance: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.97
    lamp_diameter_m: Positive = Field(0.04, description="a round, flat, Lambertian lamp in the sphere's wall")
    lamp_temperature_k: Annotated[float, Field(ge=1500.0, le=7000.0)] = 2856.0
    lamp_power_w: Positive = Field(60.0, description="radiated over all wavelengths, after warm-up")
    baffle: bool = True
    warm_up_share: Fraction = Field(0.04, description="what the lamp lacks at switch-on, relative")
    warm_up_time_s: Positive = Field(240.0, description="time constant of the warm-up")
    drift_percent_per_h: float = Field(0.1, description="linear change of the lamp's output, from switch-on")
    noise_percent: NonNegative = Field(0.02, description="random, from image to image")
    wait_s: NonNegative = Field(1500.0, description="from switch-on to the first image; 8.2.2 asks for 20 min")
    images: Annotated[int, Field(ge=2, le=200)] = 21
    stability_interval_s: Positive = 180.0
    repeatability_interval_s: Positive = 15.0
    exposure_share: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        0.65, description="of full scale, in the brightest band"
    )
    window_px: tuple[int, int] | None = Field(
        None, description="width and height of the part read out about the image's middle; absent: the whole image"
    )
    camera_warm_up_k: NonNegative = Field(6.0, description="how far the sensor warms up, from switch-on")
    camera_warm_up_time_s: Positive = 900.0
    dark_current_doubling_k: Positive = 6.5
    traceability: str = "second class standard, certificate of the range's own lamp"


class Chessboard(Model):
    """Geometric bench (9.2.2): one plane board, four or more distances, tilts; the field is covered at each distance."""

    squares: tuple[Annotated[int, Field(ge=4, le=60)], Annotated[int, Field(ge=4, le=60)]] = Field(
        (18, 13), description="across and down; one even and one odd number leave no 180 degree ambiguity"
    )
    square_m: Positive = 0.06
    margin_m: Positive = Field(0.06, description="white border round the squares")
    distances_m: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=12)] = (1.6, 2.0, 2.5, 3.0)
    tilt_deg: Annotated[float, Field(ge=0.0, le=60.0)] = Field(22.0, description="greatest turn about the board's axes")
    focus_distance_m: Positive | None = Field(None, description="setting of the lens; absent: as in flight, locked")
    f_number: Positive | None = Field(None, description="absent: as in flight")
    white_reflectance: Fraction = 0.85
    black_reflectance: Fraction = 0.04
    wall_reflectance: Fraction = 0.15
    exposure_share: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(0.7, description="of full scale, white squares")
    samples: Literal[16, 32, 64, 128, 256, 512] = Field(64, description="of a pixel at an edge of the pattern")


class Bench(Model):
    """The indoor benches (6.3, 8.2, 9.2)."""

    room: Room = Room()
    sphere: Sphere = Sphere()
    chessboard: Chessboard = Chessboard()


class TotalStationModel(Model):
    """A total station: what its certificate states and how far it errs (one standard deviation, mm + ppm)."""

    name: str = Field("station", pattern=r"^[A-Za-z0-9_-]{1,64}$")
    class_mm: Positive = Field(description="accuracy class of its distances")
    std_mm: NonNegative
    std_ppm: NonNegative = 1.0
    angle_std_deg: NonNegative = 0.0006
    additive_constant_mm: float = Field(0.0, description="K1 of its certificate: added to what it reads")
    scale_ppm: float = Field(0.0, description="R1 of its certificate: times what it reads, added")
    additive_constant_std_mm: NonNegative = Field(0.2, description="how far K1 may be off; the certificate states it")
    scale_std_ppm: NonNegative = Field(0.5, description="the same for R1")
    wavelength_um: Annotated[float, Field(ge=0.3, le=2.0)] = 0.658
    reference_index: Annotated[float, Field(ge=1.0, le=1.001)] = Field(1.000286338, description="n0 of its design")


class Ranging(Model):
    """The ranging line (9.1.2): panels over the LiDAR's range, two total stations (step c and step k), repeated scans."""

    distances_m: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=40)] = (
        15.0,
        60.0,
        105.0,
        150.0,
        195.0,
        240.0,
    )
    panel_size_m: Positive = 1.2
    panel_reflectance_percent: Annotated[float, Field(gt=0.0, le=100.0)] = 60.0
    scans: Annotated[int, Field(ge=1, le=50)] = 5
    scan_rate_hz: Positive = Field(30.0, description="scan lines a second on the turntable; they run up and down")
    turn_rate_deg_s: Positive = Field(1.2, description="of the turntable, which carries the lines along the panels")
    tilt_deg: Annotated[float, Field(ge=0.0, le=30.0)] = Field(
        2.0, description="how far the instrument's axes lean, at most; their direction is drawn"
    )
    observations: Annotated[int, Field(ge=1, le=50)] = Field(5, description="of each panel by each total station")
    eccentricity_m: Vector3 = Field((0.35, -0.22, 0.10), description="LiDAR's centre minus station, east north up")
    eccentricity_std_m: NonNegative = 0.0005
    temperature_c: Annotated[float, Field(ge=-40.0, le=60.0)] = 27.0
    pressure_hpa: Annotated[float, Field(ge=500.0, le=1100.0)] = 1008.0
    relative_humidity_percent: Annotated[float, Field(ge=0.0, le=100.0)] = 65.0
    correction_station: TotalStationModel = TotalStationModel(
        name="station_A", class_mm=10.0, std_mm=2.0, std_ppm=2.0, additive_constant_mm=-1.4, scale_ppm=3.0
    )
    reference_station: TotalStationModel = TotalStationModel(
        name="station_B", class_mm=5.0, std_mm=1.0, std_ppm=1.5, additive_constant_mm=0.6, scale_ppm=-1.0
    )


class Config(Model):
    """One campaign."""

    schema_version: Literal[1] = 1
    campaign: CampaignInfo
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    scene_seed: Annotated[int, Field(ge=0, lt=2**63)] | None = Field(
        None,
        description="of scene, flight and render samples; `seed` when absent. Set it to redraw nothing but noise, "
        "navigation errors, survey and certificate with `seed`",
    )
    site: Site = Site()
    environment: Environment = Environment()
    targets: Targets = Targets()
    platform: Platform = Platform()
    camera: Camera
    lidar: Lidar = Lidar()
    flight: Flight = Flight()
    navigation: Navigation = Navigation()
    faults: Faults = Faults()
    render: Render = Render()
    recording: LidarRecording = LidarRecording()
    bench: Bench = Bench()
    ranging: Ranging = Ranging()


# Standard deviations of post-processed navigation: position north/east/down [m], attitude roll/pitch/heading [deg].
# Attitude: makers' data sheets (APX-15: 0.025/0.08; APX-20: 0.015/0.035; SBG Apogee: 0.005/0.01). Position: PPK, 1-2 cm.
NAVIGATION_GRADES: dict[str, tuple[Vector3, Vector3]] = {
    "apx15": ((0.02, 0.02, 0.03), (0.025, 0.025, 0.08)),
    "apx20": ((0.02, 0.02, 0.03), (0.015, 0.015, 0.035)),
    "apogee": ((0.01, 0.01, 0.015), (0.005, 0.005, 0.01)),
    "perfect": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
}
