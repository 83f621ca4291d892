"""One word for one thing, full-width punctuation and Chinese names in what the evaluator shows (docs/nomenclature.md)."""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

import evaluator
from evaluator.documents.model import Figure
from evaluator.documents.phrase_table import PHRASES
from evaluator.documents.phrases import translated
from evaluator.report.plot_texts import PLOT_TABLE
from evaluator.report.sections import companions, number
from evaluator.report.term_table import NAMES
from evaluator.report.texts import TABLE, Texts
from evaluator.report.words import HOW
from evaluator.view.words import words

_HAN = "[\u4e00-\u9fff]"
_DISCARDED = re.compile(
    "参考板|标准板|靶板|(?<!标准)反射靶标|(?<!梯形)棱台靶标|黑白靶标|界限|一致性类别|重采样|"
    "像元(?!尺寸)|(?<=[0-9}一每首]) ?幅|时间同步|(?<!系)估值|暗电平|调焦"
)
_HALF_WIDTH = re.compile(f"{_HAN} ?[,;:!?]|[,;:!?] ?{_HAN}|\\({_HAN}|{_HAN}\\)")
_SOURCES = ("report", "view", "documents")


def _chinese_texts() -> Iterator[tuple[str, str]]:
    """Every Chinese text of the tables, with where it stands."""
    for key, pair in (TABLE | PLOT_TABLE | NAMES).items():
        yield key, pair[0]
    for key, how in HOW.items():
        yield key, how.words[0]
        yield key, how.data[0]
    yield from words("zh").items()
    for line in PHRASES.splitlines():
        if " => " in line:
            yield line, line.split(" => ")[1]


def test_discarded_words_do_not_occur() -> None:
    """Rationale: a reader who meets two words looks for two things. Expected: no source of report, 3D page and documents holds a
    word that the nomenclature discards; 漫反射参考标准板 is the instrument of 5.3. Tolerance: none."""
    root = Path(evaluator.__file__).parent
    found = [
        f"{path.name}: {hit.group()} in …{text[max(0, hit.start() - 20) : hit.end() + 10]}…"
        for folder in _SOURCES
        for path in sorted((root / folder).iterdir())
        if path.suffix in (".py", ".j2", ".js", ".typ")
        for text in [path.read_text("utf-8").replace("漫反射参考标准板", "")]
        for hit in _DISCARDED.finditer(text)
    ]
    assert not found


def test_chinese_texts_have_full_width_punctuation() -> None:
    """Rationale: GB/T 15834 sets full-width marks in Chinese text. Expected: no comma, colon, semicolon or bracket of half width
    touches a Chinese character in any table of texts. Tolerance: formulas and numbers, which have none beside them."""
    wrong = [f"{key}: {text}" for key, text in _chinese_texts() if _HALF_WIDTH.search(text)]
    assert not wrong


# Every companion that a campaign brings: quickstart (flight, benches, ranging line), mounting_boards, and what the modules add in
# the cases that those do not meet (a value on too few panels, corners left out, files misread).
_COMPANIONS = {
    "8.1": "leave_one_panel_out with_cos_incidence with_cos_incidence_leave_one_panel_out mean_difference wavelength_nm "
    "design_heights_m observations returns_used panels surfaces value_on_what_is_there",
    "8.2": "worst_channel sd_dn mean_dn channels value trend_percent_per_h photon_noise_percent photon_noise_share "
    "trend_std_percent_per_h trend_p_value trend_significant first_third_percent first_third_std_percent settled since_lamp_on_s "
    "warm_up_complete camera_temperature_c one_setting images_used linear_pixels left_out duration_s saturated_share "
    "black_level_dn black_level_source red green blue grey",
    "8.3": "band bands reflectance_correlation reflectance_rmse_relative camera_rmse camera_leave_one_panel_out "
    "lidar_leave_one_panel_out images uneven_panels empirical_line offset_percent gains values",
    "9.1": "additive_constant_m additive_constant_std_m multiplication_constant multiplication_constant_std correlation "
    "unweighted_constants rmse_m mean_range_m rmse_before_m relative_rmse_before_percent expected_rmse_m "
    "leave_one_panel_out_rmse_m leave_one_panel_out_percent chi_square chi_square_freedom chi_square_p residuals "
    "lidar_scatter_over_fit reading_std_m correction reference stations not_used scans scan_duration_s notes same_scans beside "
    "panel share misread",
    "9.2": "parameters parameter_units estimates std std_by_image strong_correlations not_determined prior_std sigma0_px rms_px "
    "max_px corner_std_px unexplained_px redundancy iterations held_out_px per_image positions_by distances_m images_by_position "
    "coverage_cells coverage_counts coverage_by_position coverage tilt_deg board inner_columns inner_rows square_m image_size_px "
    "radial_distortion_at_corner_px focus_distance_m f_number rejected rejected_corners with_rejected_corners_px boards_found",
    "9.3": "per_sortie_px all_strips_px held_out_folds held_out_per_target_px per_target_px marks vertices rms_u_px rms_v_px "
    "single_instant p_m_px roll_pitch_yaw_deg translation_m reason interior_orientation ranges",
}


@pytest.mark.parametrize("clause", _COMPANIONS)
def test_every_companion_has_a_chinese_name(clause: str) -> None:
    """Rationale: "related values" in code names are no use to a Chinese reader. Expected: every companion key of the clause has a
    name in both languages, the Chinese one with a Chinese character or a symbol of the standard. Tolerance: K₂, R₂, P_m, χ², SD."""
    for key in _COMPANIONS[clause].split():
        zh, en = NAMES[key]
        assert re.search(_HAN, zh) or re.match(r"K₂|R₂|P_m|χ²|SD", zh), key
        assert "_" not in en.replace("P_m", "").replace("m_j", ""), key


def _keys(value: Any) -> Iterator[str]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield key
            yield from _keys(inner)


def test_a_flown_campaign_brings_no_other_companion(tiny_run: Path) -> None:
    """Rationale: the list above is only as good as its agreement with what is written. Expected: every key among the companions of
    a campaign flown and evaluated here has a name. Tolerance: ids of targets, numbers of sorties."""
    results = json.loads((tiny_run / "results" / "results.json").read_text("utf-8"))
    found = {key for block in results["indicators"].values() for key in _keys(block["companions"])}
    named = {key for key in found if not re.fullmatch(r"[A-Z]+\d+|\d+", key)}
    assert len(named) > 30
    assert named <= NAMES.keys()


def test_numbers_below_rounding_are_zero_without_a_sign() -> None:
    """Rationale: the mean difference of an in-sample fit is zero and came out as -1.4522e-14, a sum's rounding. Expected: 0 below
    1e-10, which no unit here resolves, and no minus before a zero; R2 of 8.8e-6 keeps its digits. Tolerance: none."""
    t = Texts("zh")
    assert number(-1.45e-14, t) == "0"
    assert number(8.77363941945e-06, t) == "8.7736e-06"
    assert Figure(value=-1e-9, decimals=3).text == "0.000"
    assert Figure(value=-0.0015, decimals=3).text == "−0.002"


def test_values_of_companions_are_translated() -> None:
    """Rationale: names in Chinese beside values in English are half a translation. Expected: band, source of the lens and blunder
    in Chinese, with a Chinese comma in lists; English stays as it is. Tolerance: none."""
    given = {
        "band": "red",
        "interior_orientation": "calibration of 9.2 of this campaign",
        "rejected": ["mark of F08 in a.tif (sortie 2)", "mark of F09 in a.tif (sortie 2)"],
    }
    zh, en = companions(given, Texts("zh")), companions(given, Texts("en"))
    assert dict(zh)["波段"] == "红"
    assert dict(zh)["内方位元素来源"] == "本次检测 9.2 的标定结果"
    assert dict(zh)["剔除"] == "第 2 架次影像 a.tif 中靶标 F08 的标识、第 2 架次影像 a.tif 中靶标 F09 的标识"
    assert dict(en)["left out as blunders"] == "mark of F08 in a.tif (sortie 2), mark of F09 in a.tif (sortie 2)"
    assert translated("as measured", "en") == "as measured"
