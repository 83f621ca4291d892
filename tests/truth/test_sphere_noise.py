"""Issue 3, point 4: RSD and s(x) against the noise model in closed form, photon transfer, the lamp's drift and warm-up."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from campaign.config import Band, Bench, Camera, CampaignInfo, Config, Lens, Sphere
from campaign.folder import CampaignFolder
from campaign.manifest import Manifest, write_manifest
from campaign.sensors import write_sheet
from evaluator.benches.bench_model import SphereResult
from evaluator.c8_2_camera_radiometry import evaluate_sphere, repeatability, stability_rsd
from evaluator.load import load_campaign
from simulator.bench.sphere import SphereLight, bench_exposure, lamp_output, simulate_sphere, sphere_picture
from simulator.camera import sensor
from simulator.flight import rig
from simulator.randomness import Stream, generator

BANDS = (
    Band(name="red", centre_nm=620.0, fwhm_nm=70.0),
    Band(name="green", centre_nm=540.0, fwhm_nm=75.0),
    Band(name="blue", centre_nm=465.0, fwhm_nm=70.0),
)
CAMERA = Camera(
    width_px=64,
    height_px=64,
    pixel_size_um=4.5,
    nominal_focal_length_mm=13.5,
    lens=Lens(fx_px=100.0, fy_px=100.0, cx_px=32.0, cy_px=32.0),
    bands=BANDS,
    f_number=4.0,
    full_well_e=48000.0,
    dark_current_e_s=2.0,
)
SEEDS = 50
IMAGES = 21
TESTS = 2 * 2 * 3  # lamps, series, bands
SIDE_PX = 3
RADIANCE = np.array([0.053, 0.032, 0.0155])  # as the default sphere's [W m-2 sr-1 nm-1]


def config(camera: Camera = CAMERA, **sphere: object) -> Config:
    return Config(campaign=CampaignInfo(id="bench"), camera=camera, bench=Bench(sphere=Sphere(**sphere)))


STEADY = config()
UNSTEADY = config(drift_percent_per_h=2.0, noise_percent=0.15, wait_s=600.0)


@dataclass(frozen=True)
class Taken:
    """DN above black of many seeds' series, (seeds, images, bands), and what the closed form needs."""

    stability: np.ndarray
    repeatability: np.ndarray
    e_per_dn: float
    exposure_time_s: float
    stability_s: np.ndarray
    repeatability_s: np.ndarray


def times(setting: Config) -> tuple[np.ndarray, np.ndarray]:
    """3 min over an hour, then 15 s over 5 min."""
    first = setting.bench.sphere.wait_s + 180.0 * np.arange(IMAGES)
    return first, first[-1] + 180.0 + 15.0 * np.arange(IMAGES)


def take(setting: Config, seeds: int = SEEDS) -> Taken:
    """Both series of many cameras with the light given: only the nine central pixels are read out."""
    camera, sphere = setting.camera, setting.bench.sphere
    window = sensor.middle_window(camera, (SIDE_PX, SIDE_PX))
    light = SphereLight(relative=np.ones((SIDE_PX, SIDE_PX), np.float32), band_radiance=RADIANCE)
    exposing = bench_exposure(setting, light, float(lamp_output(sphere, times(setting)[0][:1])[0]))
    dn = np.empty((2, seeds, IMAGES, len(camera.bands)))
    for seed in range(seeds):
        pattern = sensor.fixed_pattern(generator(seed, Stream.CAMERA_FIXED_PATTERN))
        for series, at in enumerate(times(setting)):
            flicker = np.random.default_rng([seed, series, 1]).standard_normal(IMAGES)
            output = lamp_output(sphere, at) * (1 + sphere.noise_percent / 100 * flicker)
            for k in range(IMAGES):
                rng = np.random.default_rng([seed, series, 2, k])
                image = sphere_picture(camera, light, output[k], exposing, pattern, window, rng)
                dn[series, seed, k] = image.astype(float).mean(axis=(0, 1)) - camera.black_level_dn
    first, second = times(setting)
    return Taken(dn[0], dn[1], exposing.e_per_dn, exposing.exposure_time_s, first, second)


def lamp(setting: Config, at: np.ndarray) -> np.ndarray:
    """The lamp by hand: 1 - w exp(-t/tau) + drift t."""
    s = setting.bench.sphere
    return 1 - s.warm_up_share * np.exp(-at / s.warm_up_time_s) + s.drift_percent_per_h / 100 * at / 3600


def predicted(setting: Config, dn: np.ndarray, at: np.ndarray, taken: Taken) -> tuple[np.ndarray, np.ndarray]:
    """Variance of one image's mean of nine [DN^2], and the sum of squares of the lamp's own course [DN^2], per band.

    variance = (mu/K + (dark + read^2)/K^2 + 1/12) / 9 + (lamp noise mu)^2; PRNU is the same in all images.
    """
    camera = setting.camera
    k = taken.e_per_dn
    mean = dn.mean(axis=(0, 1))
    dark = camera.dark_current_e_s * taken.exposure_time_s
    pixel = mean / k + (dark + camera.read_noise_e**2) / k**2 + 1 / 12
    variance = pixel / 9 + (setting.bench.sphere.noise_percent / 100 * mean) ** 2
    course = lamp(setting, at) / lamp(setting, at).mean()
    return variance, np.sum((course - course.mean()) ** 2) * mean**2


@pytest.fixture(scope="module", params=["steady", "unsteady"])
def seeds(request: pytest.FixtureRequest) -> tuple[Config, Taken]:
    """Fifty seeds of the default lamp, and of one that drifts by 2 % an hour, flickers and has warmed up for 10 min only."""
    setting = {"steady": STEADY, "unsteady": UNSTEADY}[request.param]
    return setting, take(setting)


def test_rsd_and_repeatability_follow_the_noise_model(seeds: tuple[Config, Taken]) -> None:
    """Rationale: 8.2's figures must come from gain, shot and read noise, quantisation and lamp, and nothing else.

    Expected: over fifty seeds sum((n - 1) s^2 / sigma^2) of either figure and every band is chi-square with 50 x 20 degrees
    of freedom, non-central by the lamp's own course (drift, rest of the warm-up); s is taken back from the figure in percent.
    Tolerance: the distribution's 0.1 % and 99.9 % points, shared by the twelve tests.
    """
    setting, taken = seeds
    for formula, dn, at in (
        (stability_rsd, taken.stability, taken.stability_s),
        (repeatability, taken.repeatability, taken.repeatability_s),
    ):
        variance, course = predicted(setting, dn, at, taken)
        for band in range(3):
            s = [formula(series) / 100 * series.mean() for series in dn[:, :, band]]
            pooled = (IMAGES - 1) * np.sum(np.square(s)) / variance[band]
            shifted = stats.ncx2(SEEDS * (IMAGES - 1), SEEDS * course[band] / variance[band])
            low, high = shifted.ppf([0.001 / TESTS, 1 - 0.001 / TESTS])
            assert low < pooled < high, (formula.__name__, band, pooled / (SEEDS * (IMAGES - 1)))


def test_drift_moves_rsd_and_not_repeatability() -> None:
    """Rationale: one hour sees a drift of 2 % an hour, five minutes do not: the standard's two figures part there.

    Expected: n images of a ramp that rises by S add S^2 n (n + 1) / (12 (n - 1)^2) to the variance: 0.609 % to RSD, in
    quadrature; to s(x) 0.051 %, which is 0.8 % of the worst band's 0.41 %. The same 200 seeds with and without the drift.
    Tolerance: RSD 5 %: the cross term of ramp and noise leaves 2 x 0.609 x 0.41 / sqrt(200 x 20) %^2 in the worst band's
    variance, 1.1 % of its root; four of them. s(x) of the worst band: 2 % of itself, the ramp's 0.8 % and a cross term.
    """
    still, moving = (take(config(drift_percent_per_h=d, noise_percent=0.0, warm_up_share=0.0), 200) for d in (0.0, 2.0))

    def pooled(formula: object, dn: np.ndarray) -> np.ndarray:
        assert callable(formula)
        return np.array([np.mean([formula(series) ** 2 for series in dn[:, :, b]]) for b in range(3)])

    span = 2.0 / (1 + 0.02 * moving.stability_s.mean() / 3600)
    added = pooled(stability_rsd, moving.stability) - pooled(stability_rsd, still.stability)
    assert np.sqrt(added) == pytest.approx(span * np.sqrt(IMAGES * (IMAGES + 1) / 12) / (IMAGES - 1), rel=0.05)
    before, after = (np.sqrt(pooled(repeatability, taken.repeatability)) for taken in (still, moving))
    assert after[2] == pytest.approx(before[2], rel=0.02)
    assert (
        np.sqrt(pooled(stability_rsd, moving.stability)) > 1.5 * np.sqrt(pooled(stability_rsd, still.stability))
    ).all()


def test_photon_transfer_gives_back_gain_and_read_noise() -> None:
    """Rationale: what a laboratory would measure on this camera must be what the configuration says it is.

    Expected: two flats a level, 14 levels up to 70 % of saturation: temporal variance (half that of the difference, so PRNU
    falls out) against mean, both above dark: slope 1/K; and from two dark images sigma_r^2 = (variance - 1/12) K^2 - dark.
    Tolerance: 1 % each, asked for by the issue. Standard errors with 440 000 pixels: 0.06 % of gain, 0.12 % of read noise.
    """
    camera = CAMERA.model_copy(update={"width_px": 448, "height_px": 328})
    setting = config(camera)
    window = sensor.middle_window(camera, None)
    light = SphereLight(relative=np.ones((328, 448), np.float32), band_radiance=np.full(3, 0.03))
    exposing = bench_exposure(setting, light, 1.0)
    # One band for all: the flats differ in light alone.
    exposing = replace(exposing, e_per_radiance=np.full(3, exposing.e_per_radiance.max()))
    pattern = sensor.fixed_pattern(generator(1, Stream.CAMERA_FIXED_PATTERN))
    top = 0.7 / setting.bench.sphere.exposure_share

    def flats(level: float, key: int) -> tuple[float, float]:
        a, b = (
            sphere_picture(camera, light, level, exposing, pattern, window, np.random.default_rng([key, n])).astype(
                float
            )
            for n in (0, 1)
        )
        return 0.5 * (a.mean() + b.mean()), 0.5 * float((a - b).var())

    dark_mean, dark_variance = flats(0.0, 0)
    found = np.array([flats(level, key) for key, level in enumerate(np.linspace(0.05, top, 14), 1)])
    signal, variance = found[:, 0] - dark_mean, found[:, 1] - dark_variance
    # Every variance has the same relative error: the slope weighted by it.
    e_per_dn = 1 / float(np.mean(variance / signal))
    assert e_per_dn == pytest.approx(camera.full_well_e / (2**14 - 1 - camera.black_level_dn), rel=0.01)
    assert e_per_dn == pytest.approx(exposing.e_per_dn, rel=0.01)
    dark = camera.dark_current_e_s * exposing.exposure_time_s
    read = np.sqrt((dark_variance - 1 / 12) * e_per_dn**2 - dark)
    assert read == pytest.approx(camera.read_noise_e, rel=0.01)
    assert dark_mean == pytest.approx(camera.black_level_dn, abs=0.05)


def through_files(tmp_path: Path, setting: Config) -> tuple[SphereResult, float]:
    """Simulated, written, read and evaluated; and the lamp's true drift."""
    place = CampaignFolder(tmp_path / "campaign")
    place.root.mkdir()
    drift = simulate_sphere(setting, place, 1.4e9, lambda stage, done, total: None)
    write_sheet(place.camera, rig.camera_sheet(setting))
    about = {"campaign": "bench", "title": "", "synthetic": True, "date": "2026-06-11", "gps_week": 2422}
    where = {"latitude_deg": 31.0, "longitude_deg": 121.0, "ellipsoid_height_m": 18.0, "height_anomaly_m": 11.2}
    systems = {"projection_epsg": 4549, "height_epsg": 5737, "software": {}, "files": ()}
    write_manifest(place.root, Manifest(start_time="2026-06-11T10:30:00+08:00", **about, **where, **systems))
    return evaluate_sphere(load_campaign(place.root)), drift


@pytest.mark.parametrize(("drift_set", "noise"), [(1.0, 0.02), (0.1, 1.0)])
def test_through_files(tmp_path: Path, drift_set: float, noise: float) -> None:
    """Rationale: one seed the whole way: rendered light, TIFF, log, evaluator.

    Expected: both figures of every band by the noise model, also where the lamp flickers by 1 %; PRNU and light as rendered; the
    trend is the lamp's drift; the photon noise that the evaluator expects is the noise model's.
    Tolerance: chi-square with 20 degrees of freedom at 0.1 % and 99.9 % over six figures; four standard deviations of the trend.
    """
    setting = config(drift_percent_per_h=drift_set, noise_percent=noise)
    result, drift = through_files(tmp_path, setting)
    ramp = drift_set / (1 + drift_set / 100 * 3300 / 3600)
    assert drift == pytest.approx(ramp, abs=0.01)  # the last of the warm-up: 0.008 % at the first image
    for found, series in (
        (result.stability, result.stability_series),
        (result.repeatability, result.repeatability_series),
    ):
        assert found.value is not None and series is not None
        since = series.since_lamp_on_s
        assert since is not None
        taken = Taken(series.dn, series.dn, 48000 / 16127, 0.005, since + series.time_s, since + series.time_s)
        variance, course = predicted(setting, series.dn[None], since + series.time_s, taken)
        channels = found.companions["channels"]
        assert isinstance(channels, dict)
        assert found.value == max(c["value"] for c in channels.values())
        for band, channel in enumerate(channels.values()):
            mean = series.dn[:, band].mean()
            pooled = 20 * (channel["value"] / 100 * mean) ** 2 / variance[band]
            low, high = stats.ncx2(20, course[band] / variance[band]).ppf([0.001 / 6, 1 - 0.001 / 6])
            assert low < pooled < high
            shot = 100 * np.sqrt(mean / (48000 / 16127) / 9) / mean
            assert channel["photon_noise_percent"] == pytest.approx(shot, rel=1e-3)
    slope, std = (result.stability.companions[f"trend_{k}percent_per_h"] for k in ("", "std_"))
    assert isinstance(slope, float) and isinstance(std, float)
    assert abs(slope - drift) < 4 * std
    assert result.stability.companions["warm_up_complete"] is True
    assert result.stability.sample_size == result.repeatability.sample_size == 21
    assert result.stability_series is not None
    brightest = result.stability_series.dn[:, 0].mean() / 16127
    assert brightest == pytest.approx(0.65, rel=0.01)  # PRNU of nine pixels 0.13 %, drift, lamp noise


def test_warm_up_is_noticed(tmp_path: Path) -> None:
    """Rationale: 8.2.2.1 c asks for 20 min; a lamp that was just switched on must not pass for an unstable camera.

    Expected: the number comes out, greater than the camera's own; the record says that the warm-up is not complete, and the
    data that the first third is unlike the rest.
    """
    result, _ = through_files(tmp_path, config(wait_s=0.0))
    found = result.stability
    assert found.value is not None and found.value > 0.7
    assert found.companions["since_lamp_on_s"] == 0.0
    assert found.companions["warm_up_complete"] is False
    assert found.companions["settled"] is False
    assert found.companions["trend_significant"] is True
    assert result.repeatability.companions["warm_up_complete"] is True
