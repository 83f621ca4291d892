"""The flight plan: sheet numbers against the standard's rule and published ones, all of 7.1 a to g, and plans that are wrong."""

import math
from dataclasses import replace
from itertools import product

import pytest

from evaluator.conformity import ConformityInputs, conformity_rows
from evaluator.documents.docx import docx_bytes
from evaluator.documents.flight_plan import build_flight_plan
from evaluator.documents.map_sheet import degrees_minutes_seconds, sheet_at, sheet_of
from evaluator.documents.model import LANGUAGES, Document, Figure, Language, Picture, Table, say
from evaluator.documents.pdf import pdf_bytes
from evaluator.model import CampaignData
from evaluator.results import Evaluation, build_results


def texts(document: Document) -> str:
    """All that the document says, cells and paragraphs."""
    out = []
    for block in document.blocks:
        if isinstance(block, Table):
            out += [c.text if isinstance(c, Figure) else c for row in block.rows for c in row]
            out.append(block.caption)
        elif not isinstance(block, Picture) and hasattr(block, "text"):
            out.append(block.text)
    return "\n".join(out)


@pytest.mark.parametrize(
    ("latitude", "longitude", "number"),
    [
        # Worked by hand from GB/T 13989-2012. 39°22'30" N, 114°33'45" E, the point of the standard's own example of the 1:100 000
        # sheet J50D002002: 3°22'30" above 36° are 81 rows of 2'30", so row 96 - 81 = 15; 33'45" east of 114° are 9
        # columns of 3'45", so column 10.
        (39.375, 114.5625, "J50G015010"),
        # Shanghai, 31.283 N, 121.213 E: 3.283° are 78.8 rows, 1.213° are 19.4 columns.
        (31.283, 121.213, "H51G018020"),
        (0.0, 0.0, "A31G096001"),
        (3.9999, 5.9999, "A31G001096"),
        (4.0, 6.0, "B32G096001"),
    ],
)
def test_sheet_numbers(latitude: float, longitude: float, number: str) -> None:
    """Rationale: 7.1 c names the sheet. Expected: as counted by hand, edges included. Tolerance: none."""
    sheet = sheet_at(latitude, longitude)
    assert sheet is not None
    assert sheet.number == number


def test_sheets_tile_the_country() -> None:
    """Rationale: every place lies on one sheet, whose number leads back to it. Expected: for a grid over the country the place is
    within its sheet's edges, the number read gives the same edges, and the next sheet north begins where this one
    ends. Tolerance: 1e-9 deg, 0.1 mm."""
    for latitude, longitude in product([18.1 + 3.37 * k for k in range(11)], [73.6 + 5.11 * k for k in range(12)]):
        sheet = sheet_at(latitude, longitude)
        assert sheet is not None
        assert sheet.south_deg - 1e-9 <= latitude <= sheet.north_deg + 1e-9
        assert sheet.west_deg - 1e-9 <= longitude <= sheet.east_deg + 1e-9
        again = sheet_of(sheet.number)
        assert again is not None
        assert math.isclose(again.south_deg, sheet.south_deg, abs_tol=1e-9)
        assert math.isclose(again.west_deg, sheet.west_deg, abs_tol=1e-9)
        above = sheet_at(sheet.north_deg + 1e-7, longitude)
        assert above is not None
        assert math.isclose(above.south_deg, sheet.north_deg, abs_tol=1e-9)


def test_no_sheet() -> None:
    """Rationale: a place beyond the numbering, or a text that is no number, must not become a wrong sheet. Expected: None."""
    assert sheet_at(-0.1, 121.0) is None
    assert sheet_at(60.0, 121.0) is None
    assert sheet_at(31.0, -121.0) is None
    for text in ("", "H51G000001", "H51G097001", "H51E018020", "H30G018020", "H51G0180200", "<b>"):
        assert sheet_of(text) is None


def test_degrees() -> None:
    """Rationale: seconds that round up must carry. Expected: 31°17′00.00″, not 31°16′60.00″."""
    assert degrees_minutes_seconds(31.283) == "31°16′58.80″"
    assert degrees_minutes_seconds(31.0 + 17.0 / 60.0 - 1e-9) == "31°17′00.00″"
    assert degrees_minutes_seconds(-0.5, 0) == "−0°30′00″"


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_to_g(campaign_data: CampaignData, evaluation: Evaluation, language: Language) -> None:
    """Rationale: 7.1 names seven things. Expected: each letter with what plan.json states, the sheet computed from the corners, and
    the plan's own sheet number named as wrong; corners in degrees with their sheets; every strip; H by formula (1):
    13.5 mm x 0.015 m / 0.0045 mm = 45.0 m; a sketch in both forms; the rows of 7 as they were flown."""
    document = build_flight_plan(campaign_data, build_results(evaluation), language)
    text = texts(document)
    for letter in "abcdefg":
        assert f"{letter}) " in text
    assert "hand copter" in text
    assert "31°16′58.80″" in text  # take-off point
    assert "H51G018020" in text
    assert say(language, "计划写为 H51G001001", "the plan states H51G001001") in text
    assert "42000.0 m²" in text
    assert say(language, "4.20 hm²", "4.20 ha") in text
    assert "2026-06-30" in text
    assert "clear sky" in text
    assert "45.0 m" in text
    strips = next(b for b in document.blocks if isinstance(b, Table) and say(language, "航线", "Strips") in b.caption)
    assert len(strips.rows) == 8
    drawn = next(b for b in document.blocks if isinstance(b, Picture))
    assert drawn.svg.startswith(b"<?xml")
    assert drawn.png.startswith(b"\x89PNG")
    flown = [r for r in build_results(evaluation)["conformity"] if r["clause"].startswith(("7.2", "7.3", "7.4"))]
    assert all(r["clause"] in text for r in flown)
    again = build_flight_plan(campaign_data, build_results(evaluation), language)
    assert pdf_bytes(document) == pdf_bytes(again)
    assert docx_bytes(document) == docx_bytes(again)


def test_forward_overlap(campaign_data: CampaignData) -> None:
    """Rationale: overlap follows from footprint and distance of images. Expected: 2048 px of 15 mm at 45 m are 30.72 m along the
    track; three images over 20 m stand 10 m apart: 1 - 10/30.72 = 67 %; a strip of one image has none."""
    assert campaign_data.plan is not None
    strip = campaign_data.plan.strips[0].model_copy(
        update={"start_en_m": (0.0, 0.0), "end_en_m": (20.0, 0.0), "images": 3}
    )
    single = strip.model_copy(update={"strip": 2, "images": 1})
    plan = campaign_data.plan.model_copy(update={"strips": (strip, single)})
    document = build_flight_plan(replace(campaign_data, plan=plan), None, "zh")
    table = next(b for b in document.blocks if isinstance(b, Table) and b.caption.endswith("航线"))
    first = table.rows[0][-1]
    assert isinstance(first, Figure)
    assert first.text == "67 %"
    assert table.rows[1][-1] == "–"


def test_the_lens_of_formula_1(campaign_data: CampaignData) -> None:
    """Rationale: `testrange plan` takes f from the lens's principal distance; a nominal focal length may be some percent off.
    Expected: a certificate of 3160 px instead of 13.5 mm over 4.5 um makes f 14.22 mm, the height
    for 15 mm 47.4 m, and the image from 45 m 3072 px x 45 m / 3160 px = 43.7 m wide; without a certificate 13.50 mm and 45.0 m;
    conformity says the same. Tolerance: digits as printed."""
    assert campaign_data.camera is not None
    assert campaign_data.camera.calibration is not None
    lens = campaign_data.camera.calibration.lens.model_copy(update={"fx_px": 3160.0, "fy_px": 3160.0})
    certificate = campaign_data.camera.calibration.model_copy(update={"lens": lens})
    for calibration, formula, image in (
        (certificate, ("14.22 mm", "= 47.4 m"), f"{campaign_data.camera.width_px * 45.0 / 3160.0:.1f} m × "),
        (None, ("13.50 mm", "= 45.0 m"), f"{campaign_data.camera.width_px * 0.015:.1f} m × "),
    ):
        camera = campaign_data.camera.model_copy(update={"calibration": calibration})
        data = replace(campaign_data, camera=camera)
        document = build_flight_plan(data, None, "en")
        text = texts(document)
        row = next(r for r in conformity_rows(data, ConformityInputs()) if "(1)" in r.requirement)
        assert all(part in text and part in row.measured for part in formula)
        assert image in text


def test_without_a_plan(bare_data: CampaignData) -> None:
    """Rationale: a bench has no flight. Expected: a document that says that 7.1 is not recorded, nothing else."""
    document = build_flight_plan(bare_data, None, "zh")
    assert "未记录" in texts(document)
    assert len(pdf_bytes(document)) > 1000


def test_wrong_plans(campaign_data: CampaignData) -> None:
    """Rationale: plan.json may be anything that its model admits. Expected: no error for a place beyond all sheets, a projection
    that does not hold it or is none, no corners and no strips, hostile text, hundreds of strips; nothing that is not finite."""
    assert campaign_data.plan is not None
    plan = campaign_data.plan
    hostile = "#panic() $x$ </w:t> $\\frac$ " + "W" * 3000
    beyond: dict[str, object] = {
        "takeoff_lat_lon_deg": (-89.0, 359.0),
        "area_lat_lon_deg": ((-89.0, 359.0), (80.0, -300.0)),
        "strips": plan.strips * 60,
    }
    empty: dict[str, object] = {"area_lat_lon_deg": (), "strips": (), "area_m2": 0.0, "duration_s": 0.0}
    written = dict.fromkeys(("aircraft", "requirements", "map_sheet", "season"), hostile)
    for changes in (beyond, empty, {**written, "start_time": "x", "deadline": ""}):
        data = replace(campaign_data, plan=plan.model_copy(update=changes))
        document = build_flight_plan(data, None, "zh")
        assert "nan" not in texts(document)
        assert len(pdf_bytes(document)) > 1000
    for epsg in (4326, 0):
        manifest = campaign_data.manifest.model_copy(update={"projection_epsg": epsg})
        document = build_flight_plan(replace(campaign_data, manifest=manifest), None, "en")
        assert "nan" not in texts(document)
