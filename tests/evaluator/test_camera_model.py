"""The evaluator's camera: derivatives, distortion round trip, an independent formula."""

import cv2
import numpy as np

from campaign.config import Lens
from evaluator.camera_model import (
    ideal_px,
    lens_from_vector,
    lens_vector,
    project,
    project_with_jacobian,
    undistort,
    undistorted_px,
)

LENS = Lens(
    fx_px=3000.0, fy_px=2996.0, cx_px=1540.0, cy_px=1020.0, k1=-0.0469, k2=0.0236, k3=-0.1049, p1=0.00192, p2=-0.00166
)


def points(n: int = 40) -> np.ndarray:
    rng = np.random.default_rng(3)
    depth = rng.uniform(30.0, 80.0, n)
    return np.stack([rng.uniform(-0.5, 0.5, n) * depth, rng.uniform(-0.33, 0.33, n) * depth, depth], axis=-1)


def test_projection_against_opencv() -> None:
    """Rationale: OpenCV's projectPoints is an independent Brown-Conrady (its distortion order k1 k2 p1 p2 k3).
    Expected: the same pixel after the half-pixel shift of origin. Tolerance: 1e-9 px, double precision."""
    k = np.array([[3000.0, 0, 1540.0 - 0.5], [0, 2996.0, 1020.0 - 0.5], [0, 0, 1]])
    dist = np.array([LENS.k1, LENS.k2, LENS.p1, LENS.p2, LENS.k3])
    expected, _ = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), k, dist)
    assert np.abs(np.asarray(expected).reshape(-1, 2) + 0.5 - project(LENS, points())).max() < 1e-9


def test_point_and_lens_jacobians() -> None:
    """Rationale: the adjustment uses them. Expected: central differences. Tolerance: relative 1e-6 of each column's size
    (step chosen so that truncation and rounding are both below it)."""
    p = points()
    _, d_point, d_lens = project_with_jacobian(LENS, p)
    for j in range(3):
        d = np.zeros(3)
        d[j] = 1e-4
        numeric = (project(LENS, p + d) - project(LENS, p - d)) / 2e-4
        assert np.abs(numeric - d_point[:, :, j]).max() < 1e-6 * np.abs(d_point).max()
    steps = np.array([1e-2, 1e-2, 1e-2, 1e-2, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5])
    for j in range(9):
        v = lens_vector(LENS)
        v[j] += steps[j]
        up = project(lens_from_vector(v), p)
        v[j] -= 2 * steps[j]
        down = project(lens_from_vector(v), p)
        numeric = (up - down) / (2 * steps[j])
        assert np.abs(numeric - d_lens[:, :, j]).max() < 1e-6 * max(1.0, np.abs(d_lens[:, :, j]).max())


def test_distortion_round_trip() -> None:
    """Rationale: distortion is removed from observations before (24). Expected: identity over the whole image.
    Tolerance: 1e-9 px, Newton converges quadratically."""
    p = points()
    uv = project(LENS, p)
    assert np.abs(undistort(LENS, uv) - p[:, :2] / p[:, 2:]).max() < 1e-12
    assert np.abs(undistorted_px(LENS, uv) - ideal_px(LENS, p)).max() < 1e-9


def test_behind_and_folded_are_nan() -> None:
    """Rationale: a point behind the camera, or beyond the radius where the polynomial turns back, has no pixel."""
    uv = project(LENS, np.array([[0.0, 0.0, -1.0], [3.0, 0.0, 1.0], [0.0, 0.0, 1.0]]))
    assert np.isnan(uv[0]).all()
    assert np.isnan(uv[1]).all()
    assert np.allclose(uv[2], [1540.0, 1020.0])
