"""The LiDAR's response constant, by the reference panels of 8.1 with the laboratory's figure beside it: has the gain changed?

Not asked for by the standard, whose surface f(A, L, R) is scaled by the panels themselves and takes any gain up without a word.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from campaign.sensors import LidarSheet
from campaign.survey import Spectra
from evaluator.c8_1_lidar_reflectance import reflectance_at
from evaluator.model import EvaluationError
from evaluator.observe.panels import LidarPanelObservation

# Extinction of the air near the ground, which no record of 7.2 tells: from none to a visibility of about 10 km. [1/m]
_EXTINCTION_PER_M, _EXTINCTION_STD_PER_M = 0.5e-4, 0.5e-4
_MIN_PANELS = 5
_DARKEST = 0.1  # an offset of the amplitude by half a step moves a darker panel by too much


@dataclass(frozen=True, kw_only=True)
class LidarResponse:
    """K of A = K R cos(incidence) / L^2, with what the laboratory stated of it."""

    constant_dn_m2: float
    relative_std: float  # of the panels' median and of the air
    stated_dn_m2: float
    stated_relative_std: float
    panels: int

    @property
    def gain(self) -> float:
        """Constant over the stated one."""
        return self.constant_dn_m2 / self.stated_dn_m2

    @property
    def gain_std(self) -> float:
        """Of `gain`, the laboratory's uncertainty with it."""
        return self.gain * float(np.hypot(self.relative_std, self.stated_relative_std))


def response_constant(
    amplitude_dn: np.ndarray, range_m: np.ndarray, reflectance: np.ndarray, cos_incidence: np.ndarray, panel: np.ndarray
) -> tuple[float, float, int]:
    r"""Median over panels of :math:`A L^2 e^{2 \alpha L} / (R \cos\iota)`, each panel's strips averaged in logarithms.

    Parameters
    ----------
    amplitude_dn : (n,) np.ndarray
        Peak above the baseline, linear. [DN]
    range_m : (n,) np.ndarray
        [m]
    reflectance, cos_incidence : (n,) np.ndarray
        Actual reflectance at the laser's line, 0 to 1; cosine of the incidence.
    panel : (n,) np.ndarray
        Which panel each belongs to.

    Returns
    -------
    float, float, int
        Constant [DN m2], its relative standard deviation (scatter of the panels and the air's extinction), panels.

    References
    ----------
    Wagner et al. (2006), ISPRS J. 60(2): radar equation of an extended Lambertian target; the sensor's factors are one constant.
    """
    log = (
        np.log(amplitude_dn)
        + 2.0 * np.log(range_m)
        + 2.0 * _EXTINCTION_PER_M * range_m
        - np.log(reflectance * cos_incidence)
    )
    means = np.array([log[panel == p].mean() for p in np.unique(panel)])
    middle = float(np.median(means))
    scatter = 1.4826 * float(np.median(np.abs(means - middle)))
    of_median = 1.2533 * scatter / np.sqrt(len(means))
    air = 2.0 * _EXTINCTION_STD_PER_M * float(np.mean(range_m))
    return float(np.exp(middle)), float(np.hypot(of_median, air)), len(means)


def lidar_response(
    observations: Sequence[LidarPanelObservation], spectra: Spectra | None, lidar: LidarSheet | None
) -> LidarResponse | None:
    """None without a stated constant, without waveforms, or with fewer than five panels of 10 % and more."""
    if spectra is None or lidar is None or lidar.response_constant_dn_m2 is None:
        return None
    try:
        known = {p: 0.01 * reflectance_at(spectra, p, lidar.wavelength_nm) for p in {o.panel for o in observations}}
    except EvaluationError:  # 8.1 says which spectrum is missing
        return None
    use = [o for o in observations if o.from_waveform and o.amplitude_dn > 0.0 and known[o.panel] >= _DARKEST]
    if len({o.panel for o in use}) < _MIN_PANELS:
        return None
    constant, std, panels = response_constant(
        np.array([o.amplitude_dn for o in use]),
        np.array([o.range_m for o in use]),
        np.array([known[o.panel] for o in use]),
        np.array([o.cos_incidence for o in use]),
        np.array([o.panel for o in use]),
    )
    return LidarResponse(
        constant_dn_m2=constant,
        relative_std=std,
        stated_dn_m2=lidar.response_constant_dn_m2,
        stated_relative_std=lidar.response_constant_std,
        panels=panels,
    )
