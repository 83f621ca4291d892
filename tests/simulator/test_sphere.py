"""The sphere's bench: geometry, lamp, exposure, what is written, and the sensor's windows."""

from pathlib import Path

import numpy as np
import pytest

from campaign.benches.bench import read_sphere_log
from campaign.config import Band, Bench, Camera, CampaignInfo, Config, Faults, Lens, Sphere
from campaign.errors import ConfigError
from campaign.flight.images import read_image, read_preview, read_tags
from campaign.folder import CampaignFolder
from scenes.sphere import SphereScene, black_body_share_per_nm, build_sphere, lamp_flux_per_nm
from simulator.bench.sphere import (
    SphereLight,
    bench_exposure,
    drift_percent_per_h,
    lamp_output,
    sensor_temperature_c,
    simulate_sphere,
    sphere_light,
    sphere_picture,
)
from simulator.camera import sensor
from simulator.randomness import Stream, generator
from simulator.render.sphere import wall_points

BANDS = (
    Band(name="red", centre_nm=620.0, fwhm_nm=70.0),
    Band(name="green", centre_nm=540.0, fwhm_nm=75.0),
    Band(name="blue", centre_nm=465.0, fwhm_nm=70.0),
)


def camera(**changes: object) -> Camera:
    values: dict = {
        "width_px": 96,
        "height_px": 64,
        "pixel_size_um": 4.5,
        "nominal_focal_length_mm": 13.5,
        "lens": Lens(fx_px=100.0, fy_px=100.0, cx_px=48.0, cy_px=32.0, k1=-0.05),
        "bands": BANDS,
        "full_well_e": 48000.0,
        "vignetting": 0.1,
    }
    return Camera(**(values | changes))


def config(cam: Camera | None = None, seed: int = 1, camera_gain: float = 1.0, **sphere: object) -> Config:
    return Config(
        campaign=CampaignInfo(id="bench"),
        camera=cam or camera(),
        seed=seed,
        bench=Bench(sphere=Sphere(**({"images": 4} | sphere))),
        faults=Faults(camera_gain=camera_gain),
    )


def taken(root: Path, setting: Config) -> tuple[CampaignFolder, float]:
    place = CampaignFolder(root)
    return place, simulate_sphere(setting, place, 1000.0, lambda stage, done, total: None)


# ------------------------------------------------------------------------------------------------------------ geometry


def hidden(scene: SphereScene, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Whether the baffle stands between two points."""
    baffle = scene.baffle
    assert baffle is not None
    way = end - begin
    share = ((baffle.centre_m - begin) @ baffle.normal) / (way @ baffle.normal)
    crossing = begin + share[:, None] * way - baffle.centre_m
    return (share > 0) & (share < 1) & (np.linalg.norm(crossing, axis=1) < baffle.radius_m)


@pytest.mark.parametrize("port_m", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("fx", [55.0, 100.0, 200.0])
def test_the_lamp_is_hidden_from_all_that_the_camera_sees(port_m: float, fx: float) -> None:
    """Rationale: an integrating sphere must show no direct light of its lamp.

    Expected: no straight line from any point of the lamp to any point of the wall in the picture; the picture shows wall
    only; the baffle lies inside the sphere and outside the picture.
    """
    cam = camera(lens=Lens(fx_px=fx, fy_px=fx, cx_px=48.0, cy_px=32.0))
    scene = build_sphere(Sphere(port_diameter_m=port_m), cam)
    assert scene.baffle is not None
    rng = np.random.default_rng(3)
    n = 20_000
    x, y = rng.uniform(-48 / fx, 48 / fx, n), rng.uniform(-32 / fx, 32 / fx, n)
    x[:4], y[:4] = np.array([-1, 1, -1, 1]) * 48 / fx, np.array([-1, -1, 1, 1]) * 32 / fx
    wall = wall_points(scene, np.column_stack([x, y, np.ones(n)]))
    assert np.isfinite(wall).all()
    assert np.linalg.norm(wall, axis=1) == pytest.approx(0.4, rel=1e-5)
    # On the line of sight: the camera's ray comes back.
    back = wall - scene.camera_m
    assert np.column_stack([x, y]) == pytest.approx(back[:, :2] / back[:, 2:], abs=2e-6)
    r, a = np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    across = np.array([1.0, 0.0, 0.0])
    disc = (r * np.cos(a))[:, None] * across + (r * np.sin(a))[:, None] * np.cross(scene.lamp_direction, across)
    lamp = 0.4 * (np.cos(scene.lamp_half_angle_rad) * scene.lamp_direction + np.sin(scene.lamp_half_angle_rad) * disc)
    assert hidden(scene, lamp, wall).all()
    assert not hidden(scene, np.broadcast_to(scene.camera_m, wall.shape), wall).any()
    assert np.linalg.norm(scene.baffle.centre_m) + scene.baffle.radius_m < 0.8
    assert scene.lamp_direction @ [0, 0, -1] < np.cos(scene.port_half_angle_rad + scene.lamp_half_angle_rad)


def test_areas() -> None:
    """Expected: a port of 0.2 m in 0.8 m is a cap of half angle asin(1/4): (1 - sqrt(15)/4)/2 = 1.5877 % of the sphere."""
    scene = build_sphere(Sphere(), camera())
    assert scene.port_share == pytest.approx((1 - np.sqrt(15) / 4) / 2, rel=1e-12)
    assert scene.area_m2 == pytest.approx(np.pi * 0.64)
    assert scene.lamp_area_m2 == pytest.approx(np.pi * 0.0004)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"port_diameter_m": 0.7}, "port_diameter_m"),
        ({"lamp_diameter_m": 0.9}, "lamp_diameter_m"),
        ({"lamp_diameter_m": 0.5}, "lamp"),
        ({"lamp_diameter_m": 0.25}, "baffle"),
        ({"window_px": (2, 2)}, "window_px"),
    ],
)
def test_what_cannot_be_built_is_told(tmp_path: Path, changes: dict[str, object], word: str) -> None:
    """Expected: one line that names the setting."""
    with pytest.raises(ConfigError, match=word):
        taken(tmp_path, config(**changes))


# ----------------------------------------------------------------------------------------------------------------- lamp


def test_black_body() -> None:
    """Rationale: the lamp's power is spread over wavelengths by Planck's law.

    Expected: it integrates to 1; a quarter (25.005 %) lies below the peak, lambda T = 2897.77 um K (tables of radiation
    functions); at 620 nm and 2856 K, by hand: c1/lambda^5 = 4.0849e15, exp(8.12555) - 1 = 3378.3, over sigma T^4 = 3.7725e6.
    Tolerance: of the integration, and of the hand's digits.
    """
    nm = np.geomspace(100.0, 1e6, 20_001)
    share = black_body_share_per_nm(2856.0, nm)
    assert np.trapezoid(share, nm) == pytest.approx(1.0, abs=2e-4)
    below = nm <= 2897.77e3 / 2856.0
    assert np.trapezoid(share[below], nm[below]) == pytest.approx(0.25005, abs=2e-4)
    by_hand = 4.0849e15 / 3378.3 * 1e-9 / 3.7725e6
    assert float(black_body_share_per_nm(2856.0, np.array([620.0]))[0]) == pytest.approx(by_hand, rel=1e-3)
    narrow = Band(name="narrow", centre_nm=620.0, fwhm_nm=1.0)
    assert lamp_flux_per_nm(Sphere(lamp_power_w=50.0), narrow) == pytest.approx(50.0 * by_hand, rel=1e-3)


def test_lamp_over_time() -> None:
    """Expected: 1 - 0.04 at switch-on; 0.04/e is missing after 240 s, with 0.6 % an hour 0.04 % more; never below zero.

    The drift over a straight ramp of 2 % an hour about its mean 1.01 is 2/1.01 % an hour.
    """
    sphere = Sphere(drift_percent_per_h=0.6)
    expected = [0.96, 1 - 0.04 / np.e + 0.0004]
    assert lamp_output(sphere, np.array([0.0, 240.0])) == pytest.approx(expected, rel=1e-12)
    assert (lamp_output(Sphere(drift_percent_per_h=-200.0), np.array([3600.0])) == 0).all()
    t = np.arange(0.0, 3601.0, 180.0)
    assert drift_percent_per_h(t, 1 + 0.02 * t / 3600) == pytest.approx(2 / 1.01, rel=1e-12)
    assert drift_percent_per_h(t, 0 * t) == 0.0


# --------------------------------------------------------------------------------------------------------------- sensor


def test_window_is_the_same_pixels_as_in_flight() -> None:
    """Rationale: the bench must judge the camera that flies: PRNU, DSNU and vignetting of the pixels read out.

    Expected: a window's pattern is the whole picture's part to the bit, also of odd sizes, and what a window's pictures show on
    the average is what the whole picture's show there. Tolerance: 5 standard deviations of the difference of two means of 64
    pictures' shot noise, for the greatest of 1860 pixels; the pattern itself spreads by more than 50 DN.
    """
    cam = camera(read_noise_e=0.0, prnu=0.02, dsnu_e=40.0)
    whole = sensor.middle_window(cam, None)
    window = sensor.middle_window(cam, (31, 20))
    assert (window.column, window.row, window.width_px, window.height_px) == (32, 22, 31, 20)
    assert sensor.middle_window(cam, (9999, 9999)) == whole
    light = SphereLight(relative=np.ones((64, 96), np.float32), band_radiance=np.array([0.05, 0.03, 0.02]))
    exposing = sensor.exposure_for(cam, light.band_radiance, 0.65)
    pattern = sensor.fixed_pattern(generator(1, Stream.CAMERA_FIXED_PATTERN))
    for key in (pattern.prnu, pattern.dsnu):
        everywhere = sensor.deviates(key, cam, whole)
        assert np.array_equal(sensor.deviates(key, cam, window), everywhere[window.cut])
        assert everywhere.std() == pytest.approx(1.0, abs=0.03) and abs(everywhere.mean()) < 0.03
    assert (
        abs(np.corrcoef(*(sensor.deviates(k, cam, whole).ravel() for k in (pattern.prnu, pattern.dsnu)))[0, 1]) < 0.03
    )

    def mean(part: SphereLight, seen: sensor.Window, first: int) -> np.ndarray:
        rngs = (np.random.default_rng(first + k) for k in range(64))
        return np.mean([sphere_picture(cam, part, 1.0, exposing, pattern, seen, rng) for rng in rngs], axis=0)

    cut = SphereLight(relative=light.relative[window.cut], band_radiance=light.band_radiance)
    everything, part = mean(light, whole, 0), mean(cut, window, 1000)
    noise = np.sqrt(everything[window.cut] / exposing.e_per_dn / 32)  # of the difference of two such means
    assert np.abs((part - everything[window.cut]) / noise).max() < 5.0
    assert everything.std(axis=(0, 1)).min() > 50


def test_exposure_on_the_bench() -> None:
    """Expected: the brightest band reaches the share at base gain (full well at full scale); a light ten times fainter gets
    ten times the exposure; one that a second does not suffice for gets gain; a fault of the gain is in the picture that
    the operator looks at."""
    cam = camera()
    light = SphereLight(relative=np.ones((1, 1), np.float32), band_radiance=np.array([0.05, 0.03, 0.02]))
    exposing = bench_exposure(config(cam), light, 1.0)
    full = 2**14 - 1 - cam.black_level_dn
    assert exposing.e_per_dn == pytest.approx(48000 / full)
    assert exposing.white_dn.max() == pytest.approx(0.65 * full)
    fainter = bench_exposure(config(cam), light, 0.1)
    assert fainter.exposure_time_s == pytest.approx(10 * exposing.exposure_time_s)
    faintest = bench_exposure(config(cam), light, 1e-4 * exposing.exposure_time_s)
    assert faintest.exposure_time_s == sensor.LONGEST_EXPOSURE_S
    assert faintest.white_dn.max() == pytest.approx(0.65 * full)
    assert faintest.e_per_dn == pytest.approx(exposing.e_per_dn * 1e-4)
    faulty = bench_exposure(config(cam, camera_gain=1.3), light, 1.0)
    assert faulty.white_dn.max() * 1.3 == pytest.approx(0.65 * full)


def test_dark_current_and_temperature() -> None:
    """Expected: twice the dark current 6.5 K up; the sensor at the room's 20 degrees at switch-on, 6 (1 - 1/e) up after its time
    constant."""
    cam = camera(dark_current_e_s=2.0)
    assert sensor.dark_current_e_s(cam, 20.0, 6.5) == 2.0
    assert sensor.dark_current_e_s(cam, 26.5, 6.5) == pytest.approx(4.0)
    assert sensor_temperature_c(config(), 0.0) == 20.0
    assert sensor_temperature_c(config(), 900.0) == pytest.approx(20 + 6 * (1 - 1 / np.e))
    pattern = sensor.FixedPattern(prnu=np.uint64(1), dsnu=np.uint64(2))
    exposing = sensor.Exposing(e_per_radiance=np.zeros(3), e_per_dn=1.0, exposure_time_s=1.0, white_dn=np.zeros(3))
    dark = np.zeros((64, 96, 3), np.float32)
    means = [
        sensor.expose(dark, cam, exposing, 1.0, np.random.default_rng(1), pattern, dark_e_s=e).mean()
        - cam.black_level_dn
        for e in (None, 2.0, 400.0)
    ]
    assert means[0] == means[1] == pytest.approx(2.0, abs=0.15)  # 18 432 pixels of 3.3 e: 0.024 DN
    assert means[2] == pytest.approx(400.0, abs=1.0)


# ---------------------------------------------------------------------------------------------------------------- light


def test_light_of_the_picture() -> None:
    """Rationale: the map comes from a grid of 17 x 13 places and splines between them.

    Expected: 80 to 97 % of sphere theory without the lamp's direct light: the baffle stands close before the lamp, 58 % of whose
    flux it sends back, and the lamp's black face takes a part of that (tests/truth compares this with photons one by one); even
    to 1 % over a field of 58 degrees; smooth; mirrored left and right.
    Tolerance: 0.3 % for the symmetry, six times the map's noise.
    """
    setting = config(camera(lens=Lens(fx_px=100.0, fy_px=100.0, cx_px=48.0, cy_px=32.0)))
    light = sphere_light(setting, sensor.middle_window(setting.camera, None))
    f = (1 - np.sqrt(15) / 4) / 2 + (1 - np.sqrt(1 - 0.0025)) / 2
    theory = 60.0 / (np.pi * np.pi * 0.64) * 0.97 * 0.97 * (1 - f) / (1 - 0.97 * (1 - f))
    flux = np.array([lamp_flux_per_nm(setting.bench.sphere, band) for band in BANDS])
    part = light.band_radiance / (theory * flux / 60.0)
    assert part == pytest.approx(part[0], rel=1e-6)
    assert 0.80 < part[0] < 0.97
    assert light.relative.max() == pytest.approx(1.0, abs=1e-3)
    assert 0.99 < light.relative.min() < 0.9999
    assert np.abs(np.diff(light.relative, n=2, axis=1)).max() < 3e-4
    assert light.relative == pytest.approx(light.relative[:, ::-1], abs=3e-3)


# ---------------------------------------------------------------------------------------------------------------- files


def test_what_is_written(tmp_path: Path) -> None:
    """Expected: both series with their times and one setting; the first image reaches the share of full scale; TIFFs with the
    camera's tags; a preview of the first only; windows of the size asked for."""
    setting = config(window_px=(40, 30), exposure_share=0.5, drift_percent_per_h=3.0)
    seen: list[tuple[str, int, int]] = []
    place = CampaignFolder(tmp_path)
    drift = simulate_sphere(setting, place, 1000.0, lambda *at: seen.append(at))
    assert seen == [("sphere", k, 8) for k in range(9)]
    first, second = (read_sphere_log(f / "log.csv") for f in (place.sphere_stability, place.sphere_repeatability))
    assert [r.since_lamp_on_s for r in first] == [1500.0, 1680.0, 1860.0, 2040.0]
    assert [r.since_lamp_on_s for r in second] == [2220.0, 2235.0, 2250.0, 2265.0]
    assert [r.gps_time_s - 1000.0 for r in first + second] == [r.since_lamp_on_s for r in first + second]
    assert len({(r.exposure_time_s, r.gain_e_per_dn, r.f_number) for r in first + second}) == 1
    assert first[0].camera_temperature_c == pytest.approx(20 + 6 * (1 - np.exp(-1500 / 900)), abs=0.005)
    # A ramp of 3 % an hour and the last of the warm-up, about a mean of 1.0147.
    t = np.array([1500.0, 1680.0, 1860.0, 2040.0])
    out = 1 - 0.04 * np.exp(-t / 240) + 0.03 * t / 3600
    assert drift == pytest.approx(100 * 3600 * np.polyfit(t, out, 1)[0] / out.mean(), rel=1e-9)
    images = []
    for folder in (place.sphere_stability, place.sphere_repeatability):
        names = sorted(p.name for p in folder.iterdir())
        assert names == ["log.csv", "s_001.jpg", "s_001.tif", "s_002.tif", "s_003.tif", "s_004.tif"]
        images += [read_image(folder / f"s_00{k}.tif", width_px=40, height_px=30, bands=3) for k in range(1, 5)]
        assert read_preview(folder / "s_001.jpg", width_px=40, height_px=30).mean() > 50
    red = images[0][..., 0].astype(float) - setting.camera.black_level_dn
    # The window's corner is at 0.43 of the sensor's: 10 % vignetting leaves 1 % on average.
    assert red.max() == pytest.approx(0.5 * (2**14 - 1 - 256), rel=0.03)
    tags = read_tags(place.sphere_stability / "s_001.tif")
    assert tags["BlackLevel"] == (256.0,) * 3 and tags["FNumber"] == pytest.approx(5.6)
    assert tags["ExposureTime"] == pytest.approx(first[0].exposure_time_s, rel=1e-4)
    assert len({image.tobytes() for image in images}) == 8


def test_dark_current_and_gain_fault_reach_the_files(tmp_path: Path) -> None:
    """Rationale: the bench sees the camera as it is: its warm sensor and its gain.

    Expected: 200 000 e/s at 20 degrees rise with the sensor's warm-up between the first and the fourth image; a gain fault of
    1.2 raises that by 1.2, and leaves the light at the share that the operator sets.
    Tolerance: 1200 pixels of 60 DN noise (shot 46, PRNU 42): 5 standard errors of the difference, PRNU common: 9.4 DN.
    """
    cam = camera(dark_current_e_s=2e5, vignetting=0.0)
    quiet = {"window_px": (40, 30), "drift_percent_per_h": 0.0, "noise_percent": 0.0, "warm_up_share": 0.0}
    place, drift = taken(tmp_path, config(cam, camera_gain=1.2, **quiet))
    assert drift == 0.0
    row = read_sphere_log(place.sphere_stability / "log.csv")[0]
    assert row.exposure_time_s is not None and row.gain_e_per_dn is not None
    first, last = (
        read_image(place.sphere_stability / f"s_00{k}.tif", width_px=40, height_px=30, bands=3)[..., 0].mean()
        for k in (1, 4)
    )
    doublings = 6 * (1 - np.exp(-np.array([1500.0, 2040.0]) / 900)) / 6.5
    dark = 1.2 * 2e5 * row.exposure_time_s * 2**doublings / row.gain_e_per_dn
    assert last - first == pytest.approx(dark[1] - dark[0], abs=9.4)
    assert dark[1] - dark[0] > 30
    assert first - 256 - dark[0] == pytest.approx(0.65 * 16127, rel=0.005)


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    """Expected: two runs leave the same files to the byte, another seed other images under the same light."""

    def files(name: str, seed: int) -> dict[str, bytes]:
        root = tmp_path / name
        taken(root, config(seed=seed, window_px=(16, 12)))
        return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}

    first, again, other = files("a", 1), files("b", 1), files("c", 2)
    assert first == again and first.keys() == other.keys()
    assert first["bench/sphere_stability/s_001.tif"] != other["bench/sphere_stability/s_001.tif"]
