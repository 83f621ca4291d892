"""What a LiDAR receives from an extended target: pure formulas, no geometry and no scene.

`simulator.pulses.cone` evaluates the same product for what a footprint sees, `simulator.render.waveforms` for every sub-ray, as the
reference; one pulse is worked through by hand in docs/radar_equation.md, and tests compare them.
"""

import math

import numpy as np

SPEED_OF_LIGHT_M_S = 299_792_458.0
FWHM_PER_SIGMA = 2.0 * math.sqrt(2.0 * math.log(2.0))


def echo_fwhm_ns(pulse_fwhm_ns: float, receiver_fwhm_ns: float) -> float:
    """Full width at half maximum of the echo of a flat target at normal incidence: pulse and receiver in quadrature.

    Parameters
    ----------
    pulse_fwhm_ns : float
        Emitted pulse, Gaussian in time. [ns]
    receiver_fwhm_ns : float
        Impulse response of detector and amplifier, Gaussian. [ns]

    Returns
    -------
    float
        [ns]
    """
    return math.hypot(pulse_fwhm_ns, receiver_fwhm_ns)


def peak_power_w(energy_j: float, fwhm_s: float) -> float:
    r"""Peak power of a Gaussian pulse, :math:`P_e = E \sqrt{4 \ln 2 / \pi} / \mathrm{FWHM}`.

    Parameters
    ----------
    energy_j : float
        Energy of the pulse. [J]
    fwhm_s : float
        Full width at half maximum. [s]

    Returns
    -------
    float
        [W]
    """
    return energy_j * math.sqrt(4.0 * math.log(2.0) / math.pi) / fwhm_s


def received_power_w(
    peak_power_w: float,
    range_m: float | np.ndarray,
    reflectance: float | np.ndarray,
    cos_incidence: float | np.ndarray,
    aperture_diameter_m: float,
    system_efficiency: float,
    atmospheric_transmission: float | np.ndarray,
) -> float | np.ndarray:
    r"""Received peak power of an extended target, :math:`P_r = P_e D^2 \rho \cos\alpha\,\eta_{sys}\,\eta_{atm} / (4 R^2)`.

    Parameters
    ----------
    peak_power_w : float
        Emitted peak power P_e. [W]
    range_m : (n,) array_like
        R; the exponent is -2 because the whole beam falls on the target. [m]
    reflectance : (n,) array_like
        rho = pi times the BRDF in the backscatter direction; of a Lambertian surface its hemispherical reflectance. [1]
    cos_incidence : (n,) array_like
        Cosine of the angle between beam and surface normal. [1]
    aperture_diameter_m : float
        D, of the receiver. [m]
    system_efficiency : float
        Transmitter and receiver optics together. [1]
    atmospheric_transmission : (n,) array_like
        Two-way, see `two_way_transmission`. [1]

    Returns
    -------
    (n,) ndarray or float
        Optical power before the receiver's own response. [W]

    References
    ----------
    Hoefle, B., Pfeifer, N. (2007): Correction of laser scanning intensity data: data and model-driven approaches. ISPRS
    J. Photogramm. 62(6), doi:10.1016/j.isprsjprs.2007.05.008, eq. (3) with a circular aperture.
    """
    geometry = aperture_diameter_m**2 / (4.0 * np.square(range_m))
    return peak_power_w * geometry * reflectance * cos_incidence * system_efficiency * atmospheric_transmission


def extinction_per_km(wavelength_um: float, visibility_km: float) -> float:
    r"""Extinction of haze and fog, :math:`\alpha = (3.912 / V)\,(\lambda / 0.55)^{-q(V)}`, with Kim's exponent q.

    Parameters
    ----------
    wavelength_um : float
        Laser wavelength. [µm]
    visibility_km : float
        Meteorological range V at 0.55 µm and 2 % contrast. [km]

    Returns
    -------
    float
        One way, power. [1/km]

    Notes
    -----
    Above 6 km Kim's q is Kruse's; below, Kruse's 0.585 V^(1/3) overstates how well long wavelengths pass through fog.

    References
    ----------
    Kim, I. I., McArthur, B., Korevaar, E. (2001): Comparison of laser beam propagation at 785 nm and 1550 nm in fog and
    haze. Proc. SPIE 4214, doi:10.1117/12.417512.
    """
    if visibility_km > 50.0:
        q = 1.6
    elif visibility_km > 6.0:
        q = 1.3
    elif visibility_km > 1.0:
        q = 0.16 * visibility_km + 0.34
    elif visibility_km > 0.5:
        q = visibility_km - 0.5
    else:
        q = 0.0
    return 3.912 / visibility_km * math.pow(wavelength_um / 0.55, -q)


def two_way_transmission(range_m: float | np.ndarray, extinction_per_km: float) -> float | np.ndarray:
    """exp(-2 alpha R) with alpha in 1/km and R in metres.

    Parameters
    ----------
    range_m : (n,) array_like
        [m]
    extinction_per_km : float
        [1/km]

    Returns
    -------
    (n,) ndarray or float
        [1]
    """
    out: float | np.ndarray = np.exp(-2.0e-3 * extinction_per_km * np.asarray(range_m, np.float64))
    return out


def unambiguous_range_m(pulse_interval_s: float) -> float:
    """Largest range whose echo returns before the same receiver's next pulse leaves, c T / 2.

    Parameters
    ----------
    pulse_interval_s : float
        Between two pulses of one receiver. [s]

    Returns
    -------
    float
        [m]
    """
    return 0.5 * SPEED_OF_LIGHT_M_S * pulse_interval_s
