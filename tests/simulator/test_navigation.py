"""Errors of the estimated trajectory have the statistics that the rig sheet states."""

import numpy as np

from simulator.flight.navigation import gauss_markov


def test_gauss_markov_is_stationary_with_the_stated_correlation() -> None:
    """Rationale: the evaluator weights with sigma and T from the sheet, so the simulator must draw exactly that process.

    Expected: variance sigma2 at every epoch, correlation exp(-dt/T). Tolerance: 4000 draws give a relative standard deviation
    of the variance of sqrt(2/4000) = 2.2 % and 1.4 % of a correlation of 0.6; four of them.
    """
    t = np.arange(0.0, 40.0, 0.5)
    draws = gauss_markov(np.random.default_rng(5), t, np.full(4000, 0.3), 20.0)
    variance = draws.var(axis=1) / 0.3**2
    assert abs(variance[0] - 1.0) < 0.09
    assert abs(variance[-1] - 1.0) < 0.09
    lag = 20  # 10 s
    correlation = (draws[0] * draws[lag]).mean() / 0.3**2
    assert abs(correlation - np.exp(-10.0 / 20.0)) < 0.07


def test_no_error_for_a_perfect_navigation() -> None:
    t = np.arange(0.0, 1.0, 0.1)
    assert not gauss_markov(np.random.default_rng(1), t, np.zeros(3), 10.0).any()
