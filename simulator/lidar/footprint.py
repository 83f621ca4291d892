"""The beam's footprint as a fixed set of sub-rays: where they point and what share of the pulse each carries; and the optics."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from campaign.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """s sub-rays, the beam's axis first, then outwards. Weights add up to 1."""

    offset: np.ndarray  # (s, 2) slope against the beam's axis, along two axes across the beam [rad]
    weight: np.ndarray  # (s,) share of the pulse's energy
    spread_rad: float  # standard deviation about one axis, of the pattern and of the beam that it stands for


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Constants of one device and one state of the air."""

    footprint: Footprint
    echo_sigma_ns: float  # of pulse and receiver together
    sampling_ns: float
    samples: int
    pre_samples: int  # whole samples between the packet's first one and the nearest sub-ray's echo
    scale_dn_m2: float  # peak of an echo of rho cos(alpha) = 1 at 1 m without air [DN m2]
    extinction_per_m: float  # one way


def _rings(points: int, centre: bool) -> list[int]:
    """Even counts of at least 4, growing outwards like a disc's rings, that add up to `points` without the centre."""
    inner = 6 if centre else 4
    count = 1
    while sum(inner + 6 * k for k in range(count + 1)) <= points:
        count += 1
    ideal = np.array([inner + 6.0 * k for k in range(count)])
    sizes = [max(4, 2 * round(float(v) / 2)) for v in ideal * points / ideal.sum()]
    sizes[-1] += points - sum(sizes)
    return sizes


def gaussian_footprint(subrays: int, divergence_rad: float) -> Footprint:
    r"""Sub-rays on rings about the axis for a Gaussian beam.

    Every ring stands for the annulus around it and carries the Gaussian's energy in that annulus, shared equally by its
    points. The distance between rings is chosen so that the pattern's second moment is the Gaussian's own,
    :math:`\langle\theta_x^2\rangle = (\gamma/4)^2` an axis, so that a tilted surface broadens an echo by exactly what the
    closed form says. The pattern equals itself turned by 180 degrees: a slope gives no range bias.

    Parameters
    ----------
    subrays : int
        1 (a line without width), or 4 and more; 1, 7, 19, 37, 61 ... fill hexagonal rings.
    divergence_rad : float
        Full angle gamma at 1/e^2 of the peak irradiance. [rad]

    Returns
    -------
    Footprint
        `subrays` rows when that is odd; one more, the axis with weight 0, when it is even: the axis is always traced.

    Raises
    ------
    ConfigError
        2 or 3 sub-rays, which cannot be both symmetric and round.
    """
    if subrays in (2, 3):
        raise ConfigError(
            "this many sub-rays cannot stand for a round beam",
            where="lidar.subrays",
            got=subrays,
            expected="1, or 4 and more",
            remedy="set 7 or 19",
        )
    if subrays == 1:
        return Footprint(offset=np.zeros((1, 2)), weight=np.ones(1), spread_rad=0.0)
    centre = subrays % 2 == 1
    sizes = _rings(subrays - centre, centre)
    number = np.arange(len(sizes)) + (1.0 if centre else 0.5)  # radius in units of the rings' distance
    edge = np.append(np.concatenate([number - 0.5]), np.inf)

    def shares(step: float) -> np.ndarray:
        """Energy inside each ring's annulus; u = 2 (theta / half divergence)^2 is distributed as exp(-u)."""
        beyond = np.exp(-2.0 * (edge * step) ** 2)
        return np.asarray(beyond[:-1] - beyond[1:])

    def excess(step: float) -> float:
        return float(np.sum(shares(step) * 2.0 * (number * step) ** 2)) - 1.0

    top = 0.05
    while excess(top) < 0.0:
        top *= 1.1
    step = float(brentq(excess, top / 1.1, top, xtol=1e-14))
    share = shares(step)
    offsets, weights = [np.zeros((1, 2))], [np.array([1.0 - share.sum() if centre else 0.0])]
    for ring, size in enumerate(sizes):
        half = np.pi * (np.arange(size // 2) + 0.5 * (ring % 2)) / (size // 2)
        points = number[ring] * step * np.stack([np.cos(half), np.sin(half)], axis=-1)
        offsets += [points, -points]
        weights.append(np.full(size, share[ring] / size))
    return Footprint(
        offset=np.concatenate(offsets) * 0.5 * divergence_rad,
        weight=np.concatenate(weights),
        spread_rad=0.25 * divergence_rad,
    )
