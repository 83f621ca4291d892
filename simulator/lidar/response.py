"""Response of the whole instrument, optics to digitiser, in one constant. Formulas of single steps: `radar_equation`."""

from campaign.config import Lidar
from simulator.lidar.radar_equation import echo_fwhm_ns, peak_power_w


def dn_per_w(lidar: Lidar) -> float:
    """Steps per watt of optical power: full-scale power reaches the last step from the baseline. [DN/W]"""
    return ((1 << lidar.bit_depth) - 1 - lidar.baseline_dn) / (lidar.full_scale_power_nw * 1e-9)


def response_constant_dn_m2(lidar: Lidar) -> float:
    """Peak of an echo of rho cos(alpha) = 1 at 1 m without air. [DN m2]

    The receiver lowers a pulse's peak and keeps its energy, hence the ratio of the two widths.
    """
    echo_ns = echo_fwhm_ns(lidar.pulse_fwhm_ns, lidar.receiver_fwhm_ns)
    peak_w = peak_power_w(lidar.pulse_energy_uj * 1e-6, lidar.pulse_fwhm_ns * 1e-9) * lidar.pulse_fwhm_ns / echo_ns
    return dn_per_w(lidar) * peak_w * lidar.aperture_diameter_m**2 * lidar.system_efficiency / 4.0
