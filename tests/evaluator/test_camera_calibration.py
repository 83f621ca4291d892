"""The least squares of 9.2 on exactly projected corners with known noise: what it recovers, what it states, what it throws out."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import scipy.stats

from campaign.config import Lens
from evaluator.benches.board_adjustment import (
    Observations,
    Poses,
    board_points,
    moved,
    residuals_and_jacobian,
    rotation_exp,
)
from evaluator.benches.camera_calibration import calibrate, focal_from_homographies
from evaluator.camera_model import lens_from_vector, lens_vector, project
from evaluator.model import EvaluationError

LENS = Lens(
    fx_px=3004.2, fy_px=3003.6, cx_px=1541.3, cy_px=1019.4, k1=-0.0469, k2=0.0236, k3=-0.0049, p1=3.2e-4, p2=-2.6e-4
)
SIZE = (3072, 2048)
COLUMNS, ROWS, SQUARE_M = 11, 8, 0.09
SEEDS = 20


def poses(rng: np.random.Generator, distances: tuple[float, ...] = (1.6, 2.0, 2.5, 3.0), tilt: float = 0.4) -> Poses:
    """Five images at each distance, tilted up to `tilt` rad about both axes, spread over the field."""
    centre = board_points(COLUMNS, ROWS, SQUARE_M).mean(axis=0)
    rotation, translation = [], []
    for d in distances:
        for _ in range(5):
            r = rotation_exp(np.append(rng.uniform(-tilt, tilt, 2), 0.3 * rng.uniform(-tilt, tilt)))
            at = np.array([rng.uniform(-0.17, 0.17) * d, rng.uniform(-0.1, 0.1) * d, d])
            rotation.append(r)
            translation.append(at - r @ centre)
    return Poses(rotation=np.array(rotation), translation_m=np.array(translation))


def observations(true: Poses, rng: np.random.Generator, std_px: float = 0.02, lens: Lens = LENS) -> Observations:
    """Projected corners plus noise that differs by image; the covariances say so."""
    board = board_points(COLUMNS, ROWS, SQUARE_M)
    uv = project(lens, np.einsum("kij,nj->kni", true.rotation, board) + true.translation_m[:, None])
    std = std_px * rng.uniform(0.5, 2.0, len(uv))
    covariance = np.broadcast_to(np.eye(2), (*uv.shape, 2)) * (std**2)[:, None, None, None]
    return Observations(
        board_m=board,
        uv_px=uv + rng.normal(size=uv.shape) * std[:, None, None],
        covariance_px2=covariance,
        size_px=SIZE,
    )


def test_rotation_exp_is_opencvs_and_orthonormal() -> None:
    """Rationale: poses move by it; its series near zero is a branch of its own. Expected: Rodrigues' matrix for large, small and
    zero turns. Tolerance: 1e-14, rounding."""
    for w in ([0.3, -1.2, 2.0], [1e-8, 2e-8, -3e-8], [0.0, 0.0, 0.0], [0.0, np.pi, 0.0]):
        r = rotation_exp(np.array(w))
        assert np.allclose(r, cv2.Rodrigues(np.array(w))[0], atol=1e-14)
        assert np.allclose(r @ r.T, np.eye(3), atol=1e-14)


def test_analytic_jacobian_agrees_with_differences() -> None:
    """Rationale: a wrong derivative converges to a wrong covariance without a sound. Expected: central differences of the pixel
    by all nine lens parameters and six pose increments. Tolerance: 1e-6 relative to the greatest entry of the column (steps of
    1e-5 leave 1e-10, rounding of pixels 1e-7)."""
    rng = np.random.default_rng(5)
    true = poses(rng, (1.8,))
    obs = observations(true, rng)
    _, d_lens, d_pose = residuals_and_jacobian(LENS, true, obs.board_m, obs.uv_px)
    vector = lens_vector(LENS)
    for j, h in enumerate([1e-2] * 4 + [1e-5] * 5):
        d = np.zeros(9)
        d[j] = h
        plus, minus = (
            residuals_and_jacobian(lens_from_vector(vector + s * d), true, obs.board_m, obs.uv_px)[0] for s in (1, -1)
        )
        assert np.allclose((minus - plus) / (2 * h), d_lens[..., j], atol=1e-6 * np.abs(d_lens[..., j]).max())
    for j in range(6):
        d = np.zeros((len(true.rotation), 6))
        d[:, j] = 1e-5
        plus, minus = (residuals_and_jacobian(LENS, moved(true, s * d), obs.board_m, obs.uv_px)[0] for s in (1, -1))
        assert np.allclose((minus - plus) / 2e-5, d_pose[..., j], atol=1e-6 * np.abs(d_pose[..., j]).max())


def test_stated_uncertainty_over_seeds() -> None:
    """Rationale: a lens without an honest covariance cannot be propagated into 9.3. Expected: over 20 seeds the errors of all nine
    parameters over their stated standard deviations have spread one and no outlier; Mahalanobis distances follow chi-square.
    Tolerance: spread 0.6-1.5 for each parameter, 0.85-1.15 over all; greatest |z| at 0.5 % over the family of 180; the sum of 20
    Mahalanobis squares within 0.1 % and 99.9 % of chi-square with 180 degrees of freedom."""
    z, total = [], 0.0
    for seed in range(SEEDS):
        rng = np.random.default_rng([92, seed])
        result = calibrate(observations(poses(rng), rng))
        error = lens_vector(result.lens) - lens_vector(LENS)
        z.append(error / np.sqrt(np.diag(result.covariance)))
        total += float(error @ np.linalg.solve(result.covariance, error))
        assert not result.rejected
        assert len(result.wild) <= 1  # six sigma of 1760 corners: one in thirty runs at most
    spread = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((spread > 0.6) & (spread < 1.5))
    assert 0.85 < np.sqrt(np.mean(np.square(z))) < 1.15
    assert np.abs(z).max() < scipy.stats.norm.ppf(1.0 - 0.005 / np.size(z))
    assert scipy.stats.chi2.ppf(0.001, 9 * SEEDS) < total < scipy.stats.chi2.ppf(0.999, 9 * SEEDS)


def test_variance_by_image_is_found_when_the_covariances_are_wrong() -> None:
    """Rationale: the corners' own covariances may be off by a factor that differs between images (a blur the model does not have).
    Expected: halved and quadrupled variances come back as factors 2 and 1/4, and the parameters' covariance stays what it was.
    Tolerance: 25 %, four standard deviations of a variance from 176 residuals; 10 % for the standard deviations."""
    rng = np.random.default_rng(17)
    obs = observations(poses(rng), rng)
    half = np.where(np.arange(20) % 2 == 0, 0.5, 4.0)
    wrong = replace(obs, covariance_px2=obs.covariance_px2 * half[:, None, None, None])
    right, found = calibrate(obs), calibrate(wrong)
    if found.floor_px == 0.0:
        assert np.allclose(found.factor * half, 1.0, rtol=0.4)
    assert np.median(found.factor[0::2]) > 3.0 * np.median(found.factor[1::2])
    ratio = np.sqrt(np.diag(found.covariance) / np.diag(right.covariance))
    assert np.all(np.abs(ratio - 1.0) < 0.15)


def test_wild_corner_and_foreign_image_are_named() -> None:
    """Rationale: a reflection takes a corner, a touched zoom takes an image. Expected: exactly these are rejected, and the lens is
    that of a calibration that never saw them. Tolerance: a fiftieth of a standard deviation (the same minimum)."""
    rng = np.random.default_rng(23)
    true = poses(rng)
    obs = observations(true, rng)
    uv = obs.uv_px.copy()
    uv[3, 40] += (1.5, -0.7)
    foreign = observations(true, rng, lens=LENS.model_copy(update={"fx_px": 2900.0, "k1": 0.1}))
    uv[11] = foreign.uv_px[11]
    found = calibrate(replace(obs, uv_px=uv))
    assert list(found.rejected) == [11]
    assert "times the median image's" in found.rejected[11]
    assert found.wild == ((3, 40),)
    assert found.use.sum() == obs.uv_px[..., 0].size - 88 - 1
    kept = uv.copy()
    kept[3, 40] = np.nan
    keep = np.arange(20) != 11
    clean = calibrate(replace(obs, uv_px=kept[keep], covariance_px2=obs.covariance_px2[keep]))
    assert not clean.rejected and not clean.wild
    difference = lens_vector(found.lens) - lens_vector(clean.lens)
    assert np.all(np.abs(difference) < 0.02 * np.sqrt(np.diag(clean.covariance)))


def test_strong_lens_from_a_poor_start() -> None:
    """Rationale: a wide lens, and a sheet that states the wrong focal length. Expected: the same lens as from no sheet at all.
    Tolerance: 1 % of a standard deviation."""
    wide = Lens(fx_px=1500.0, fy_px=1502.0, cx_px=1490.0, cy_px=1040.0, k1=-0.15, k2=0.05, k3=-0.006)
    rng = np.random.default_rng(31)
    obs = observations(poses(rng, (0.8, 1.0, 1.3, 1.6)), rng, lens=wide)
    free, led = calibrate(obs), calibrate(obs, focal_px=6000.0)
    std = np.sqrt(np.diag(free.covariance))
    assert np.all(np.abs(lens_vector(free.lens) - lens_vector(led.lens)) < 0.01 * std)
    assert np.all(np.abs(lens_vector(free.lens) - lens_vector(wide)) < 4.5 * std)


def test_zhang_start() -> None:
    """Rationale: without a sheet the tilts give the focal length. Expected: 2000 px from exact homographies; None when every board
    is square on. Tolerance: 1e-6 relative, closed form."""
    k = np.array([[2000.0, 0.0, 1536.0], [0.0, 2000.0, 1024.0], [0.0, 0.0, 1.0]])
    rng = np.random.default_rng(2)
    true = poses(rng)
    h = np.stack(
        [k @ np.column_stack([r[:, 0], r[:, 1], t]) for r, t in zip(true.rotation, true.translation_m, strict=True)]
    )
    assert focal_from_homographies(h, SIZE) == pytest.approx(2000.0, rel=1e-6)
    flat = np.stack([k @ np.column_stack([np.eye(3)[:, 0], np.eye(3)[:, 1], [0.1, 0.0, d]]) for d in (1.0, 2.0, 3.0)])
    assert focal_from_homographies(flat, SIZE) is None


def test_too_few_images() -> None:
    """Rationale: three images leave nothing to test. Expected: one line with the count. Tolerance: exact."""
    rng = np.random.default_rng(3)
    obs = observations(poses(rng), rng)
    with pytest.raises(EvaluationError, match=r"too few images.*got 3; expected at least 4"):
        calibrate(replace(obs, uv_px=obs.uv_px[:3], covariance_px2=obs.covariance_px2[:3]))


def test_images_of_different_cameras_are_refused() -> None:
    """Rationale: when a third of the images contradicts the rest, nobody knows which are right. Expected: one line, no lens.
    Tolerance: exact."""
    rng = np.random.default_rng(41)
    true = poses(rng)
    uv = observations(true, rng).uv_px.copy()
    for i in range(0, 20, 3):
        f = LENS.model_copy(update={"fx_px": 2000.0 + 130.0 * i, "k1": 0.3 - 0.02 * i})
        uv[i] = observations(true, np.random.default_rng(i), lens=f).uv_px[i]
    with pytest.raises(EvaluationError, match="too many images contradict the rest"):
        calibrate(replace(observations(true, rng), uv_px=uv))
