"""The decomposition of 8.1.2 e on packets whose echoes are known."""

import numpy as np
import pytest

from evaluator.model import EvaluationError
from evaluator.observe.waveforms import FWHM_PER_SIGMA, Echoes, decompose, model_packets

SAMPLES, WIDTH_NS, NOISE_DN, BASELINE_DN = 64, 4.27, 2.0, 61.3


def packets_of(
    rng: np.random.Generator,
    count: int,
    amplitude: list,
    centre_ns: list,
    *,
    shot: float = 0.0,
    baseline: float = BASELINE_DN,
) -> np.ndarray:
    """Rounded samples of Gaussian echoes at 1 ns: each list has one entry (scalar or (count,)) an echo."""
    t = np.arange(SAMPLES)
    signal = np.zeros((count, SAMPLES))
    for a, c in zip(amplitude, centre_ns, strict=True):
        z = (t - np.broadcast_to(c, (count,))[:, None]) / (WIDTH_NS / FWHM_PER_SIGMA)
        signal += np.broadcast_to(a, (count,))[:, None] * np.exp(-0.5 * z * z)
    noisy = baseline + signal + rng.normal(size=signal.shape) * np.sqrt(NOISE_DN**2 + shot * signal)
    return np.clip(np.round(noisy), 0, 65535).astype(np.uint16)


def cramer_rao(amplitude: float, centre_ns: float) -> np.ndarray:
    """Least standard deviation of A, centre and FWHM with the baseline unknown; numerical derivatives of the written model."""
    variance = NOISE_DN**2 + 1.0 / 12.0  # rounding to whole DN
    t = np.arange(SAMPLES)

    def model(p: np.ndarray) -> np.ndarray:
        return p[3] + p[0] * np.exp(-4.0 * np.log(2.0) * ((t - p[1]) / p[2]) ** 2)

    at = np.array([amplitude, centre_ns, WIDTH_NS, BASELINE_DN])
    steps = np.array([1e-2, 1e-5, 1e-5, 1e-2])
    columns = [(model(at + s) - model(at - s)) / (2.0 * s.sum()) for s in np.diag(steps)]
    jacobian = np.stack(columns, axis=1)
    return np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian / variance)))[:3]


@pytest.mark.parametrize("amplitude", [40.0, 1500.0])
def test_isolated_pulse_reaches_the_cramer_rao_bound(amplitude: float) -> None:
    """Rationale: an efficient estimator uses all that the samples hold. Expected: RMSE of amplitude, centre and width at most
    1.2 times the bound, and the stated standard deviation right. Tolerance: 20 %; 3000 packets scatter an RMSE by 1.3 %."""
    rng = np.random.default_rng(np.random.SeedSequence([8, 1, int(amplitude)]))
    count = 3000
    centre = rng.uniform(25.0, 35.0, count)
    found = decompose(packets_of(rng, count, [amplitude], [centre]), 1.0, echo_fwhm_ns=WIDTH_NS)
    assert np.array_equal(found.packet, np.arange(count))
    errors = np.stack([found.amplitude_dn - amplitude, found.centre_ns - centre, found.fwhm_ns - WIDTH_NS])
    stated = np.stack([found.amplitude_std_dn, found.centre_std_ns, found.fwhm_std_ns])
    bound = cramer_rao(amplitude, 30.2)
    assert (np.sqrt(np.mean(errors**2, axis=1)) <= 1.2 * bound).all()
    assert np.std(errors / stated, axis=1) == pytest.approx(np.ones(3), abs=0.1)
    assert found.noise.noise_dn == pytest.approx(np.hypot(NOISE_DN, 12**-0.5), rel=0.03)
    assert np.median(found.packet_chi2) == pytest.approx(1.0, abs=0.1)


def test_photon_noise_is_learnt_and_weighted() -> None:
    """Rationale: photon noise makes a constant-noise fit see second echoes everywhere. Expected: variance per DN near the
    0.06 put in, no packet with two echoes, stated deviations right. Tolerance: 25 % on the estimate of a variance whose
    lever is the echo's few samples; 10 % on the spread of z."""
    rng = np.random.default_rng(np.random.SeedSequence([8, 2]))
    count = 4000
    amplitude, centre = rng.uniform(100.0, 3500.0, count), rng.uniform(25.0, 35.0, count)
    data = packets_of(rng, count, [amplitude], [centre], shot=0.06)
    found = decompose(data, 1.0, echo_fwhm_ns=WIDTH_NS)
    assert np.array_equal(found.packet, np.arange(count))
    assert found.noise.shot_dn2_per_dn == pytest.approx(0.06, rel=0.25)
    assert np.std((found.amplitude_dn - amplitude) / found.amplitude_std_dn) == pytest.approx(1.0, abs=0.1)
    assert np.std((found.centre_ns - centre) / found.centre_std_ns) == pytest.approx(1.0, abs=0.1)


def _pairs(amplitude: float, separation: float, count: int) -> tuple[Echoes, np.ndarray]:
    rng = np.random.default_rng(np.random.SeedSequence([8, 3, int(amplitude)]))
    first = rng.uniform(26.0, 30.0, count)
    second = first + separation * WIDTH_NS
    data = packets_of(rng, count, [amplitude, amplitude], [first, second])
    found = decompose(data, 1.0, noise_dn=2.02, echo_fwhm_ns=WIDTH_NS, shot_dn2_per_dn=0.0, shape_error=0.0)
    return found, np.stack([first, second], axis=1)


def test_half_width_pair_is_one_echo_when_weak() -> None:
    """Rationale: two surfaces half a pulse apart are only a slightly wide echo; without significance one is right. Expected:
    at 30 times the noise fewer than 1 % of the packets are split, and the one range is the mean of both. Tolerance: 4 sigma
    of the mean."""
    found, truth = _pairs(60.0, 0.5, 1000)
    count = np.bincount(found.packet, minlength=1000)
    assert (count == 1).mean() > 0.99
    single = (count == 1)[found.packet]
    error = found.centre_ns[single] - truth.mean(axis=1)[found.packet[single]]
    assert abs(error.mean()) < 4.0 * error.std() / np.sqrt(error.size)


@pytest.mark.parametrize(("separation", "amplitude"), [(0.5, 6000.0), (1.2, 200.0)])
def test_pairs_are_resolved_without_bias(separation: float, amplitude: float) -> None:
    """Rationale: with signal enough the shape gives both surfaces away. Expected: two echoes in every packet, both centres
    unbiased and as scattered as stated. Tolerance: 4 sigma of the mean plus 0.003 ns (0.5 mm) for the second-order bias of
    a non-linear fit; 15 % on the spread."""
    count = 1000
    found, truth = _pairs(amplitude, separation, count)
    assert np.array_equal(found.packet, np.repeat(np.arange(count), 2))
    error = found.centre_ns.reshape(-1, 2) - truth
    assert (np.abs(error.mean(axis=0)) < 4.0 * error.std(axis=0) / np.sqrt(count) + 0.003).all()
    z = error / found.centre_std_ns.reshape(-1, 2)
    assert np.std(z, axis=0) == pytest.approx(np.ones(2), abs=0.15)
    assert found.significance.min() > np.sqrt(30.0)


def test_noise_alone_has_no_echo() -> None:
    """Rationale: the chi-square an echo must explain is set for one false echo in a million places. Expected: none in 2000
    packets of noise. Tolerance: one."""
    rng = np.random.default_rng(np.random.SeedSequence([8, 4]))
    assert decompose(packets_of(rng, 2000, [], []), 1.0, echo_fwhm_ns=WIDTH_NS).packet.size <= 1


def test_saturated_samples_are_left_out() -> None:
    """Rationale: a clipped peak still has flanks. Expected: amplitude within 2 % of 6000 DN although the digitiser ends at
    4095; the same packets fitted with their clipped samples are over 5 % low. Tolerance: 2 % = three standard deviations."""
    rng = np.random.default_rng(np.random.SeedSequence([8, 5]))
    data = np.minimum(packets_of(rng, 200, [6000.0], [30.3]), 4095)
    clipped = decompose(
        data, 1.0, noise_dn=2.0, echo_fwhm_ns=WIDTH_NS, shot_dn2_per_dn=0.0, shape_error=0.0, max_echoes=1
    )
    right = decompose(data, 1.0, echo_fwhm_ns=WIDTH_NS, saturation_dn=4095.0)
    assert np.array_equal(right.packet, np.arange(200))
    assert right.amplitude_dn == pytest.approx(np.full(200, 6000.0), rel=0.02)
    assert clipped.amplitude_dn.max() < 0.95 * 6000.0


def test_missing_samples_do_not_exist() -> None:
    """Rationale: packets of unequal length are padded with NaN. Expected: the very numbers of the short packet. Tolerance:
    none but the last digits of sums in another order."""
    rng = np.random.default_rng(np.random.SeedSequence([8, 6]))
    short = packets_of(rng, 50, [300.0], [25.0])[:, :48].astype(float)
    padded = np.hstack([short, np.full((50, 16), np.nan)])
    a = decompose(short, 1.0, noise_dn=2.0, echo_fwhm_ns=WIDTH_NS)
    b = decompose(padded, 1.0, noise_dn=2.0, echo_fwhm_ns=WIDTH_NS)
    assert b.centre_ns == pytest.approx(a.centre_ns, abs=1e-9)
    assert b.amplitude_dn == pytest.approx(a.amplitude_dn, abs=1e-6)


def test_same_bytes_for_any_threads_and_order() -> None:
    """Rationale: results.json must not depend on the machine. Expected: identical bytes with 1 and 2 threads, and packet by
    packet when their order is turned round. Tolerance: none."""
    rng = np.random.default_rng(np.random.SeedSequence([8, 7]))
    data = packets_of(rng, 1500, [400.0, rng.uniform(30.0, 300.0, 1500)], [22.0, rng.uniform(24.0, 40.0, 1500)])
    one = decompose(data, 1.0, echo_fwhm_ns=WIDTH_NS, threads=1)
    two = decompose(data, 1.0, echo_fwhm_ns=WIDTH_NS, threads=2)
    assert one.centre_ns.tobytes() == two.centre_ns.tobytes()
    assert one.amplitude_dn.tobytes() == two.amplitude_dn.tobytes()
    fixed = {"noise_dn": 2.0, "echo_fwhm_ns": WIDTH_NS, "shot_dn2_per_dn": 0.0, "shape_error": 0.0}
    forward, backward = decompose(data, 1.0, **fixed), decompose(data[::-1], 1.0, **fixed)
    order = np.lexsort((backward.centre_ns, 1499 - backward.packet))
    assert np.array_equal(forward.centre_ns, backward.centre_ns[order])


def test_units_and_symmetries() -> None:
    """Rationale: sampling is a unit, the baseline a shift, the DN a scale. Expected: half the sampling interval halves times
    and widths; 500 DN more of background change nothing; three times the DN give three times the amplitude. Tolerance: 1e-6
    relative, the fit's own stop."""
    rng = np.random.default_rng(np.random.SeedSequence([8, 8]))
    data = packets_of(rng, 40, [500.0], [30.0]).astype(float)
    fixed = {"shot_dn2_per_dn": 0.0, "shape_error": 0.0}
    base = decompose(data, 1.0, noise_dn=2.0, echo_fwhm_ns=WIDTH_NS, **fixed)
    half = decompose(data, 0.5, noise_dn=2.0, echo_fwhm_ns=0.5 * WIDTH_NS, **fixed)
    shifted = decompose(data + 500.0, 1.0, noise_dn=2.0, echo_fwhm_ns=WIDTH_NS, **fixed)
    scaled = decompose(3.0 * data, 1.0, noise_dn=6.0, echo_fwhm_ns=WIDTH_NS, **fixed)
    assert half.centre_ns == pytest.approx(0.5 * base.centre_ns, rel=1e-9)
    assert half.fwhm_ns == pytest.approx(0.5 * base.fwhm_ns, rel=1e-9)
    assert shifted.amplitude_dn == pytest.approx(base.amplitude_dn, rel=1e-6)
    assert scaled.amplitude_dn == pytest.approx(3.0 * base.amplitude_dn, rel=1e-6)
    residual = data - model_packets(base, 1.0, SAMPLES)
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(np.sqrt(np.mean(base.packet_rms_dn**2)), rel=1e-9)
    assert residual.std() == pytest.approx(NOISE_DN, rel=0.05)


def test_nothing_in_nothing_out() -> None:
    """Rationale: a strip without packets is legal. Expected: no echoes; a packet of NaN has neither baseline nor echo."""
    assert decompose(np.empty((0, SAMPLES)), 1.0).packet.size == 0
    empty = decompose(np.full((1, SAMPLES), np.nan), 1.0)
    assert empty.packet.size == 0
    assert np.isnan(empty.packet_baseline_dn[0])


@pytest.mark.parametrize(
    ("packets", "options", "word"),
    [
        (np.zeros(64), {}, "table"),
        (np.zeros((2, 64)), {"sampling_ns": 0.0}, "sampling_ns"),
        (np.zeros((2, 64)), {"echo_fwhm_ns": float("nan")}, "echo_fwhm_ns"),
        (np.zeros((2, 64)), {"noise_dn": -1.0}, "noise_dn"),
        (np.zeros((2, 64)), {"max_echoes": 99}, "max_echoes"),
        (np.full((2, 64), np.inf), {}, "infinite"),
    ],
)
def test_bad_input_is_one_line(packets: np.ndarray, options: dict, word: str) -> None:
    """Rationale: a user reads it. Expected: EvaluationError, one line, naming the culprit."""
    with pytest.raises(EvaluationError, match=word) as caught:
        decompose(packets, **{"sampling_ns": 1.0, **options})
    assert "\n" not in str(caught.value)
