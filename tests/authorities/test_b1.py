"""Appendix B.1 of GB/T 41450-2022: the printed example of the radiometric consistency sheet."""

import numpy as np
import pytest

from evaluator.c8_3_reflectance_consistency import reflectance_correlation, reflectance_rmse_relative

# Figure B.1: LiDAR, camera, printed square of the difference; 20 panels.
TABLE = np.array(
    [
        (0.061, 0.042, 0.000361),
        (0.058, 0.045, 0.000169),
        (0.123, 0.145, 0.000484),
        (0.119, 0.139, 0.0004),
        (0.209, 0.226, 0.000289),
        (0.211, 0.223, 0.000144),
        (0.291, 0.306, 0.000225),
        (0.316, 0.293, 0.000529),
        (0.411, 0.426, 0.000225),
        (0.403, 0.392, 0.000121),
        (0.519, 0.491, 0.000784),
        (0.506, 0.516, 0.0001),
        (0.609, 0.596, 0.000169),
        (0.616, 0.591, 0.000625),
        (0.704, 0.719, 0.000225),
        (0.696, 0.709, 0.000169),
        (0.829, 0.813, 0.000256),
        (0.809, 0.792, 0.000289),
        (0.982, 0.969, 0.000169),
        (0.976, 0.986, 0.0001),
    ]
)


def test_squares_as_printed() -> None:
    """Rationale: the table was typed from a scan. Expected: every square and the sum 0.005833 as printed. Tolerance: half the
    last printed digit."""
    squares = (TABLE[:, 0] - TABLE[:, 1]) ** 2
    assert squares == pytest.approx(TABLE[:, 2], abs=5e-7)
    assert squares.sum() == pytest.approx(0.005833, abs=5e-7)


def test_correlation() -> None:
    """Rationale: formula (7) on the standard's own example. Expected: 99.83 % as printed, unrounded 0.998331. Tolerance: half
    of the last digit stated."""
    r_f = reflectance_correlation(TABLE[:, 0], TABLE[:, 1])
    assert f"{100.0 * r_f:.2f}" == "99.83"
    assert r_f == pytest.approx(0.998331, abs=5e-7)


def test_relative_rmse() -> None:
    """Rationale: formula (8) with 2 (n - 1) below the line. Expected: 1.24 % as printed, unrounded 1.2390 %; with 2 n it would
    be 1.21 %. Tolerance: half of the last digit stated."""
    m_f = 100.0 * reflectance_rmse_relative(TABLE[:, 0], TABLE[:, 1])
    assert f"{m_f:.2f}" == "1.24"
    assert m_f == pytest.approx(1.2390, abs=5e-5)
