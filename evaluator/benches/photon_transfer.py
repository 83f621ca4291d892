"""Gain of the camera by photon transfer, from pairs of images of the integrating sphere: what its own noise says of its DN.

Not asked for by the standard; it is the one figure that tells a changed gain from a changed light. EMVA 1288's flat pairs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from campaign.benches.bench import SphereExposure
from campaign.benches.pictures import read_picture
from campaign.errors import TestrangeError
from evaluator.model import CampaignData

_SIDE_PX = 256  # of the window about the middle: flat light, few bytes
_PAIRS = 10
_LEAST_PIXELS = 1000
_QUANTISATION = 1.0 / 12.0  # [DN^2]


@dataclass(frozen=True, kw_only=True)
class PhotonTransfer:
    """Electrons for one DN, measured and as the log states it."""

    gain_e_per_dn: float
    std_e_per_dn: float
    stated_e_per_dn: float | None
    dark_variance_dn2: (
        float | None
    )  # of what is not photons: read noise, dark current, quantising; None: one level only
    pairs: int


def gain_from_pairs(
    mean_dn: np.ndarray, variance_dn2: np.ndarray, std_dn2: np.ndarray
) -> tuple[float, float, float | None]:
    r"""Straight line through variance over mean, :math:`\sigma^2 = c + \mu / K`, by weighted least squares.

    Parameters
    ----------
    mean_dn, variance_dn2 : (n,) np.ndarray
        Mean above the black level and temporal variance of single pixels, one pair and channel each. [DN], [DN^2]
    std_dn2 : (n,) np.ndarray
        Standard deviation of each variance. [DN^2]

    Returns
    -------
    float, float, float or None
        K and its standard deviation [e/DN], c [DN^2]. Where all means are within 20 % of each other c is taken for quantising
        alone and returned as None.

    References
    ----------
    EMVA Standard 1288, release 4.0 Linear, 2.3 and 6.6.
    """
    weight = 1.0 / std_dn2
    spread = mean_dn.max() > 1.2 * mean_dn.min()
    columns = [mean_dn, np.ones_like(mean_dn)] if spread else [mean_dn]
    target = variance_dn2 if spread else variance_dn2 - _QUANTISATION
    design = np.stack(columns, axis=1) * weight[:, None]
    inverse = np.linalg.inv(design.T @ design)
    found = inverse @ (design.T @ (target * weight))
    slope, std = float(found[0]), float(np.sqrt(inverse[0, 0]))
    return 1.0 / slope, std / slope**2, float(found[1]) if spread else None


def photon_transfer(data: CampaignData) -> PhotonTransfer | None:
    """Gain from the repeatability series (else the stability series); None where no two images of one setting serve.

    Parameters
    ----------
    data : CampaignData
        Images are read anew: a window of at most 256 x 256 px about the middle of each.
    """
    for folder, log in (
        (data.folder.sphere_repeatability, data.bench.repeatability),
        (data.folder.sphere_stability, data.bench.stability),
    ):
        rows = [
            r for r in log if r.gain_e_per_dn == log[0].gain_e_per_dn and r.exposure_time_s == log[0].exposure_time_s
        ]
        windows = []
        for row in rows[: 2 * _PAIRS]:
            try:
                windows.append(_window(read_picture(data.folder.held(folder / row.image)), data))
            except TestrangeError:
                continue
        found = _from_windows(windows, rows)
        if found is not None:
            return found
    return None


def _window(picture: np.ndarray, data: CampaignData) -> np.ndarray | None:
    """(k, k, bands) above black about the middle; None for 8-bit pictures, which are not linear, and saturated ones."""
    if picture.dtype != np.uint16 or data.camera is None:
        return None
    h, w = picture.shape[:2]
    side = min(_SIDE_PX, h, w)
    block = picture[(h - side) // 2 : (h + side) // 2, (w - side) // 2 : (w + side) // 2]
    if int(block.max()) >= 2**data.camera.bit_depth - 1:
        return None
    return np.asarray(block.astype(np.float64) - data.camera.black_level_dn)


def _from_windows(windows: Sequence[np.ndarray | None], rows: Sequence[SphereExposure]) -> PhotonTransfer | None:
    means, variances, stds, pairs = [], [], [], 0
    for a, b in zip(windows[::2], windows[1::2]):
        if a is None or b is None or a.shape != b.shape or a[..., 0].size < _LEAST_PIXELS:
            continue
        mean_a, mean_b = a.mean(axis=(0, 1)), b.mean(axis=(0, 1))
        if not (np.all(mean_a > 0.0) and np.all(mean_b > 0.0)):
            continue
        middle = 0.5 * (mean_a + mean_b)
        # the lamp's flicker scales a whole image
        difference = a * (middle / mean_a) - b * (middle / mean_b)
        variance = 0.5 * difference.var(axis=(0, 1), ddof=1)
        if np.any(variance <= _QUANTISATION):
            continue
        means.append(middle)
        variances.append(variance)
        stds.append(variance * np.sqrt(2.0 / (a[..., 0].size - 1)))
        pairs += 1
    if not pairs:
        return None
    gain, std, dark = gain_from_pairs(np.concatenate(means), np.concatenate(variances), np.concatenate(stds))
    if not (np.isfinite(gain) and gain > 0.0):
        return None
    return PhotonTransfer(
        gain_e_per_dn=gain,
        std_e_per_dn=std,
        stated_e_per_dn=rows[0].gain_e_per_dn,
        dark_variance_dn2=dark,
        pairs=pairs,
    )
