"""The decomposition on two instruments' own waveforms. The data stay outside the project: skipped where they are absent.

Leica: airborne, 256 samples of 8 bits at 2 ns, returns found by the maker's own detector. NEON: full waveforms at 1 ns of a
system whose pulse is no Gaussian (its impulse response has a long tail).
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from campaign.flight.las import StripReader
from evaluator.observe.waveforms import decompose

REAL = Path(__file__).parents[3] / "shared" / "real"
RANGE_M_PER_NS = 0.299792458 / 2.0


@pytest.mark.skipif(not (REAL / "waveform_leica").is_dir(), reason=f"no real waveforms at {REAL / 'waveform_leica'}")
def test_leica_returns(record_property: Callable[[str, object], None]) -> None:
    """Rationale: the returns of a maker's detector are an outside opinion. Expected: an echo for every return; after one
    constant (the detector's own offset, 0.76 ns = 0.114 m) the ranges agree: median 5 cm, 95 % 0.36 m, a fifth of the pulse
    (11 ns = 1.7 m); where both found one echo alone: 2.5 cm and 12 cm. Tolerance: a tenth above these figures; a
    sample is 0.30 m. What remains grows with the width of the echo (0.5 m at twice the width): the device times the rising
    flank of echoes that slopes and branches widen, where the decomposition gives their middle."""
    reader = StripReader(REAL / "waveform_leica" / "fwf_plain.las")
    returns = next(reader.chunks())[1]
    numbers = np.unique(returns.packet)
    row = np.searchsorted(numbers, returns.packet)
    echoes = decompose(reader.waveforms(numbers), reader.sampling_ps / 1000.0, echo_fwhm_ns=11.1)
    place_ns = returns.return_location_ps / 1000.0
    span = 1e7
    keys, wanted = echoes.packet * span + echoes.centre_ns, row * span + place_ns
    right = np.clip(np.searchsorted(keys, wanted), 1, keys.size - 1)
    nearest = np.where(wanted - keys[right - 1] < keys[right] - wanted, right - 1, right)
    assert (echoes.packet[nearest] == row).all()
    difference_ns = echoes.centre_ns[nearest] - place_ns
    offset_ns = float(np.median(difference_ns))
    remaining_m = np.abs(difference_ns - offset_ns) * RANGE_M_PER_NS
    single = (returns.number_of_returns == 1) & (np.bincount(echoes.packet, minlength=numbers.size)[row] == 1)
    figures = {
        "returns": returns.packet.size,
        "echoes": echoes.packet.size,
        "offset_ns": offset_ns,
        "median_m": float(np.median(remaining_m)),
        "p95_m": float(np.quantile(remaining_m, 0.95)),
        "single": int(single.sum()),
        "single_median_m": float(np.median(remaining_m[single])),
        "single_p95_m": float(np.quantile(remaining_m[single], 0.95)),
    }
    print(figures)
    record_property("leica", str(figures))
    assert figures["returns"] == 2250
    assert offset_ns == pytest.approx(0.76, abs=0.1)
    assert figures["median_m"] < 0.058
    assert figures["p95_m"] < 0.40
    assert figures["single"] > 900
    assert figures["single_median_m"] < 0.028
    assert figures["single_p95_m"] < 0.14


@pytest.mark.skipif(not (REAL / "waveform_neon").is_dir(), reason=f"no real waveforms at {REAL / 'waveform_neon'}")
def test_neon_residuals(record_property: Callable[[str, object], None]) -> None:
    """Rationale: a pulse that is no Gaussian must be met by several. Expected: the residual of at least 95 % of the 500 packets
    is at the noise. The noise is what the first eight samples, before any echo, scatter: 2.1 DN (median over the packets),
    on echoes of hundreds of DN. Tolerance: 1.5 times the noise, because the quiet samples are only eight and the tail rings."""
    packets = np.load(REAL / "waveform_neon" / "neon.npz")["returned"]
    packets = np.where(packets == 0.0, np.nan, packets)  # zeros pad packets of unequal length
    noise_dn = float(np.median(packets[:, :8].std(axis=1)))
    echoes = decompose(
        packets,
        1.0,
        noise_dn=noise_dn,
        echo_fwhm_ns=8.0,
        shot_dn2_per_dn=0.0,
        shape_error=0.0,
        least_separation=0.0,
        max_echoes=8,
    )
    share = float(np.mean(echoes.packet_rms_dn <= 1.5 * noise_dn))
    height = np.nanmax(packets, axis=1) - np.nanmin(packets, axis=1)
    figures = {
        "noise_dn": noise_dn,
        "median_height_dn": float(np.median(height)),
        "median_rms_dn": float(np.median(echoes.packet_rms_dn)),
        "p95_rms_dn": float(np.quantile(echoes.packet_rms_dn, 0.95)),
        "share_at_noise": share,
        "components": echoes.packet.size / packets.shape[0],
    }
    print(figures)
    record_property("neon", str(figures))
    assert noise_dn == pytest.approx(2.1, abs=0.1)
    assert share >= 0.95
