"""The bench of 8.2.2: a lamp that warms up, drifts and flickers, the camera in front of the sphere's port, two series of images.

The sphere's light has one shape; it is rendered once and each exposure is that shape times the lamp's output at its time. The
lens is not focused on the wall, which is so smooth that this cannot be seen. Time counts from the lamp's switch-on, when the
camera is switched on too. The stability series comes first, and one of its intervals later, the lamp still on, repeatability.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from campaign.benches.bench import SphereExposure, write_sphere_log
from campaign.config import Camera, Config, Sphere
from campaign.errors import ConfigError
from campaign.flight import images
from campaign.folder import CampaignFolder
from campaign.progress import Report
from campaign.threads import one_blas_thread
from scenes.sphere import build_sphere, lamp_flux_per_nm
from simulator.camera import sensor
from simulator.camera.view import undistort
from simulator.journal import Journal
from simulator.kept import kept_array
from simulator.randomness import Stream, generator, scene_seed
from simulator.release import release
from simulator.render.sphere import radiance_per_watt, wall_points

STABILITY, REPEATABILITY = 0, 1  # keys of random streams
NODES = (17, 13)  # across and down, of the grid over the window on which the light is solved
MIN_WINDOW_PX = 3
MAX_SHARE = 0.98  # of full scale: no exposure is set higher, whatever the camera's gain fault
WRITERS = 2


@dataclass(frozen=True, kw_only=True)
class SphereLight:
    """Radiance of the wall in the window's pixels, for the warm lamp at its nominal output."""

    relative: np.ndarray  # (h, w) float32, its greatest value is 1
    band_radiance: np.ndarray  # (bands,) where `relative` is 1 [W m-2 sr-1 nm-1]


def lamp_output(sphere: Sphere, since_on_s: np.ndarray) -> np.ndarray:
    r"""Output of the lamp relative to its nominal power, without its random part.

    .. math:: 1 - w\,e^{-t / \tau} + d\,t

    Parameters
    ----------
    since_on_s : (n,) array_like
        Time since switch-on, t. [s]

    Returns
    -------
    (n,) ndarray
        With w the warm-up share, tau its time constant and d the linear drift; never below zero.
    """
    t = np.asarray(since_on_s, float)
    warm_up = sphere.warm_up_share * np.exp(-t / sphere.warm_up_time_s)
    return np.maximum(1 - warm_up + sphere.drift_percent_per_h / 100 / 3600 * t, 0)


def response(config: Config, key: int) -> np.ndarray:
    """The camera's relative response in each image of one series, (images,): ones without `faults`' gains.

    Raises
    ------
    ConfigError
        As many gains as images are needed.
    """
    name = "stability_gains" if key == STABILITY else "repeatability_gains"
    gains, count = getattr(config.faults, name), config.bench.sphere.images
    if gains and len(gains) != count:
        raise ConfigError(
            "one gain for each image", where=f"faults.{name}", got=len(gains), expected=f"{count} (bench.sphere.images)"
        )
    return np.array(gains) if gains else np.ones(count)


def drift_percent_per_h(since_on_s: np.ndarray, output: np.ndarray) -> float:
    """Slope of the straight line through the lamp's output by least squares, relative to its mean. [% per hour]"""
    t, output = np.asarray(since_on_s, float), np.asarray(output, float)
    centred = t - t.mean()
    mean = float(output.mean())
    return float(100 * 3600 * (centred @ output) / (centred @ centred) / mean) if mean > 0 else 0.0


def sensor_temperature_c(config: Config, since_on_s: float) -> float:
    """The camera's sensor, which warms up from the room's temperature. [degrees Celsius]"""
    sphere = config.bench.sphere
    risen = 1 - np.exp(-since_on_s / sphere.camera_warm_up_time_s)
    return float(config.bench.room.temperature_c + sphere.camera_warm_up_k * risen)


@one_blas_thread()
def sphere_light(config: Config, window: sensor.Window) -> SphereLight:
    """Render the sphere on a grid of the window and interpolate by cubic splines.

    Raises
    ------
    ConfigError
        The sphere cannot be built, the lens folds back, or its picture is not filled by the port.
    """
    camera, lens = config.camera, config.camera.lens
    scene = build_sphere(config.bench.sphere, camera)
    across, down = (min(n, size) for n, size in zip(NODES, (window.width_px, window.height_px), strict=True))
    # From the first to the last pixel's centre.
    u = window.column + 0.5 + np.linspace(0.0, window.width_px - 1.0, across)
    v = window.row + 0.5 + np.linspace(0.0, window.height_px - 1.0, down)
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    xy = undistort(lens, (uv - [lens.cx_px, lens.cy_px]) / [lens.fx_px, lens.fy_px])
    if not np.isfinite(xy).all():
        raise ConfigError("the lens model folds back inside the image", where="camera.lens", remedy="check k1 k2 k3")
    places = wall_points(scene, np.column_stack([xy, np.ones(len(xy))]))
    if np.isnan(places).any():
        raise ConfigError(
            "the sphere's port does not fill the picture",
            where="camera.lens",
            remedy="a lens with less distortion at the picture's corners, or bench.sphere.window_px",
        )
    seed = scene_seed(config)
    nodes = kept_array(
        config.render.cache,
        (release(), "sphere", scene, places, seed),
        lambda: radiance_per_watt(scene, places, seed),
        config.render.cache_limit_gb,
    ).reshape(down, across)
    columns = _spline_matrix(u, window.column + 0.5 + np.arange(window.width_px))
    rows = _spline_matrix(v, window.row + 0.5 + np.arange(window.height_px))
    greatest = float(nodes.max())
    relative = rows @ (nodes / greatest if greatest > 0 else nodes) @ columns.T
    flux = np.array([lamp_flux_per_nm(config.bench.sphere, band) for band in camera.bands])
    return SphereLight(relative=relative.astype(np.float32), band_radiance=greatest * flux)


def _spline_matrix(knots: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(len(at), len(knots)): values between knots, linear in the values at them."""
    degree = min(3, len(knots) - 1)
    return np.asarray(make_interp_spline(knots, np.eye(len(knots)), k=degree)(at))


def simulate_sphere(
    config: Config, place: CampaignFolder, start_gps_s: float, progress: Report, journal: Journal | None = None
) -> float:
    """Write bench/sphere_stability and bench/sphere_repeatability.

    Parameters
    ----------
    start_gps_s : float
        When the lamp is switched on; adjusted standard GPS time. [s]
    progress : callable
        Called with "sphere", images done, images in all.

    Returns
    -------
    float
        Slope of the lamp's output over the stability series, as `campaign.truth.TrueBench` defines it. [% per hour]

    Raises
    ------
    ConfigError
        The sphere cannot be built for this camera, or the window is too small.
    """
    sphere, camera = config.bench.sphere, config.camera
    if sphere.window_px is not None and min(sphere.window_px) < MIN_WINDOW_PX:
        raise ConfigError(
            "is too small a window",
            where="bench.sphere.window_px",
            got=f"{sphere.window_px[0]} x {sphere.window_px[1]}",
            expected=f"at least {MIN_WINDOW_PX} x {MIN_WINDOW_PX} px",
        )
    progress("sphere", 0, 2 * sphere.images)
    window = sensor.middle_window(camera, sphere.window_px)
    light = sphere_light(config, window)
    count = np.arange(sphere.images)
    stability_s = sphere.wait_s + sphere.stability_interval_s * count
    repeatability_s = stability_s[-1] + sphere.stability_interval_s + sphere.repeatability_interval_s * count
    bench = _Bench(
        config=config,
        start_gps_s=start_gps_s,
        window=window,
        light=light,
        exposing=bench_exposure(config, light, float(lamp_output(sphere, stability_s[:1])[0])),
        pattern=sensor.fixed_pattern(generator(config.seed, Stream.CAMERA_FIXED_PATTERN)),
    )
    for key, folder, times in (
        (STABILITY, place.sphere_stability, stability_s),
        (REPEATABILITY, place.sphere_repeatability, repeatability_s),
    ):
        _take_series(bench, key, folder, times, progress, journal or Journal())
    return drift_percent_per_h(stability_s, lamp_output(sphere, stability_s))


def bench_exposure(config: Config, light: SphereLight, output: float) -> sensor.Exposing:
    """Exposure and gain as an operator sets them by the first picture, so a fault of the camera's gain is in it."""
    share = min(config.bench.sphere.exposure_share / config.faults.camera_gain, MAX_SHARE)
    return sensor.exposure_for(config.camera, light.band_radiance * output, share)


@dataclass(frozen=True, kw_only=True)
class _Bench:
    config: Config
    start_gps_s: float
    window: sensor.Window
    light: SphereLight
    exposing: sensor.Exposing
    pattern: sensor.FixedPattern


def _take_series(
    bench: _Bench, key: int, folder: Path, times_s: np.ndarray, progress: Report, journal: Journal
) -> None:
    """Images and log.csv of one series."""
    config = bench.config
    folder.mkdir(parents=True, exist_ok=True)
    flicker = generator(config.seed, Stream.SPHERE, key).standard_normal(len(times_s))
    output = lamp_output(config.bench.sphere, times_s) * (1 + config.bench.sphere.noise_percent / 100 * flicker)
    output *= response(config, key)
    digits = max(3, len(str(len(times_s))))
    names = [f"s_{k:0{digits}d}" for k in range(1, len(times_s) + 1)]
    before, total = key * len(times_s), 2 * len(times_s)
    # Every image has random numbers of its own: the order in which threads take them does not matter.
    with ThreadPoolExecutor(WRITERS) as writers:
        jobs = [
            writers.submit(_take, bench, (key, k), folder / name, float(times_s[k]), float(output[k]), journal)
            for k, name in enumerate(names)
            if journal.wants(_unit(key, k))
        ]
        for done, job in enumerate(jobs, start=1):
            job.result()
            progress("sphere", before + done, total)
    if journal.shares:
        return
    write_sphere_log(
        folder / "log.csv",
        [
            SphereExposure(
                image=f"{name}.tif",
                gps_time_s=bench.start_gps_s + float(t),
                since_lamp_on_s=float(t),
                exposure_time_s=bench.exposing.exposure_time_s,
                gain_e_per_dn=bench.exposing.e_per_dn,
                f_number=config.camera.f_number,
                camera_temperature_c=round(sensor_temperature_c(config, float(t)), 2),
            )
            for name, t in zip(names, times_s, strict=True)
        ],
    )


def sphere_picture(
    camera: Camera,
    light: SphereLight,
    output: float,
    exposing: sensor.Exposing,
    pattern: sensor.FixedPattern,
    window: sensor.Window,
    rng: np.random.Generator,
    dark_e_s: float | None = None,
    gain_fault: float = 1.0,
) -> np.ndarray:
    """DN of one exposure, (h, w, bands) uint16.

    Parameters
    ----------
    output : float
        Of the lamp, relative to its nominal power, flicker included.
    window
        The pixels that are read out; `light` shows the same ones.
    """
    relative = np.broadcast_to(light.relative[..., None], (*light.relative.shape, len(camera.bands)))
    setting = sensor.under_light(exposing, light.band_radiance * output)
    return sensor.expose(relative, camera, setting, gain_fault, rng, pattern, window, dark_e_s)


def _unit(key: int, k: int) -> str:
    return f"sphere {key} {k}"


def _take(bench: _Bench, key: tuple[int, int], path: Path, since_on_s: float, output: float, journal: Journal) -> None:
    """One exposure and its file; a preview beside the first."""
    config, camera = bench.config, bench.config.camera
    temperature_c = sensor_temperature_c(config, since_on_s)
    dn = sphere_picture(
        camera,
        bench.light,
        output,
        bench.exposing,
        bench.pattern,
        bench.window,
        generator(config.seed, Stream.SPHERE, *key),
        sensor.dark_current_e_s(camera, temperature_c, config.bench.sphere.dark_current_doubling_k),
        config.faults.camera_gain,
    )
    tags = images.ImageTags(
        camera_name=camera.name,
        manufacturer=camera.manufacturer,
        gps_time_s=bench.start_gps_s + since_on_s,
        exposure_time_s=bench.exposing.exposure_time_s,
        f_number=camera.f_number,
        focal_length_mm=camera.nominal_focal_length_mm,
        pixel_size_um=camera.pixel_size_um,
        black_level_dn=camera.black_level_dn,
        bit_depth=camera.bit_depth,
        latitude_deg=config.site.latitude_deg,
        longitude_deg=config.site.longitude_deg,
        ellipsoid_height_m=config.site.ellipsoid_height_m,
        roll_deg=0.0,
        pitch_deg=0.0,
        heading_deg=0.0,
        bands=tuple(band.name for band in camera.bands),
    )
    images.write_image(path.with_suffix(".tif"), dn, tags)
    files = [path.with_suffix(".tif")]
    if key[1] == 0:
        files.append(path.with_suffix(".jpg"))
        images.write_preview(files[1], sensor.preview(dn, camera), tags)
    journal.finish(_unit(*key), files)
