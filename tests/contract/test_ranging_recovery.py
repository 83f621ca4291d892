"""The ranging line from configuration to K2, R2 and m_z: what was injected is found again, within what is stated.

Acceptance: K2 = +0.05 m with R2 = 2e-4, and zero, with |z| <= 3 at a standard deviation of K2 up to 3 mm and of R2 up to 4e-5.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from campaign.folder import CampaignFolder
from campaign.load import load_config
from campaign.manifest import Manifest, write_manifest
from evaluator.benches.bench_model import RangingResult
from evaluator.c9_1_lidar_ranging import evaluate_ranging
from evaluator.load import load_campaign
from simulator.lidar.ranging import prepare_line, simulate_ranging, true_ranging

QUICKSTART = Path(__file__).parents[2] / "configs" / "campaigns" / "quickstart.toml"
K2_M, R2 = 0.05, 2e-4
# For tests of many seeds: a third of the points, 19 on the farthest panel, and no panel so near that it takes most of them.
COARSE = (
    "ranging.turn_rate_deg_s=3.5",
    "ranging.scan_rate_hz=60.0",
    "ranging.distances_m=[40.0, 80.0, 120.0, 160.0, 200.0, 240.0]",
)


def faults(k2_m: float, r2: float) -> list[str]:
    """measured = true + o + s true with true = measured + K2 + R2 measured: s = -R2 / (1 + R2), o = -K2 (1 + s)."""
    s = -r2 / (1.0 + r2)
    return [f"faults.range_offset_m={-k2_m * (1.0 + s)!r}", f"faults.range_scale={s!r}"]


@dataclass(frozen=True, kw_only=True)
class Run:
    result: RangingResult
    z: np.ndarray  # (2,) of K2, R2
    std: np.ndarray  # (2,)

    def companion(self, name: str) -> float:
        value = self.result.indicator.companions[name]
        assert isinstance(value, float | int)
        return float(value)


def run(place: Path, k2_m: float, r2: float, *overrides: str) -> Run:
    """Simulate and evaluate one line; the folder holds nothing else but a manifest."""
    config = load_config(QUICKSTART, [*faults(k2_m, r2), *overrides])
    place.mkdir()
    simulate_ranging(config, CampaignFolder(place), 450_000_000.0, lambda *_: None)
    site = config.site
    write_manifest(
        place,
        Manifest(
            campaign="line",
            title="ranging line",
            synthetic=True,
            date="2026-09-24",
            start_time="2026-09-24T10:00:00+08:00",
            gps_week=2437,
            latitude_deg=site.latitude_deg,
            longitude_deg=site.longitude_deg,
            ellipsoid_height_m=site.ellipsoid_height_m,
            height_anomaly_m=site.height_anomaly_m,
            projection_epsg=site.projection_epsg,
            height_epsg=site.height_epsg,
            software={},
            files=(),
        ),
    )
    result = evaluate_ranging(load_campaign(place), lambda *_: None)
    assert result.covariance is not None, result.indicator.reason
    truth = true_ranging(config)
    assert (truth.additive_constant_m, truth.multiplication_constant) == pytest.approx((k2_m, r2), abs=1e-12)
    std = np.sqrt(np.diag(result.covariance))
    found = np.array([result.additive_constant_m, result.multiplication_constant])
    return Run(result=result, z=(found - [k2_m, r2]) / std, std=std)


def runs(place: Path, seeds: range, *overrides: str) -> list[Run]:
    """The injected constants and zero in turn; the line stands as it is, noise is redrawn."""
    return [
        run(place / f"{seed}", K2_M * (seed % 2), R2 * (seed % 2), f"seed={seed}", "scene_seed=4", *overrides)
        for seed in seeds
    ]


@pytest.mark.parametrize(("k2_m", "r2"), [(K2_M, R2), (0.0, 0.0), (-0.3, -1e-3)])
def test_the_constants_come_back(tmp_path: Path, k2_m: float, r2: float) -> None:
    """Rationale: the acceptance of the issue, the control without a fault, and a fault of 0.5 m at the far end.

    Expected: |z| <= 3, standard deviations within the bars. m_z after the correction is at the ranging noise: below twice the
    root mean square that the stated covariances foresee (m_j^2 of six panels exceeds four times its mean 1 time in 1000);
    before it the injected error itself: the root mean square of (K2 + R2 L) over the mean of L, within what noise adds.
    """
    found = run(tmp_path / "line", k2_m, r2)
    assert np.abs(found.z).max() <= 3.0, found.z
    assert found.std[0] <= 0.003 and found.std[1] <= 4e-5
    value = found.result.indicator
    assert value.value is not None
    mean = found.companion("mean_range_m")
    assert found.companion("rmse_m") < 2.0 * found.companion("expected_rmse_m") < 0.004
    assert value.value == pytest.approx(100.0 * found.companion("rmse_m") / mean, rel=1e-12)
    far = np.array([np.linalg.norm(p.centre_m) for p in prepare_line(load_config(QUICKSTART)).setting.panels])
    injected = float(np.sqrt(np.mean((k2_m + r2 * far) ** 2)))
    assert found.companion("rmse_before_m") == pytest.approx(injected, abs=0.003)
    assert mean == pytest.approx(far.mean(), abs=0.003)
    assert len(found.result.panels) == 6 and not found.result.not_used
    assert min(p.scans for p in found.result.panels) == 5
    assert not {"notes", "left_out", "not_used"} & value.companions.keys()
    assert min(min(p.correction_readings, p.reference_readings) for p in found.result.panels) == 5


def test_uncertainty_is_honest(tmp_path: Path) -> None:
    """Rationale: a stated standard deviation is worth nothing unless errors spread by it.

    Expected over 10 seeds, the injected constants and zero in turn: z of K2 and of R2 each with a spread of 0.6 to 1.5 (the
    sample spread of 10 normal numbers lies there 96 times in 100), none beyond 3.5, and no common offset (mean of 10: 0.32).
    """
    z = np.stack([r.z for r in runs(tmp_path, range(11, 21), *COARSE)])
    spread = z.std(axis=0, ddof=1)
    assert (spread > 0.6).all() and (spread < 1.5).all(), spread
    assert np.abs(z).max() < 3.5
    assert np.abs(z.mean(axis=0)).max() < 3.0 / np.sqrt(10), z.mean(axis=0)


@pytest.mark.slow
def test_uncertainty_is_honest_over_forty_seeds(tmp_path: Path) -> None:
    """Expected over 40 seeds of the full line: spread of z 0.75 to 1.3, mean of chi-square over its 4 degrees of freedom 0.7 to
    1.5 (24 readings' degrees of freedom raise it to 1.09; 0.11 standard error), m_j^2 as foreseen within 35 % (three standard
    errors of 40 x 6 errors that share the fit).
    """
    found = runs(tmp_path, range(101, 141))
    z = np.stack([r.z for r in found])
    spread = z.std(axis=0, ddof=1)
    assert (spread > 0.75).all() and (spread < 1.3).all(), spread
    chi_square = np.mean([r.companion("chi_square") / r.companion("chi_square_freedom") for r in found])
    assert 0.7 < chi_square < 1.5
    squares = [np.mean([r.companion(name) ** 2 for r in found]) for name in ("rmse_m", "expected_rmse_m")]
    assert squares[0] / squares[1] == pytest.approx(1.0, abs=0.35)
