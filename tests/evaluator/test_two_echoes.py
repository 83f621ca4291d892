"""The decomposition of 8.1.2 e on packets with two echoes against the Cramer-Rao bound."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from evaluator.observe.waveforms import decompose

TWO = runpy.run_path(str(Path(__file__).with_name("two_echoes.py")))


@pytest.mark.parametrize("lost", ["nothing", "a ninth of every fourth packet's samples"])
def test_two_echoes_reach_the_cramer_rao_bound(lost: str) -> None:
    """Rationale: the echoes are found blindly and the noise is learnt from the packets themselves, of which none has one echo
    alone; still an efficient estimator's errors are the least that the device's noise allows, and it says how large they are.
    Expected: two echoes in every packet; errors over the bound, root mean square over the packets, at most 1.2 for amplitude,
    centre and width of each echo; errors over stated standard deviations of spread 1. Tolerance: 20 % of the bound is what
    the range asks for, 3000 packets scatter the figure by 1.3 %; 8 % on the spread, 5 % of them for the learnt noise.
    Without samples (saturated, NaN) the bound of the whole packet does not hold, the stated deviations do."""
    made = TWO["pairs"](3000, np.random.default_rng(np.random.SeedSequence([8, 9])))
    packets = made.packets.astype(float)
    if lost != "nothing":
        packets[::4, ::9] = np.nan
    found = decompose(packets, 1.0, echo_fwhm_ns=TWO["ECHO_FWHM_NS"], saturation_dn=TWO["SATURATION_DN"])
    assert np.array_equal(found.packet, np.repeat(np.arange(len(packets)), 2))
    fitted = np.stack([found.amplitude_dn, found.centre_ns, found.fwhm_ns], axis=1).reshape(-1, 2, 3)
    stated = np.stack([found.amplitude_std_dn, found.centre_std_ns, found.fwhm_std_ns], axis=1).reshape(-1, 2, 3)
    error = fitted - made.truth
    if lost == "nothing":
        assert (np.sqrt(np.mean((error / TWO["cramer_rao"](made.truth)) ** 2, axis=0)) <= 1.2).all()
    assert np.sqrt(np.mean((error / stated) ** 2, axis=0)) == pytest.approx(np.ones((2, 3)), abs=0.08)
    assert (np.abs(np.mean(error / stated, axis=0)) < 0.1).all()
    assert found.noise.shot_dn2_per_dn == pytest.approx(TWO["LIDAR"].shot_noise_dn ** 2, rel=0.25)
    assert np.median(found.packet_chi2) == pytest.approx(1.0, abs=0.1)


def test_significance_is_what_is_lost_without_the_echo() -> None:
    """Rationale: echoes stay or go by it. Expected: of an echo far from the other, the chi-square of its own samples against a
    baseline alone. Tolerance: 5 %, for the baseline and the other echo that take up a little."""
    made = TWO["pairs"](200, np.random.default_rng(np.random.SeedSequence([8, 10])))
    packets = made.packets.astype(float)
    noise = {"noise_dn": 2.0, "shot_dn2_per_dn": 0.0625, "shape_error": 0.0}
    found = decompose(packets, 1.0, echo_fwhm_ns=TWO["ECHO_FWHM_NS"], **noise)
    z = (np.arange(packets.shape[1]) - found.centre_ns[:, None]) / (found.fwhm_ns[:, None] / TWO["FWHM_PER_SIGMA"])
    signal = found.amplitude_dn[:, None] * np.exp(-0.5 * z**2)
    both = signal.reshape(-1, 2, packets.shape[1]).sum(axis=1)
    weight = 1.0 / (4.0 + 0.0625 * both)
    apart = np.diff(found.centre_ns.reshape(-1, 2), axis=1)[:, 0] > 3.3 * TWO["ECHO_FWHM_NS"]
    alone = np.sqrt(np.sum(signal**2 * np.repeat(weight, 2, axis=0), axis=1))
    assert apart.sum() > 30
    assert found.significance[np.repeat(apart, 2)] == pytest.approx(alone[np.repeat(apart, 2)], rel=0.05)
