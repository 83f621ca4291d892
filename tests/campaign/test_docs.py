"""docs/campaign_folder.md names every field that the formats have."""

import dataclasses
from pathlib import Path

from campaign.bench import BOARD_COLUMNS, SPHERE_COLUMNS, BoardSheet, RoomSheet
from campaign.las import EXTRA_BYTES
from campaign.manifest import Manifest
from campaign.ranging import READING_COLUMNS, RangingLine, RangingPanel, TotalStation
from campaign.records import (
    CAMERA_OBSERVATION_COLUMNS,
    ENVIRONMENT_COLUMNS,
    EXPOSURE_COLUMNS,
    LIDAR_OBSERVATION_COLUMNS,
    FlightPlan,
    PlannedStrip,
)
from campaign.sensors import Calibration, CameraSheet, LidarSheet, MountingSheet, NavigationSheet, Rig
from campaign.survey import TARGET_COLUMNS
from campaign.truth import MARK_COLUMNS, TrueBench, TrueMounting, TrueRanging, TrueReturns, TrueTarget, Truth

PAGE = Path(__file__).resolve().parents[2] / "docs" / "campaign_folder.md"


def test_every_field_is_on_the_page() -> None:
    """Rationale: a format is a table, and people work from the page. Expected: each column, key and extra byte in backticks."""
    page = PAGE.read_text(encoding="utf-8")
    tables = (
        TARGET_COLUMNS,
        EXPOSURE_COLUMNS,
        ENVIRONMENT_COLUMNS,
        CAMERA_OBSERVATION_COLUMNS,
        LIDAR_OBSERVATION_COLUMNS,
        MARK_COLUMNS,
        SPHERE_COLUMNS,
        BOARD_COLUMNS,
        READING_COLUMNS,
        [name for name, *_ in EXTRA_BYTES],
        [f.name for f in dataclasses.fields(TrueReturns)],
    )
    models = (
        *(
            Manifest,
            FlightPlan,
            PlannedStrip,
            CameraSheet,
            Calibration,
            LidarSheet,
            MountingSheet,
            NavigationSheet,
            Rig,
        ),
        *(RoomSheet, BoardSheet, TotalStation, RangingPanel, RangingLine),
        *(Truth, TrueMounting, TrueTarget, TrueBench, TrueRanging),
    )
    names = {name for table in tables for name in table} | {name for model in models for name in model.model_fields}
    assert sorted(name for name in names if f"`{name}`" not in page) == []
