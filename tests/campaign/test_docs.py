"""docs/campaign_folder.md names every field that the formats have, and its example is a manifest that serves."""

import dataclasses
import json
import re
from pathlib import Path

import pytest

from campaign.benches.bench import BOARD_COLUMNS, SPHERE_COLUMNS, BoardSheet, RoomSheet, write_room
from campaign.benches.ranging import READING_COLUMNS, RangingLine, RangingPanel, TotalStation
from campaign.checks.folder import check_campaign
from campaign.errors import CampaignError
from campaign.flight.las import EXTRA_BYTES
from campaign.flight.records import (
    CAMERA_OBSERVATION_COLUMNS,
    ENVIRONMENT_COLUMNS,
    EXPOSURE_COLUMNS,
    LIDAR_OBSERVATION_COLUMNS,
    FlightPlan,
    PlannedStrip,
)
from campaign.manifest import Manifest, read_manifest
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


def test_the_laboratorys_manifest_is_complete_and_minimal(tmp_path: Path) -> None:
    """Rationale: a laboratory copies the example. Expected: beside a bench/ it gives no error; without any one of its keys the
    manifest is refused, naming the key; the keys that the page calls optional are all the others of the model."""
    text = PAGE.read_text(encoding="utf-8")
    (example,) = re.findall(r"```json\n(.*?)```", text, flags=re.DOTALL)
    keys = json.loads(example)
    (tmp_path / "manifest.json").write_text(example, encoding="utf-8")
    write_room(tmp_path / "bench" / "room.json", RoomSheet(dust_free=True))
    found = [str(p) for p in check_campaign(tmp_path)]
    assert found == ["warning: bench/room.json: not in the manifest"]
    for key in keys:
        (tmp_path / "manifest.json").write_text(json.dumps({k: v for k, v in keys.items() if k != key}))
        with pytest.raises(CampaignError, match=f"manifest.json {key}: Field required"):
            read_manifest(tmp_path)
    assert len(keys) == 13 and "All thirteen keys are required" in text
    assert set(Manifest.model_fields) - keys.keys() == {"schema_version", "title", "gps_minus_utc_s"}
