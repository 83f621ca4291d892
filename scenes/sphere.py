"""The integrating sphere of 8.2.2 as plain data: wall, port, lamp, baffle, where the camera stands; and the lamp's spectrum.

Axes are the camera's (x right, y down, z forward), the origin is the sphere's centre: the port lies at -z, the camera looks
through it along +z. The lamp is above the port, outside what can be seen. How light goes round is the renderer's affair.
"""

from dataclasses import dataclass, replace

import numpy as np

from campaign.config import Band, Camera, Sphere
from campaign.errors import ConfigError

PLANCK_J_S = 6.62607015e-34
LIGHT_M_S = 299792458.0
BOLTZMANN_J_K = 1.380649e-23
STEFAN_BOLTZMANN = 5.670374419e-8  # [W m-2 K-4]
# Of the picture's half diagonal (tangent): the port's rim stays outside the picture, distortion included.
FIELD_MARGIN = 1.1
# From the port's plane to the camera, in radii of the port: the first at which everything fits.
CLOSE = (0.5, 0.25, 0.1)
LAMP_PLACES = (0.5, 0.6, 0.7, 0.4, 0.8, 0.3)  # between the rim of the wall in sight and the port's rim
SHADOW_MARGIN = 1.03  # of the baffle's radius that just hides the lamp from everything in sight
BAFFLE_STEPS = (2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)  # distances from the lamp that are tried, in radii of the lamp
INSIDE = 0.995  # the baffle keeps within this part of the sphere's radius


@dataclass(frozen=True, kw_only=True)
class Baffle:
    """A thin disc, the wall's paint on both sides."""

    centre_m: np.ndarray  # (3,)
    normal: np.ndarray  # (3,) unit, away from the lamp
    radius_m: float


@dataclass(frozen=True, kw_only=True)
class SphereScene:
    """Port and lamp are caps of the sphere, given by their half angles at its centre. Neither sends light back: the room
    outside the port is dark and the lamp's face is black.

    The flat lamp closes its cap. It has one radiance in all directions, so from inside it cannot be told from the cap
    behind it with the same radiance.
    """

    radius_m: float
    wall_reflectance: float
    port_half_angle_rad: float
    lamp_half_angle_rad: float
    lamp_direction: np.ndarray  # (3,) unit, from the sphere's centre
    baffle: Baffle | None
    camera_m: np.ndarray  # (3,) entrance pupil

    @property
    def area_m2(self) -> float:
        """Of the whole sphere, port and lamp included."""
        return 4 * np.pi * self.radius_m**2

    @property
    def port_share(self) -> float:
        """Part of the sphere's area that the port takes."""
        return float(np.sin(0.5 * self.port_half_angle_rad) ** 2)

    @property
    def lamp_share(self) -> float:
        """Part of the sphere's area that the lamp's cap takes."""
        return float(np.sin(0.5 * self.lamp_half_angle_rad) ** 2)

    @property
    def lamp_area_m2(self) -> float:
        """Of the flat lamp."""
        return float(np.pi * (self.radius_m * np.sin(self.lamp_half_angle_rad)) ** 2)


def build_sphere(sphere: Sphere, camera: Camera) -> SphereScene:
    """Place port, camera, lamp and baffle.

    The camera stands close in front of the port, which fills its whole picture (not only a window of it). The lamp is
    between the port's rim and the rim of the wall in the picture, half-way if that fits; the baffle hides it from all of
    that wall.

    Raises
    ------
    ConfigError
        A port or lamp as wide as the sphere, a lens too wide, no room for lamp or baffle.
    """
    radius = 0.5 * sphere.diameter_m
    for name, diameter in (("port", sphere.port_diameter_m), ("lamp", sphere.lamp_diameter_m)):
        if diameter > 0.7 * sphere.diameter_m:
            raise ConfigError(
                "does not fit into the sphere",
                where=f"bench.sphere.{name}_diameter_m",
                got=diameter,
                expected=f"at most {0.7 * sphere.diameter_m:g} m, 70 % of diameter_m",
            )
    port, lamp = (float(np.arcsin(d / sphere.diameter_m)) for d in (sphere.port_diameter_m, sphere.lamp_diameter_m))
    half_field = float(np.arctan(FIELD_MARGIN * _tangent_of_corner(camera)))
    room = 0.0
    for close in CLOSE:
        behind = 0.5 * sphere.port_diameter_m * min(close, 1 / float(np.tan(half_field)))
        camera_m = np.array([0.0, 0.0, -radius * np.cos(port) - behind])
        # The outermost ray, margin included, meets the wall at this angle from the point opposite the port.
        seen = half_field + float(np.arcsin(np.clip(-camera_m[2] / radius * np.sin(half_field), -1.0, 1.0)))
        for part in LAMP_PLACES:
            between = np.pi - port - seen
            room = max(room, float(between))
            if between * min(part, 1 - part) < lamp:
                continue
            angle = seen + part * between
            scene = SphereScene(
                radius_m=radius,
                wall_reflectance=sphere.wall_reflectance,
                port_half_angle_rad=port,
                lamp_half_angle_rad=lamp,
                lamp_direction=np.array([0.0, -np.sin(angle), np.cos(angle)]),
                baffle=None,
                camera_m=camera_m,
            )
            baffle = _baffle(scene, seen, half_field) if sphere.baffle else None
            if baffle is not None or not sphere.baffle:
                return replace(scene, baffle=baffle)
    if room < 2 * lamp:
        raise ConfigError(
            "no place for the lamp between the port and the wall that the camera sees",
            where="bench.sphere.lamp_diameter_m",
            got=sphere.lamp_diameter_m,
            expected=f"at most {sphere.diameter_m * np.sin(0.5 * room):.3f} m for this lens",
            remedy="a smaller lamp or port, or a lens with a narrower field",
        )
    raise ConfigError(
        "no baffle fits between the lamp and the wall that the camera sees",
        where="bench.sphere.baffle",
        remedy="a smaller lamp or port, a lens with a narrower field, or baffle = false",
    )


def _tangent_of_corner(camera: Camera) -> float:
    lens = camera.lens
    x = max(lens.cx_px, camera.width_px - lens.cx_px) / lens.fx_px
    y = max(lens.cy_px, camera.height_px - lens.cy_px) / lens.fy_px
    return float(np.hypot(x, y))


def _baffle(scene: SphereScene, seen: float, half_field: float) -> Baffle | None:
    """The nearest disc before the lamp that hides all of it, fits into the sphere and does not stand in the picture."""
    turn = np.linspace(0.0, 2 * np.pi, 96, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
    rim = scene.radius_m * (np.sin(seen) * ring + [0.0, 0.0, np.cos(seen)])  # of the wall in sight
    up, across = scene.lamp_direction, np.array([1.0, 0.0, 0.0])
    edge_m = scene.radius_m * np.sin(scene.lamp_half_angle_rad)
    centre = scene.radius_m * np.cos(scene.lamp_half_angle_rad) * up
    lamp = centre + edge_m * (ring[:, :1] * across + ring[:, 1:2] * np.cross(up, across))
    ends = np.stack([rim[np.argmin(rim[:, 1])], rim[np.argmax(rim[:, 1])]]) - centre
    axis = (ends / np.linalg.norm(ends, axis=1, keepdims=True)).sum(axis=0)
    axis /= np.linalg.norm(axis)
    side = np.cross(axis, across)
    line = rim[None] - lamp[:, None]  # from every point of the lamp's rim to every one of the wall's
    for step in BAFFLE_STEPS:
        middle = centre + step * edge_m * axis
        share = ((middle - lamp) @ axis)[:, None] / (line @ axis)
        if not ((share > 0) & (share < 1)).all():
            continue
        crossing = lamp[:, None] + share[..., None] * line - middle
        # The shadow is not round about `middle`: centre the disc on it.
        along = crossing @ side
        middle = middle + 0.5 * (along.min() + along.max()) * side
        radius = SHADOW_MARGIN * float(
            np.linalg.norm(crossing - 0.5 * (along.min() + along.max()) * side, axis=-1).max()
        )
        border = middle + radius * (ring[:, :1] * across + ring[:, 1:2] * side)
        from_camera = border - scene.camera_m
        off_axis = np.arctan2(np.hypot(from_camera[:, 0], from_camera[:, 1]), from_camera[:, 2])
        if np.linalg.norm(border, axis=1).max() < INSIDE * scene.radius_m and off_axis.min() > half_field:
            return Baffle(centre_m=middle, normal=axis, radius_m=radius)
    return None


def black_body_share_per_nm(temperature_k: float, wavelength_nm: np.ndarray) -> np.ndarray:
    r"""Spectral density of a black body's radiation, its integral over all wavelengths one.

    .. math:: \frac{1}{\sigma T^4} \frac{2 \pi h c^2}{\lambda^5 \left(e^{h c / \lambda k T} - 1\right)}

    Parameters
    ----------
    temperature_k : float
        [K]
    wavelength_nm : (w,) ndarray
        [nm]

    Returns
    -------
    (w,) ndarray
        [nm-1]

    References
    ----------
    Planck's law; the constants are those of the SI (2019), the Stefan-Boltzmann constant that of CODATA 2018.
    """
    metre = np.asarray(wavelength_nm, float) * 1e-9
    exponent = PLANCK_J_S * LIGHT_M_S / (metre * BOLTZMANN_J_K * temperature_k)
    exitance = 2 * np.pi * PLANCK_J_S * LIGHT_M_S**2 / metre**5 / np.expm1(exponent)
    return np.asarray(exitance * 1e-9 / (STEFAN_BOLTZMANN * temperature_k**4))


def lamp_flux_per_nm(sphere: Sphere, band: Band) -> float:
    """Spectral flux of the warm lamp, averaged over a band's Gaussian response. [W nm-1]"""
    sigma = band.fwhm_nm / np.sqrt(8 * np.log(2))
    nm = band.centre_nm + sigma * np.linspace(-4.0, 4.0, 401)
    nm = nm[nm > 200.0]  # a lamp sends next to nothing there; the widest bands reach below zero
    response = np.exp(-0.5 * ((nm - band.centre_nm) / sigma) ** 2)
    share = black_body_share_per_nm(sphere.lamp_temperature_k, nm)
    return sphere.lamp_power_w * float(np.sum(share * response) / np.sum(response))
