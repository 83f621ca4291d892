"""8.2: stability and repeatability by hand, and what becomes of series that a laboratory spoils."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from campaign.benches.bench import SphereExposure, write_sphere_log
from campaign.config import Band
from campaign.flight.images import BLACK_LEVEL
from campaign.folder import CampaignFolder
from campaign.manifest import Manifest, write_manifest
from campaign.sensors import CameraSheet, write_sheet
from evaluator.benches.bench_model import SphereResult
from evaluator.benches.series_trend import first_third, trend
from evaluator.c8_2_camera_radiometry import (
    evaluate_sphere,
    mean_dn,
    repeatability,
    stability_rsd,
    standard_deviation_dn,
)
from evaluator.load import load_campaign
from evaluator.model import EvaluationError

LEVELS = np.array([4000.0, 3000.0, 2000.0])  # red, green, blue above black
BLACK = 256


def sheet(**changes: object) -> CameraSheet:
    values: dict = {
        "name": "hand camera",
        "width_px": 40,
        "height_px": 30,
        "pixel_size_um": 4.5,
        "nominal_focal_length_mm": 13.5,
        "f_number": 4.0,
        "bit_depth": 14,
        "black_level_dn": float(BLACK),
        "bands": tuple(
            Band(name=n, centre_nm=c, fwhm_nm=70.0) for n, c in (("red", 620), ("green", 540), ("blue", 465))
        ),
        "calibration": None,
    }
    return CameraSheet(**(values | changes))


def frame(level: np.ndarray, size: tuple[int, int] = (30, 40)) -> np.ndarray:
    """A 16-bit image whose nine central pixels have the mean `level` above black, other pixels something else."""
    height, width = size
    image = np.full((height, width, 3), 9000, np.uint16)
    # Nine different offsets that sum to zero, so that the centre is not one flat value.
    offset = np.arange(-4, 5).reshape(3, 3, 1)
    image[height // 2 - 1 : height // 2 + 2, width // 2 - 1 : width // 2 + 2] = BLACK + np.round(level) + offset
    return image


def rows(count: int, interval_s: float, **columns: object) -> list[SphereExposure]:
    since = columns.pop("since_lamp_on_s", 1500.0)
    return [
        SphereExposure(
            image=f"s_{k + 1:03d}.tif",
            gps_time_s=1000.0 + interval_s * k,
            since_lamp_on_s=None if since is None else since + interval_s * k,
            **{"exposure_time_s": 0.005, "gain_e_per_dn": 3.0, "camera_temperature_c": 24.0 + 0.1 * k} | columns,
        )
        for k in range(count)
    ]


@pytest.fixture
def place(tmp_path: Path) -> CampaignFolder:
    """A folder that holds a manifest and nothing else."""
    root = tmp_path / "hand"
    root.mkdir()
    write_manifest(
        root,
        Manifest(
            campaign="hand",
            title="",
            synthetic=False,
            date="2026-06-12",
            start_time="2026-06-12T10:30:00+08:00",
            gps_week=2422,
            latitude_deg=31.283,
            longitude_deg=121.213,
            ellipsoid_height_m=18.0,
            height_anomaly_m=11.2,
            projection_epsg=4549,
            height_epsg=5737,
            software={},
            files=(),
        ),
    )
    return CampaignFolder(root)


def write_series(folder: Path, factors: np.ndarray, interval_s: float = 180.0, **columns: object) -> None:
    folder.mkdir(parents=True)
    log = rows(len(factors), interval_s, **columns)
    for row, factor in zip(log, factors, strict=True):
        tifffile.imwrite(folder / row.image, frame(LEVELS * factor), photometric="rgb")
    write_sphere_log(folder / "log.csv", log)


def evaluated(place: CampaignFolder) -> SphereResult:
    return evaluate_sphere(load_campaign(place.root))


STEADY = 1 + 0.005 * np.array([0, 1, -1, 2, -2, 1, -1])  # SD of 0.01 / sqrt(2) about the mean 1


def test_formulas_by_hand() -> None:
    """Rationale: (3)-(6) as printed, n - 1 in the denominator.

    Expected: 98, 100, 102 DN: mean 100, SD sqrt((4 + 0 + 4)/2) = 2, RSD = s(x) = 2 %; scaling by 50 leaves percent alone.
    Tolerance: rounding.
    """
    dn = [98.0, 100.0, 102.0]
    assert mean_dn(dn) == pytest.approx(100.0, rel=1e-14)
    assert standard_deviation_dn(dn) == pytest.approx(2.0, rel=1e-14)
    assert stability_rsd(dn) == pytest.approx(2.0, rel=1e-14)
    assert repeatability(np.array(dn) * 50) == pytest.approx(2.0, rel=1e-14)
    assert standard_deviation_dn(np.array(dn) * 50) == pytest.approx(100.0, rel=1e-14)


@pytest.mark.parametrize("formula", [mean_dn, standard_deviation_dn, stability_rsd, repeatability])
@pytest.mark.parametrize("bad", [[], [1.0], [[1.0, 2.0]], [1.0, np.nan], [1.0, np.inf], "abc"])
def test_formulas_refuse_what_is_no_series(formula: Callable[[object], float], bad: object) -> None:
    """Expected: one line, no number."""
    with pytest.raises(EvaluationError, match="formula"):
        formula(bad)


@pytest.mark.parametrize("dn", [[0.0, 0.0, 0.0], [-1.0, -2.0]])
def test_relative_to_nothing(dn: list[float]) -> None:
    """Expected: a series that does not rise above the black level has no RSD and no s(x)."""
    for formula in (stability_rsd, repeatability):
        with pytest.raises(EvaluationError, match="black level"):
            formula(dn)


def test_trend_of_a_line() -> None:
    """Rationale: a line of 2 % an hour about its mean, and one disturbance that is orthogonal to line and constant.

    Expected: slope 2 %/h; with residuals (1, -2, 1) * 0.1 % the variance is 0.06 %^2 over 1 degree of freedom, and of the
    slope that over sum(t^2) = 0.5 h^2: std = sqrt(0.06 / 0.5) = 0.34641 %/h; t = 5.7735, p = 1 - 2 atan(t) / pi = 0.10918.
    Tolerance: rounding.
    """
    t = np.array([0.0, 1800.0, 3600.0])
    dn = 1000 * (1 + 0.01 * np.array([-1.0, 0.0, 1.0]) + 0.001 * np.array([1.0, -2.0, 1.0]))
    found = trend(t, dn)
    assert found is not None
    assert found.percent_per_h == pytest.approx(2.0, rel=1e-10)
    assert found.std_percent_per_h == pytest.approx(np.sqrt(0.06 / 0.5), rel=1e-9)
    assert found.p_value == pytest.approx(1 - 2 * np.arctan(2.0 / np.sqrt(0.12)) / np.pi, rel=1e-9)
    assert trend(t[:2], dn[:2]) is None


def test_first_third_against_the_rest() -> None:
    """Rationale: nine images, the last six on a line with residuals of +-0.1 %, the first three 1 % above that line.

    Expected: 1 % above; residuals (1, -1, -1, 1) would be orthogonal to a line of four: with six, (1, -1, 0, 0, -1, 1) is, so
    sum of squares 0.04 %^2 over 4 degrees, s = 0.1 %; the three stand 4.5 steps ahead of the six' middle, sum t^2 = 17.5:
    std = 0.1 sqrt(1/3 + 1/6 + 4.5^2 / 17.5) = 0.12869 %. Eight images give nothing.
    Tolerance: 1e-4: percent of the six' mean.
    """
    t = 180.0 * np.arange(9)
    dn = 1000.0 + 0.0 * t
    dn[:3] *= 1.01
    dn[3:] *= 1 + 0.001 * np.array([1, -1, 0, 0, -1, 1])
    found = first_third(t, dn)
    assert found is not None
    assert found[:2] == pytest.approx((1.0, 0.1 * np.sqrt(0.5 + 4.5**2 / 17.5)), rel=1e-4)
    assert 0 < found[2] < 0.01
    assert first_third(t[:8], dn[:8]) is None


def test_worst_channel_counts(place: CampaignFolder) -> None:
    """Rationale: the standard speaks of one figure, a camera has three channels.

    Expected: green varies by 2 % where the others stand still: the indicator is green's, by hand: +-60 DN about 3000 in three
    images, SD 60, RSD 2 %; n = 3 gives std = value / 2 and, by the table, chi2(0.025; 2) = 0.0506, chi2(0.975; 2) = 7.378.
    Tolerance: the table's digits.
    """
    folder = place.sphere_stability
    folder.mkdir(parents=True)
    log = rows(3, 180.0)
    for row, green in zip(log, (2940.0, 3000.0, 3060.0), strict=True):
        tifffile.imwrite(folder / row.image, frame(np.array([4000.0, green, 2000.0])), photometric="rgb")
    write_sphere_log(folder / "log.csv", log)
    write_sheet(place.camera, sheet())
    result = evaluated(place)
    found = result.stability
    assert found.value == pytest.approx(2.0, rel=1e-12)
    assert found.companions["worst_channel"] == "green"
    assert found.companions["sd_dn"] == pytest.approx(60.0)
    assert found.companions["mean_dn"] == pytest.approx(3000.0)
    channels = found.companions["channels"]
    assert isinstance(channels, dict)
    assert channels["red"]["value"] == 0.0
    # Photon noise of nine pixels: 100 / sqrt(9 * 3 e/DN * 3000 DN) = 0.35136 %.
    assert channels["green"]["photon_noise_percent"] == pytest.approx(0.35136, rel=1e-4)
    assert channels["green"]["photon_noise_share"] == pytest.approx((0.35136 / 2.0) ** 2, rel=1e-3)
    assert found.std == pytest.approx(1.0)
    assert found.low_95 == pytest.approx(2.0 * np.sqrt(2 / 7.378), rel=1e-3)
    assert found.high_95 == pytest.approx(2.0 * np.sqrt(2 / 0.0506), rel=1e-3)
    assert found.sample_size == 3 and found.method and "chi-square" in found.method
    assert result.repeatability.value is None
    assert result.repeatability.reason == "no bench/sphere_repeatability in this campaign"
    assert result.stability_series is not None
    assert result.stability_series.dn == pytest.approx(np.array([[4000, g, 2000] for g in (2940, 3000, 3060)]))
    assert result.stability_series.time_s == pytest.approx([0.0, 180.0, 360.0])


def test_both_series(place: CampaignFolder) -> None:
    """Expected: each indicator from its own folder, with its own formula, and what the log says about lamp and camera."""
    write_series(place.sphere_stability, STEADY)
    write_series(place.sphere_repeatability, 1 + 2 * (STEADY - 1), 15.0, since_lamp_on_s=900.0)
    write_sheet(place.camera, sheet())
    seen: list[tuple[str, int, int]] = []
    result = evaluate_sphere(load_campaign(place.root), lambda *at: seen.append(at))
    # sum (0 1 1 2 2 1 1)^2 = 12 steps of 0.5 %: SD = 0.5 sqrt(12/6) %
    assert result.stability.value == pytest.approx(0.5 * np.sqrt(2.0), rel=1e-3)
    assert result.repeatability.value == pytest.approx(np.sqrt(2.0), rel=1e-3)
    assert (result.stability.formula, result.repeatability.formula) == ("(3)-(5)", "(6)")
    assert result.stability.companions["warm_up_complete"] is True
    assert result.repeatability.companions["warm_up_complete"] is False
    assert result.repeatability.companions["since_lamp_on_s"] == 900.0
    assert result.stability.companions["camera_temperature_c"] == [24.0, 24.6]
    assert result.stability.companions["images_used"] == 7
    assert seen[-1] == ("sphere", 14, 14) and len(seen) == 15


def test_black_level_comes_from_the_sheet_the_tag_or_is_named_as_missing(place: CampaignFolder) -> None:
    """Rationale: RSD relative to DN that still hold the black level is too small.

    Expected: sheet before tag before zero; SD in DN is the same, the mean differs by the black level.
    Tolerance: rounding.
    """
    folder = place.sphere_stability

    def blue() -> tuple[float, float, float, object]:
        """Mean, SD [DN] and RSD of the weakest channel, and where its black level comes from."""
        found = evaluated(place).stability.companions
        channels = found["channels"]
        assert isinstance(channels, dict)
        of_blue = channels["blue"]
        return of_blue["mean_dn"], of_blue["sd_dn"], of_blue["value"], found["black_level_source"]

    write_series(folder, STEADY)
    without = blue()
    assert without[0] == pytest.approx(2000.0 + BLACK, rel=1e-6)
    assert "none recorded" in str(without[3])
    for path in folder.glob("*.tif"):
        tag = (BLACK_LEVEL, "I", 3, (200, 200, 200), True)
        tifffile.imwrite(path, tifffile.imread(path), photometric="rgb", extratags=[tag])
    tagged = blue()
    assert tagged[0] == pytest.approx(2000.0 + BLACK - 200, rel=1e-6)
    assert tagged[3] == "the images' BlackLevel tag"
    write_sheet(place.camera, sheet())
    stated = blue()
    assert stated[0] == pytest.approx(2000.0, rel=1e-6)
    assert stated[3] == "sensors/camera.json"
    assert stated[1] == tagged[1] == without[1]
    assert stated[2] == pytest.approx(without[2] * (2000.0 + BLACK) / 2000.0, rel=1e-6)


def test_eight_bit_pictures(place: CampaignFolder) -> None:
    """Rationale: a laboratory may hand in PNG; the sheet's black level of 14 bit means nothing there, nor does the log's gain.

    Expected: grey PNG, levels 100 +- 2: RSD 2 %, black level 0, and the channel is called grey; no photon noise, not linear. With a
    sheet of 8 bit the DN are the camera's own: linear, and the photon noise of gain 3 stands there.
    """
    folder = place.sphere_stability
    folder.mkdir(parents=True)
    log = [SphereExposure(image=f"s_{k}.png", gps_time_s=180.0 * k, gain_e_per_dn=3.0) for k in range(3)]
    for row, level in zip(log, (98, 100, 102), strict=True):
        assert cv2.imwrite(str(folder / row.image), np.full((30, 41), level, np.uint8))
    write_sphere_log(folder / "log.csv", log)
    write_sheet(place.camera, sheet())
    found = evaluated(place).stability
    assert found.value == pytest.approx(2.0, rel=1e-12)
    assert found.companions["worst_channel"] == "grey"
    assert found.companions["warm_up_complete"] is None
    assert found.companions["linear_pixels"] is False
    for row in log:
        gray = cv2.imread(str(folder / row.image), cv2.IMREAD_GRAYSCALE)
        assert cv2.imwrite(str(folder / row.image.replace("png", "jpg")), gray)
    write_sphere_log(folder / "log.csv", [SphereExposure(image=f"s_{k}.jpg", gps_time_s=180.0 * k) for k in range(3)])
    coded = evaluated(place).stability
    assert coded.value == pytest.approx(2.0, rel=1e-12) and coded.companions["linear_pixels"] is False
    channels = found.companions["channels"]
    assert isinstance(channels, dict) and channels["grey"]["photon_noise_percent"] is None
    assert channels["grey"]["photon_noise_share"] is None
    write_sphere_log(folder / "log.csv", log)
    write_sheet(place.camera, sheet(bit_depth=8, black_level_dn=0.0))
    own = evaluated(place).stability.companions
    assert own["linear_pixels"] is True
    assert own["channels"]["grey"]["photon_noise_percent"] == pytest.approx(100 / np.sqrt(2700.0))  # type: ignore[index]


def test_lamp_off(place: CampaignFolder) -> None:
    """Rationale: a few DN above the black level are a closed shutter, and their RSD means nothing. Expected: at 163 DN above black
    (below 1 % of 14 bit, 163.83) no figure, at 165 one; without a sheet the limit is 10.23, since the depth may be 10 bit."""
    write_sheet(place.camera, sheet())
    place.sphere_stability.mkdir(parents=True)
    log = rows(3, 180.0)
    write_sphere_log(place.sphere_stability / "log.csv", log)

    def reason(level: float) -> str | None:
        for k, row in enumerate(log):
            path = place.sphere_stability / row.image
            tifffile.imwrite(path, frame(np.array([level, 4000.0 + k, 4000.0 + k])), photometric="rgb")
        return evaluated(place).stability.reason

    assert "red is hardly above the black level: is the lamp on? got 163 DN" in str(reason(163.0))
    assert reason(165.0) is None
    place.camera.unlink()
    assert "expected at least 10.2 DN" in str(reason(10.0 - BLACK)) and reason(12.0 - BLACK) is None


def test_one_picture_copied(place: CampaignFolder) -> None:
    """Rationale: the same file seven times is an RSD of 0 %. Expected: refused with the reason; with one image that differs by 1 DN
    in one pixel a figure."""
    write_series(place.sphere_stability, np.ones(7))
    write_sheet(place.camera, sheet())
    found = evaluated(place).stability
    assert found.value is None and "the same in all 7 images" in str(found.reason)
    path = place.sphere_stability / "s_004.tif"
    dn = tifffile.imread(path)
    dn[15, 20, 1] += 1
    spoil(path, dn)
    assert evaluated(place).stability.value is not None


def test_pixels_beyond_the_sheets_depth(place: CampaignFolder) -> None:
    """Rationale: a converter that scales 14 bit to 16 makes black level and gain wrong; "saturated" would send people to the lamp.
    Expected: the reason names the sheet's depth and asks for scaling."""
    write_series(place.sphere_stability, 5.0 * STEADY)
    write_sheet(place.camera, sheet(bit_depth=12))
    found = evaluated(place).stability
    text = "the pixels go beyond sensors/camera.json's 12 bit: scaled on export?"
    assert found.value is None and text in str(found.reason) and "saturated" not in str(found.reason)


def test_links_out_of_the_folder_are_not_followed(place: CampaignFolder, tmp_path: Path) -> None:
    """Rationale: with --keep-going a hostile campaign's links were named and read all the same. Expected: an image behind one is
    left out with that reason, though it is a sound picture; a whole series behind one has no figure."""
    write_series(place.sphere_stability, STEADY)
    inside = place.sphere_stability / "s_001.tif"
    outside = tmp_path / "outside.tif"
    inside.rename(outside)
    inside.symlink_to(outside)
    found = evaluated(place).stability
    assert found.sample_size == 6
    line = found.companions["left_out"][0]  # type: ignore[index]
    assert line.startswith("s_001.tif: ") and "a link leads out of the campaign folder" in line
    place.sphere_stability.rename(tmp_path / "series")
    place.sphere_stability.symlink_to(tmp_path / "series")
    gone = evaluated(place).stability
    assert gone.value is None and "a link leads out of the campaign folder" in str(gone.reason)


@pytest.mark.parametrize("layout", ["contig", "separate", "lzw", "big"])
def test_only_the_centre_is_used_whatever_the_file(place: CampaignFolder, layout: str) -> None:
    """Expected: bands apart, compressed or big-endian files give the same nine pixels as a plain one."""
    folder = place.sphere_stability
    write_series(folder, STEADY)
    write_sheet(place.camera, sheet())
    plain = evaluated(place).stability_series
    for path in folder.glob("*.tif"):
        dn = tifffile.imread(path)
        if layout == "separate":
            tifffile.imwrite(path, np.moveaxis(dn, 2, 0), photometric="rgb", planarconfig="separate")
        elif layout == "big":
            tifffile.imwrite(path, dn, photometric="rgb", byteorder=">")
        else:
            tifffile.imwrite(
                path, dn, photometric="rgb", rowsperstrip=7, compression="deflate" if layout == "lzw" else None
            )
    again = evaluated(place).stability_series
    assert plain is not None and again is not None
    assert np.array_equal(plain.dn, again.dn)
    assert again.dn[0] == pytest.approx(LEVELS)


def spoil(path: Path, image: np.ndarray | None) -> None:
    if image is None:
        path.unlink()
    else:
        tifffile.imwrite(path, image, photometric="rgb")


def saturated() -> np.ndarray:
    image = frame(LEVELS)
    image[15, 20, 0] = 2**14 - 1
    return image


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda p: p.unlink(), "no such file"),
        (lambda p: p.write_bytes(b"II*\0\xff\xff\xff\xff"), "TIFF"),
        (lambda p: p.write_bytes(b"nothing"), "no picture"),
        (lambda p: spoil(p, saturated()), "saturated"),
        (lambda p: p.write_bytes(p.read_bytes()[:2000]), "truncated"),
    ],
)
def test_one_bad_image_is_left_out_and_named(
    place: CampaignFolder, damage: Callable[[Path], object], told: str
) -> None:
    """Expected: the series stands without it; its name and the reason are in the companions, without the folder's path."""
    write_series(place.sphere_stability, STEADY)
    write_sheet(place.camera, sheet())
    damage(place.sphere_stability / "s_003.tif")
    result = evaluated(place)
    assert result.stability.sample_size == 6
    left_out = result.stability.companions["left_out"]
    assert isinstance(left_out, list) and len(left_out) == 1
    assert left_out[0].startswith("s_003.tif") and told in left_out[0]
    assert str(place.root) not in left_out[0]
    series = result.stability_series
    assert series is not None and "s_003.tif" not in series.images and series.left_out == tuple(left_out)


def test_saturated_series(place: CampaignFolder) -> None:
    """Expected: no value where most images are saturated; the share of the nine pixels is stated."""
    write_series(place.sphere_stability, STEADY)
    write_sheet(place.camera, sheet())
    for k in range(1, 5):
        spoil(place.sphere_stability / f"s_{k:03d}.tif", saturated())
    result = evaluated(place)
    found = result.stability
    assert found.value is None and found.reason is not None
    assert "saturated in 4 of 7 images" in found.reason
    assert found.companions["saturated_share"] == pytest.approx(1 / 9)
    # Conformity judges 8.2.2 d by the series, so it stays.
    assert result.stability_series is not None
    assert result.stability_series.saturated_share == pytest.approx(1 / 9)


def test_a_full_well_below_full_scale_is_saturation_too(place: CampaignFolder) -> None:
    """Rationale: nine equal pixels far up the scale have no noise: clipped before the converter. An RSD of 0 %
    would be graded best.

    Expected: no value.
    """
    write_series(place.sphere_stability, STEADY)
    write_sheet(place.camera, sheet())
    for path in place.sphere_stability.glob("*.tif"):
        spoil(path, np.full((30, 40, 3), 12000, np.uint16))
    found = evaluated(place).stability
    assert found.value is None and found.reason is not None and "saturated" in found.reason


def test_images_of_mixed_size(place: CampaignFolder) -> None:
    """Expected: no value; one odd image, both sizes and the usual one are named."""
    write_series(place.sphere_stability, STEADY)
    spoil(place.sphere_stability / "s_005.tif", frame(LEVELS, (30, 42)))
    found = evaluated(place).stability
    assert found.value is None and found.reason is not None
    for word in ("mixed size", "s_005.tif", "42 x 30", "40 x 30"):
        assert word in found.reason


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_images(place: CampaignFolder, count: int) -> None:
    """Expected: fewer than three give the reason with the count."""
    write_series(place.sphere_stability, STEADY[:count])
    found = evaluated(place).stability
    assert found.value is None and found.reason is not None
    assert "too few" in found.reason and f"got {count} of {count}" in found.reason


def test_no_log_and_a_broken_one(place: CampaignFolder) -> None:
    """Expected: the folder without its log, and a log that cannot be read, say so."""
    write_series(place.sphere_stability, STEADY)
    write_series(place.sphere_repeatability, STEADY, 15.0)
    (place.sphere_stability / "log.csv").unlink()
    (place.sphere_repeatability / "log.csv").write_text("image,gps_time_s\ns_001.tif,abc\n")
    result = evaluated(place)
    assert result.stability.value is None and "log.csv" in str(result.stability.reason)
    assert result.repeatability.value is None and "gps_time_s" in str(result.repeatability.reason)
    assert str(place.root) not in str(result.repeatability.reason)


def test_dark_images(place: CampaignFolder) -> None:
    """Expected: a channel at the black level has no relative figure; it is named."""
    write_series(place.sphere_stability, STEADY)
    write_sheet(place.camera, sheet())
    for path in place.sphere_stability.glob("*.tif"):
        dn = tifffile.imread(path)
        dn[..., 2] = BLACK
        spoil(path, dn)
    found = evaluated(place).stability
    assert found.value is None and "blue" in str(found.reason)


def test_change_of_setting_is_told(place: CampaignFolder) -> None:
    """Expected: 8.2.2 e repeats under one setting; a change of exposure stands in the companions, the photon noise does not."""
    write_series(place.sphere_stability, STEADY)
    log = rows(7, 180.0)
    changed = [SphereExposure(**{**row.__dict__, "gain_e_per_dn": 3.0 if k < 4 else 2.0}) for k, row in enumerate(log)]
    assert evaluated(place).stability.companions["one_setting"] is True
    write_sphere_log(place.sphere_stability / "log.csv", changed)
    found = evaluated(place).stability
    assert found.companions["one_setting"] is False
    channels = found.companions["channels"]
    assert isinstance(channels, dict) and channels["red"]["photon_noise_share"] is None
