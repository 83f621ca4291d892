"""Formulas (7) and (8), the empirical line and both indicators of 8.3."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from campaign.config import Band
from evaluator.c8_1_lidar_reflectance import PanelReflectances, reflectance_at
from evaluator.c8_3_reflectance_consistency import (
    band_reflectance,
    camera_reflectances,
    choose_band,
    empirical_line,
    evaluate_reflectance_consistency,
    reflectance_correlation,
    reflectance_rmse_relative,
)
from evaluator.model import CampaignData, EvaluationError
from evaluator.observe.panels import ImagePanelObservation

# Levels at least 0.5 % apart on a raster: formula (7) is then well conditioned.
LEVELS = st.lists(st.integers(0, 200), min_size=3, max_size=30, unique=True).map(lambda v: np.array(v) * 0.5)


@given(LEVELS, st.floats(0.1, 10.0), st.floats(-50.0, 50.0))
def test_correlation_laws(r1: np.ndarray, gain: float, offset: float) -> None:
    """Rationale: laws for all inputs. Expected: 1 against a rising line, -1 against a falling one, symmetric. Tolerance: the
    rounding of sums."""
    assert reflectance_correlation(r1, gain * r1 + offset) == pytest.approx(1.0, abs=1e-9)
    assert reflectance_correlation(r1, -gain * r1 + offset) == pytest.approx(-1.0, abs=1e-9)
    other = np.sin(r1) + 0.1 * r1
    assert reflectance_correlation(r1, other) == pytest.approx(reflectance_correlation(other, r1), abs=1e-12)


def test_formulas_by_hand() -> None:
    """Rationale: three panels on paper. R1 = 1, 2, 3 and R2 = 1, 3, 2: deviations -1 0 1 and -1 1 0, products 1, squares 2 and
    2. Expected: r_f = 1/2; squares of the differences 0 1 1, M_f = sqrt(2 / (2 * 2)). Tolerance: rounding."""
    assert reflectance_correlation([1.0, 2.0, 3.0], [1.0, 3.0, 2.0]) == pytest.approx(0.5, rel=1e-14)
    assert reflectance_rmse_relative([1.0, 2.0, 3.0], [1.0, 3.0, 2.0]) == pytest.approx(np.sqrt(0.5), rel=1e-14)


@pytest.mark.parametrize("formula", [reflectance_correlation, reflectance_rmse_relative])
@pytest.mark.parametrize(
    ("r1", "r2", "word"),
    [([1.0], [1.0], "too few"), ([1.0, 2.0], [1.0, 2.0, 3.0], "differ"), ([1.0, 2.0], [np.inf, 2.0], "index 0")],
)
def test_formulas_refuse(formula: object, r1: list[float], r2: list[float], word: str) -> None:
    """Rationale: a bad list must not become a number. Expected: one line that names the fault."""
    with pytest.raises(EvaluationError, match=word):
        formula(r1, r2)  # type: ignore[operator]


def test_correlation_of_equal_panels_is_refused() -> None:
    """Rationale: 0/0. Expected: an error, not NaN."""
    with pytest.raises(EvaluationError, match="all reflectances of one sensor are equal"):
        reflectance_correlation([0.1, 0.1, 0.1], [0.1, 0.2, 0.3])


def test_empirical_line_finds_gains_and_offset() -> None:
    """Rationale: the model's own class. Expected: gains 0.01 and 0.012 % per DN of two images and the shared offset -1.5 %.
    Tolerance: rounding."""
    dn = np.array([500.0, 2000.0, 9000.0, 400.0, 1700.0, 7500.0])
    image = np.array([0, 0, 0, 1, 1, 1])
    line = empirical_line(dn, np.array([0.01, 0.012])[image] * dn - 1.5, image)
    assert line.gain == pytest.approx([0.01, 0.012], rel=1e-10)
    assert line.offset_percent == pytest.approx(-1.5, rel=1e-9)


@pytest.mark.parametrize(
    ("dn", "reflectance", "image", "word"),
    [
        ([1.0], [1.0], None, "too few"),
        ([5.0, 5.0, 5.0], [1.0, 2.0, 3.0], None, "do not vary"),
        ([1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [0, 1], "do not match"),
    ],
)
def test_empirical_line_refuses(dn: list[float], reflectance: list[float], image: object, word: str) -> None:
    """Rationale: a line through one point is no line. Expected: one line that names the fault."""
    with pytest.raises(EvaluationError, match=word):
        empirical_line(dn, reflectance, image)


def test_band_average(campaign_data: CampaignData) -> None:
    """Rationale: a spectrum with a straight slope averages to its value at the centre of a symmetric band. Expected: the value
    at 650 nm. Tolerance: 1e-4 %, the band's tails cut at 3 FWHM."""
    spectra = campaign_data.spectra
    assert spectra is not None
    band = Band(name="red", centre_nm=650.0, fwhm_nm=40.0)
    assert band_reflectance(spectra, "P05", band) == pytest.approx(reflectance_at(spectra, "P05", 650.0), abs=1e-4)
    bent = replace(spectra, reflectance=((spectra.wavelength_nm - 650.0) ** 2 / 1e4)[:, None] * np.ones((1, 20)))
    # Second moment of a Gaussian: (40 / 2.3548)^2 nm^2 = 288.5; the 10 nm polygon adds h^2 / 6 = 16.7.
    assert band_reflectance(bent, "P05", band) == pytest.approx(100.0 * (288.5 + 16.7) / 1e4, rel=0.01)


def test_band_choice() -> None:
    """Rationale: the indicator must say which band it is of. Expected: named, else red, else the first; unknown refused."""
    bands = tuple(Band(name=n, centre_nm=c, fwhm_nm=30.0) for n, c in (("green", 550.0), ("red", 650.0)))
    assert choose_band(bands) == 1
    assert choose_band(bands, "green") == 0
    assert choose_band(bands[:1]) == 0
    with pytest.raises(EvaluationError, match="green, red"):
        choose_band(bands, "swir")


def images_of(data: CampaignData, noise_dn: float = 0.0) -> list[ImagePanelObservation]:
    """DN = 90 to 110 DN per percent plus 150 DN of path radiance; eight images of changing light, three bands."""
    rng = np.random.default_rng(np.random.SeedSequence([83, 1]))
    assert data.spectra is not None and data.camera is not None
    found = []
    for k, gain in enumerate(np.linspace(90.0, 110.0, 8)):
        for panel in data.spectra.panel_ids:
            levels = np.array([band_reflectance(data.spectra, panel, b) for b in data.camera.bands])
            dn = gain * levels + 150.0 + noise_dn * rng.normal(size=3)
            found.append(
                ImagePanelObservation(
                    panel=panel,
                    sortie=1 + k // 4,
                    strip=1 + k % 4,
                    image=f"{k:03d}.tif",
                    mean_dn=tuple(dn),
                    std_dn=(4.0, 4.0, 4.0),
                    clipped_share=(0.0, 0.0, 0.0),
                    pixels=900,
                    uneven=False,
                    region_px=np.zeros((4, 2)),
                )
            )
    return found


def lidar_values(data: CampaignData, error: np.ndarray) -> PanelReflectances:
    assert data.spectra is not None
    ids = data.spectra.panel_ids
    reference = np.array([reflectance_at(data.spectra, p, 1550.0) for p in ids])
    return PanelReflectances(
        panels=ids,
        reference_percent=reference,
        measured_percent=reference + error,
        held_out_percent=reference + 1.2 * error,
        spread_percent=np.zeros(20),
        observations=np.full(20, 8),
    )


def test_camera_follows_the_light(campaign_data: CampaignData) -> None:
    """Rationale: a gain for each image takes up changing light. Expected: reflectance of the band, in-sample and held-out,
    for light that changes by 20 %. Tolerance: 0.03 %: the model has R = (DN - 150) / gain, so its offset differs a little
    from image to image (150/90 against 150/110 %) and one shared offset leaves the rest."""
    data = campaign_data
    assert data.spectra is not None and data.camera is not None
    reference = {p: band_reflectance(data.spectra, p, data.camera.bands[2]) for p in data.spectra.panel_ids}
    values = camera_reflectances(images_of(data), reference, 2)
    assert values.measured_percent == pytest.approx(values.reference_percent, abs=0.03)
    assert values.held_out_percent == pytest.approx(values.reference_percent, abs=0.05)


def test_indicators(campaign_data: CampaignData) -> None:
    """Rationale: with a perfect camera both figures follow from the LiDAR's errors. Expected: M_f = sqrt(sum d^2 / 38) with d
    the LiDAR's error plus the slope of the spectra from 650 to 1550 nm; r_f of the two lists. Tolerance: 0.03 % of
    reflectance, as above."""
    data = campaign_data
    assert data.spectra is not None and data.camera is not None
    error = np.random.default_rng(np.random.SeedSequence([83, 2])).normal(0.0, 1.5, 20)
    lidar = lidar_values(data, error)
    r_f, m_f, camera = evaluate_reflectance_consistency(lidar, images_of(data), data.targets, data.spectra, data.camera)
    red = np.array([band_reflectance(data.spectra, p, data.camera.bands[2]) for p in data.spectra.panel_ids])
    difference = lidar.measured_percent - red
    assert m_f.value == pytest.approx(float(np.sqrt((difference**2).sum() / 38.0)), abs=0.03)
    assert r_f.value == pytest.approx(100.0 * float(np.corrcoef(lidar.measured_percent, red)[0, 1]), abs=0.01)
    assert camera is not None
    for value in (r_f, m_f):
        assert value.value is not None and value.low_95 is not None and value.high_95 is not None
        assert value.low_95 < value.value < value.high_95
        assert value.companions["band"] == "red"
        assert set(value.companions["bands"]) == {"blue", "green", "red"}  # type: ignore[call-overload]
        assert value.sample_size == 20
    worse = m_f.companions["leave_one_panel_out"]
    assert isinstance(worse, float) and worse > m_f.value


def test_clipped_uneven_and_lonely_values_are_left_out(campaign_data: CampaignData) -> None:
    """Rationale: a clipped or shaded panel must not bend the line. Expected: the very values without them; a panel that is
    uneven everywhere stays (and is listed). Tolerance: 0.05 %: fewer images weigh."""
    data = campaign_data
    assert data.spectra is not None and data.camera is not None
    reference = {p: band_reflectance(data.spectra, p, data.camera.bands[2]) for p in data.spectra.panel_ids}
    images = images_of(data)
    spoilt = [
        replace(o, mean_dn=(1.0, 1.0, 1.0), uneven=True)
        if (o.panel, o.image) == ("P05", "002.tif")
        else replace(o, mean_dn=(9.0, 9.0, 9.0), clipped_share=(0.5, 0.5, 0.5))
        if (o.panel, o.image) == ("P10", "003.tif")
        else o
        for o in images
    ]
    spoilt += [replace(images[0], image="lonely.tif", mean_dn=(5e4, 5e4, 5e4))]
    values = camera_reflectances(spoilt, reference, 2)
    assert values.measured_percent == pytest.approx(values.reference_percent, abs=0.05)
    everywhere = [replace(o, uneven=True) if o.panel == "P05" else o for o in images]
    assert "P05" in camera_reflectances(everywhere, reference, 2).panels


def test_not_measured_says_why(campaign_data: CampaignData) -> None:
    """Rationale: each missing part has its own reason. Expected: no value and that reason."""
    data, lidar = campaign_data, lidar_values(campaign_data, np.zeros(20))
    images = images_of(data)
    cases = [
        ((None, images, data.targets, data.spectra, data.camera), "LiDAR's reflectance is not measured"),
        ((lidar, images, data.targets, data.spectra, None), "sensors/camera.json is missing"),
        ((lidar, images, data.targets, None, data.camera), "survey/spectra.csv is missing"),
        ((lidar, [], data.targets, data.spectra, data.camera), "no panel has a usable value"),
        (
            (lidar, [o for o in images if o.panel != "P04"], data.targets, data.spectra, data.camera),
            "19 panels measured, at least 20 are needed; not found: P04",
        ),
    ]
    for arguments, reason in cases:
        r_f, m_f, _ = evaluate_reflectance_consistency(*arguments)
        assert r_f.value is None and m_f.value is None
        assert r_f.reason is not None and reason in r_f.reason
