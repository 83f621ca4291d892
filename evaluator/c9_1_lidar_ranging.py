"""Clause 9.1: what the total station's distances need before they serve as relative true values: formula (12).

The group refractive index is IUGG's of 1999; the standard leaves the formula to the instrument's manual.
"""

import numpy as np

from evaluator.model import EvaluationError


def saturation_pressure_hpa(temperature_c: float) -> float:
    """Saturation vapour pressure over water by the Magnus formula; 0.3 % from -20 to 40 degrees. [hPa]

    References
    ----------
    WMO-No. 8, Guide to Instruments and Methods of Observation, annex 4.B.
    """
    return float(6.112 * np.exp(17.62 * temperature_c / (243.12 + temperature_c)))


def group_refractive_index(
    wavelength_um: float, temperature_c: float, pressure_hpa: float, relative_humidity_percent: float
) -> float:
    r"""Group refractive index of air n_g for a carrier wavelength.

    .. math:: N_{gr} = 287.6155 + 4.88660/\lambda^2 + 0.06800/\lambda^4, \quad
              N = \frac{273.15}{1013.25} N_{gr} \frac{p}{T} - 11.27 \frac{e}{T}, \quad n = 1 + N \cdot 10^{-6}

    Parameters
    ----------
    wavelength_um : float
        Carrier wavelength of the distance meter, 0.3 to 2. [um]
    temperature_c : float
        -40 to 60. [deg C]
    pressure_hpa : float
        500 to 1100. [hPa]
    relative_humidity_percent : float
        [%]

    Returns
    -------
    float
        Dimensionless; the standard's "in percent" cannot be meant.

    Raises
    ------
    EvaluationError
        A value outside its range.

    References
    ----------
    IUGG, Resolution 3 of the XXII General Assembly, Birmingham 1999. GB/T 41450-2022, 9.1.2 e.
    """
    for name, value, low, high in (
        ("wavelength_um", wavelength_um, 0.3, 2.0),
        ("temperature_c", temperature_c, -40.0, 60.0),
        ("pressure_hpa", pressure_hpa, 500.0, 1100.0),
        ("relative_humidity_percent", relative_humidity_percent, 0.0, 100.0),
    ):
        if not low <= value <= high:
            raise EvaluationError(f"{name} is out of range", got=value, expected=f"{low:g} to {high:g}")
    standard = 287.6155 + 4.88660 / wavelength_um**2 + 0.06800 / wavelength_um**4
    kelvin = 273.15 + temperature_c
    vapour = saturation_pressure_hpa(temperature_c) * relative_humidity_percent / 100.0
    refractivity = 273.15 / 1013.25 * standard * pressure_hpa / kelvin - 11.27 * vapour / kelvin
    return 1.0 + refractivity * 1e-6


def meteorological_correction(distance_m: float, reference_index: float, group_index: float) -> float:
    """Correction of a slope distance for the air it was measured in, formula (12): S (n_0 - n_g) / n_g.

    Parameters
    ----------
    distance_m : float
        Slope distance as read, S. [m]
    reference_index : float
        n_0 of the instrument's design; dimensionless, near 1.0003.
    group_index : float
        n_g of the air at work; dimensionless.

    Returns
    -------
    float
        Delta D, to be added to S. [m]

    Raises
    ------
    EvaluationError
        An index that is none of air, or a distance that is not positive.

    References
    ----------
    GB/T 41450-2022, 9.1.2 e, formula (12).
    """
    if not (np.isfinite(distance_m) and distance_m > 0.0):
        raise EvaluationError("formula (12): the distance is not a positive number", got=distance_m)
    for name, value in (("n_0", reference_index), ("n_g", group_index)):
        if not 1.0 <= value <= 1.001:
            raise EvaluationError(
                f"formula (12): {name} is no refractive index of air", got=value, expected="1 to 1.001"
            )
    return distance_m * (reference_index - group_index) / group_index
