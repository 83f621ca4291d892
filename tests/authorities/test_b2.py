"""Appendix B.2 of GB/T 41450-2022: the worked example of the calibration error, as printed and as its coordinates give it."""

import numpy as np
import scipy.optimize

from campaign.config import Lens
from evaluator.c9_3_calibration import calibration_error, project_24, residual_norms
from evaluator.frames import euler_rotation

# point, world coordinates [m], projected pixel, observed pixel, printed calibration error [px]
TABLE = np.array(
    [
        (1, 0.538, -0.808, 0.295, 305.1, 144.2, 304.9, 144.4, 0.233),
        (2, 0.745, 2.104, 1.301, 487.1, 409.1, 487.2, 409.1, 0.103),
        (3, -1.208, 0.711, -2.030, 155.3, 370.2, 155.4, 370.5, 0.315),
        (4, 0.632, -1.235, -2.437, 65.0, 30.7, 64.9, 30.9, 0.161),
        (5, 1.425, -1.398, 0.851, 353.6, 71.8, 354.0, 71.6, 0.397),
        (6, 0.003, 2.061, 0.038, 430.4, 451.0, 430.1, 451.4, 0.563),
        (7, -0.138, 1.751, 0.215, 394.1, 426.7, 394.0, 426.7, 0.148),
        (8, 0.420, -1.919, 1.288, 248.9, 98.7, 248.6, 98.7, 0.304),
        (9, -0.617, -1.566, 1.349, 182.6, 176.9, 182.7, 176.7, 0.167),
        (10, -0.078, 0.472, 0.152, 319.0, 293.4, 319.9, 293.7, 0.282),
        (11, 1.797, -0.985, -0.596, 415.6, 13.2, 415.1, 13.2, 0.426),
        (12, -2.198, 0.460, -0.944, 57.2, 423.8, 56.7, 423.7, 0.507),
        (13, 1.871, -0.019, -0.109, 480.7, 122.4, 481.2, 122.6, 0.588),
        (14, -1.841, -0.327, 0.182, 100.6, 323.2, 100.6, 322.9, 0.223),
        (15, -1.755, 0.226, 0.398, 145.8, 373.2, 145.9, 347.0, 0.235),
        (16, 0.201, -2.046, 0.980, 221.1, 87.6, 221.1, 88.0, 0.356),
        (17, 0.375, 1.204, 0.630, 407.5, 343.2, 407.2, 342.5, 0.786),
        (18, 0.607, -0.532, 0.281, 327.2, 164.1, 326.9, 163.9, 0.290),
        (19, -0.379, 0.861, -1.243, 300.8, 332.0, 300.8, 331.7, 0.277),
        (20, 0.853, 0.986, -0.599, 452.7, 270.3, 453.1, 269.8, 0.619),
    ]
)
# What the printed coordinates give for each point, worked by hand.
RECOMPUTED = [0.283, 0.100, 0.316, 0.224, 0.447, 0.500, 0.100, 0.300, 0.224, 0.949]
RECOMPUTED += [0.500, 0.510, 0.539, 0.300, 26.200, 0.400, 0.762, 0.361, 0.300, 0.640]


def test_printed_column_gives_the_printed_mean() -> None:
    """Rationale: formula (20) on the standard's own P_i. Expected: 0.349 px. Tolerance: half the last digit."""
    assert abs(calibration_error(TABLE[:, 8]) - 0.349) < 0.0005


def test_printed_coordinates_give_another_mean() -> None:
    """Rationale: the printed P_i do not follow from the printed coordinates; rows 10 and 15 are misprints. The evaluator
    computes from coordinates. Expected: each P_i as by hand, mean 1.698 px. Tolerance: half the last digit."""
    errors = residual_norms(TABLE[:, 4:6], TABLE[:, 6:8])
    assert np.abs(errors - RECOMPUTED).max() < 0.0006
    assert abs(calibration_error(errors) - 1.698) < 0.0005


def test_printed_points_fit_a_pinhole() -> None:
    """Rationale: an outside check of the camera's axes and of (24). Sixteen rows (all but 4, 10, 15 and 16) come from a pinhole
    with f = 800 px and c = (320, 240). Expected: a pose in front of all points (4.7-8.6 m deep) with 0.055 px RMS an axis;
    the coordinates are rounded to 1 mm (0.05 px) and 0.1 px (0.03 px). Tolerance: 0.058 px; 4 and 16 stay off by
    ten times as much."""
    lens = Lens(fx_px=800.0, fy_px=800.0, cx_px=320.0, cy_px=240.0)
    good = ~np.isin(TABLE[:, 0], [4, 10, 15, 16])
    world, uv = TABLE[:, 1:4], TABLE[:, 4:6]

    def residual(x: np.ndarray) -> np.ndarray:
        p = project_24(lens, euler_rotation(*x[:3]), x[3:], world[good])
        return np.nan_to_num(p - uv[good], nan=1e4).ravel()

    rng = np.random.default_rng(1)
    best = None
    for _ in range(60):
        start = np.concatenate([rng.uniform(-np.pi, np.pi, 3), [0.0, 0.0, 7.0]])
        fit = scipy.optimize.least_squares(residual, start, max_nfev=60)
        if best is None or fit.cost < best.cost:
            best = fit
        if best.cost < 0.2:
            break
    assert best is not None
    rms = np.sqrt(np.mean(best.fun**2))
    assert rms < 0.058
    rotation, translation = euler_rotation(*best.x[:3]), best.x[3:]
    depth = (world @ rotation.T + translation)[good, 2]
    assert 4.6 < depth.min() < 4.8 and 8.5 < depth.max() < 8.7
    off = residual_norms(project_24(lens, rotation, translation, world), uv)
    assert (off[[3, 15]] > 0.55).all()
