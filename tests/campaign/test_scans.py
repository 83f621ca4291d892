"""The files of the ranging line's scans: what is written comes back, in axes of the instrument's own."""

from dataclasses import replace
from pathlib import Path

import laspy  # type: ignore[import-untyped]
import numpy as np
import pyproj
import pytest

from campaign.benches.scans import ScanPoints, read_scan, write_scan
from campaign.errors import CampaignError


def points(xyz_m: np.ndarray, amplitude: float = 200.0) -> ScanPoints:
    n = len(xyz_m)
    return ScanPoints(
        xyz_m=xyz_m,
        gps_time_s=np.linspace(100.0, 108.0, n),
        intensity=np.full(n, 3200, np.uint16),
        amplitude=np.full(n, amplitude, np.float32),
        pulse_width_ns=np.full(n, 4.3, np.float32),
        reflectance_db=np.zeros(n, np.float32),
        return_number=np.ones(n, np.uint8),
        number_of_returns=np.ones(n, np.uint8),
    )


def test_scan_file_round_trip(tmp_path: Path) -> None:
    """Every field returns, coordinates to half of 0.1 mm; `keep` chooses."""
    rng = np.random.default_rng(1)
    written = replace(
        points(rng.uniform(-200, 200, (1000, 3))), intensity=rng.integers(0, 65535, 1000).astype(np.uint16)
    )
    write_scan(tmp_path / "s.laz", written, number=3, creation_date="2026-06-11", system_identifier="x")
    read = read_scan(tmp_path / "s.laz")
    assert np.abs(read.xyz_m - written.xyz_m).max() <= 0.5001e-4
    for name in ("gps_time_s", "intensity", "amplitude", "pulse_width_ns", "reflectance_db", "return_number"):
        assert np.array_equal(getattr(read, name), getattr(written, name)), name
    east = read_scan(tmp_path / "s.laz", lambda xyz: xyz[:, 0] > 0)
    assert np.array_equal(east.xyz_m, read.xyz_m[read.xyz_m[:, 0] > 0])


def test_scan_file_says_that_its_axes_are_its_own(tmp_path: Path) -> None:
    """LAS 1.4, PDRF 6, LAZ, WKT bit and a local CRS that a reader parses; no map projection."""
    write_scan(tmp_path / "s.laz", points(np.ones((5, 3))), number=1, creation_date="2026-06-11", system_identifier="x")
    with laspy.open(tmp_path / "s.laz") as file:
        header = file.header
        assert (str(header.version), header.point_format.id, header.are_points_compressed) == ("1.4", 6, True)
        assert header.global_encoding.wkt
        wkt = next(v for v in header.vlrs if v.record_id == 2112).string
    assert pyproj.CRS.from_wkt(wkt.rstrip("\0")).type_name == "Engineering CRS"


def test_a_point_out_of_reach_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="too far"):
        write_scan(
            tmp_path / "s.laz",
            points(np.full((1, 3), 3e5)),
            number=1,
            creation_date="2026-06-11",
            system_identifier="x",
        )
    assert not list(tmp_path.iterdir())
