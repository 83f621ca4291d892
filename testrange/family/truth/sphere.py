"""True RSD and s(x) of a series at the sphere: the lamp's output, the camera's response and the sensor's noise, by (3)-(6).

Formulas of the standard are written anew here, as are those of the noise (EMVA 1288).
"""

from typing import Literal

import numpy as np

from campaign.config import Config
from simulator.bench.sphere import REPEATABILITY, STABILITY, lamp_output, response
from simulator.randomness import Stream, generator

Series = Literal["stability", "repeatability"]
_PIXELS = 9  # 8.2.2 g


def pattern(count: int) -> np.ndarray:
    """A drift with a swing and a flicker on it, (count,): mean 0, standard deviation (5) of 1."""
    k = np.arange(count)
    t = k / max(count - 1, 1) - 0.5
    wave = 1.2 * t + 0.5 * np.sin(7.0 * t + 0.4) + 0.35 * (-1.0) ** k
    wave -= wave.mean()
    return np.asarray(wave / np.sqrt(np.sum(wave**2) / (count - 1)))


def gains(config: Config, amplitude_percent: float) -> tuple[float, ...]:
    """The camera's response, image by image."""
    return tuple(round(1.0 + amplitude_percent / 100.0 * float(p), 9) for p in pattern(config.bench.sphere.images))


def true_value(config: Config, series: Series) -> tuple[float, float, dict[str, float]]:
    r"""Expected value of formula (3) or (6), the standard uncertainty of one measurement of it, and what mistakes would give.

    .. math:: S = \sqrt{S_0^2 + \sigma^2},\quad
              u^2(S^2) = \frac{4 \sigma^2 \sum d_i^2 + 2 (n - 1) \sigma^4}{(n - 1)^2}

    with S_0 of the noise-free signals, d_i their deviations, and sigma the noise of the mean of nine pixels.

    Returns
    -------
    float, float, dict
        [%]
    """
    sphere, camera = config.bench.sphere, config.camera
    key = STABILITY if series == "stability" else REPEATABILITY
    count = np.arange(sphere.images)
    since_on = sphere.wait_s + sphere.stability_interval_s * count
    if series == "repeatability":
        since_on = since_on[-1] + sphere.stability_interval_s + sphere.repeatability_interval_s * count
    flicker = generator(config.seed, Stream.SPHERE, key).standard_normal(sphere.images)
    signal = lamp_output(sphere, since_on) * (1.0 + sphere.noise_percent / 100.0 * flicker) * response(config, key)
    mean = signal.mean()
    deviation = 100.0 * (signal - mean) / mean
    freedom = sphere.images - 1
    designed = float(np.sum(deviation**2)) / freedom
    # electrons in a pixel of the brightest band: the base gain maps full well to full scale
    electrons = sphere.exposure_share * camera.full_well_e
    step_e = camera.full_well_e / (2.0**camera.bit_depth - 1.0 - camera.black_level_dn)
    variance_e2 = electrons + camera.read_noise_e**2 + step_e**2 / 12.0
    noise = 1e4 * variance_e2 / electrons**2 / _PIXELS
    value = float(np.sqrt(designed + noise))
    squared = (4.0 * noise * float(np.sum(deviation**2)) + 2.0 * freedom * noise**2) / freedom**2
    full = 2.0**camera.bit_depth - 1.0 - camera.black_level_dn
    dn = sphere.exposure_share * full
    return (
        value,
        float(np.sqrt(squared) / (2.0 * value)),
        {
            "n in the place of n - 1": value * float(np.sqrt(freedom / sphere.images)),
            "in DN, not relative to the mean": value / 100.0 * dn,
            "black level not subtracted": value * dn / (dn + camera.black_level_dn),
        },
    )
