"""Calculation handbooks after appendix B: B.1 radiometric, B.2 geometric consistency, with the way to every indicator.

Their parts: `handbooks_radiometry` (8.1, 8.2), `handbooks_consistency` (8.3), `handbooks_ranging` (9.1), `handbooks_camera` (9.2),
`handbooks_calibration` (9.3). Nothing is measured here.
"""

from collections.abc import Mapping
from typing import Any

from evaluator.documents.handbooks_calibration import calibration_blocks
from evaluator.documents.handbooks_camera import camera_geometry_blocks
from evaluator.documents.handbooks_common import campaign_form, document, grading
from evaluator.documents.handbooks_consistency import consistency_blocks
from evaluator.documents.handbooks_radiometry import lidar_reflectance_blocks, sphere_blocks
from evaluator.documents.handbooks_ranging import ranging_blocks
from evaluator.documents.model import Block, Document, Language, Table
from evaluator.results import Evaluation

RADIOMETRIC = (
    "lidar_reflectance_rmse",
    "camera_stability",
    "camera_repeatability",
    "reflectance_correlation",
    "reflectance_rmse_relative",
)
GEOMETRIC = ("lidar_ranging_rmse_relative", "camera_reprojection_error", "calibration_error")


def build_radiometric_calculation(evaluation: Evaluation, results: Mapping[str, Any], language: Language) -> Document:
    """B.1 with the solution path of every radiometric indicator.

    Parameters
    ----------
    evaluation : Evaluation
        For the series of 8.2 and the sensors' names.
    results : mapping
        results.json.
    language : "zh" | "en"

    References
    ----------
    GB/T 41450-2022, 10.2 c, B.1.
    """
    blocks: list[Block] = [
        Table(rows=campaign_form(evaluation, language), fields=True, widths=(1.3, 2.7, 1.3, 2.7)),
        *lidar_reflectance_blocks(results, language),
        *sphere_blocks(evaluation, results, language),
        *consistency_blocks(results, language),
        *grading(results, RADIOMETRIC, language, "4"),
    ]
    title = ("多传感器辐射一致性检测计算手簿", "Calculation handbook B.1, radiometric")
    return document(evaluation, results, language, "calculation_radiometric", title, blocks)


def build_geometric_calculation(evaluation: Evaluation, results: Mapping[str, Any], language: Language) -> Document:
    """B.2 with the solution path of every geometric indicator.

    Parameters
    ----------
    evaluation : Evaluation
        For readings, images, residuals and vertices.
    results : mapping
        results.json.
    language : "zh" | "en"

    References
    ----------
    GB/T 41450-2022, 10.2 e, B.2.
    """
    blocks: list[Block] = [
        Table(rows=campaign_form(evaluation, language), fields=True, widths=(1.3, 2.7, 1.3, 2.7)),
        *ranging_blocks(evaluation, results, language),
        *camera_geometry_blocks(evaluation, results, language),
        *calibration_blocks(evaluation, results, language),
        *grading(results, GEOMETRIC, language, "4"),
    ]
    title = ("多传感器几何一致性检测计算手簿", "Calculation handbook B.2, geometric")
    return document(evaluation, results, language, "calculation_geometric", title, blocks)
