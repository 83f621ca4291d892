"""Which part of the ground both sensors see from the lowest planned height, on every heading (6.2.3).

Closed forms on a level plane: the lens's distortion (about 1 % of the field) and the nominal lever arms (centimetres)
are left to the margin. Where targets stand inside the field is `layout`'s subject.
"""

import numpy as np

from campaign.config import Config
from campaign.errors import ConfigError
from scenes.frustums import PLATE_THICKNESS_M, top_m
from scenes.model import Layout

WOBBLE_SIGMAS = 3.0
CONE_DEG = 45.0  # 6.2.3 a, read as half angle


def _highest_m(config: Config, half_m: float) -> float:
    """Bound on the height of any target's top above the world's origin, for targets within +-half_m. [m]"""
    frustums, panels, site = config.targets.frustums, config.targets.panels, config.site
    tops = [panels.stand_height_m + panels.thickness_m]
    if frustums.count:
        tops.append(max(frustums.stand_heights_m, default=0.0) + PLATE_THICKNESS_M + top_m(frustums))
    if config.targets.boards.count:
        tops.append(config.targets.boards.stand_height_m + config.targets.boards.thickness_m)
    fall = np.radians(site.slope_azimuth_deg)
    rise = np.tan(np.radians(site.slope_deg)) * half_m * (abs(np.sin(fall)) + abs(np.cos(fall)))
    return float(max(tops) + rise + WOBBLE_SIGMAS * site.relief_m)


def _line_offset_m(config: Config, height_m: float, tan_lidar: float) -> float:
    """How far beside the range's centre the nearest of a heading's parallel strips runs: 0 for an odd number of them. [m]"""
    if config.flight.strips_per_heading % 2:
        return 0.0
    return height_m * tan_lidar * (1.0 - config.flight.side_overlap)


def _inscribed_rectangle(across: float, along: float, heading_rad: np.ndarray) -> tuple[float, float]:
    """Half extents (east, north) of the largest upright rectangle inside one image's rectangle turned to every heading."""
    exact = np.arctan2([along, across], [across, along])  # what one heading, or two opposite ones, ask for
    share = np.concatenate([np.radians(np.linspace(0.5, 89.5, 179)), exact])
    aspect = np.stack([np.cos(share), np.sin(share)])  # candidates: (east, north) directions
    c, s = np.abs(np.cos(heading_rad)), np.abs(np.sin(heading_rad))
    limits = np.repeat([across, along], len(heading_rad))
    rows = np.concatenate([np.stack([c, s], axis=1), np.stack([s, c], axis=1)])
    size = np.min(limits[:, None] / (rows @ aspect), axis=0)
    half = aspect * size
    best = int(np.argmax(np.round(half[0] * half[1], 9) - 1e-6 * np.abs(share - np.pi / 4)))
    return float(half[0, best]), float(half[1, best])


def common_field(config: Config, height_m: float) -> Layout:
    """Fields of view at one height, and the part that targets may cover.

    Parameters
    ----------
    height_m : float
        Design height above the world's origin. [m]

    Returns
    -------
    Layout
        camera, LiDAR and cone: nominal half extents on the ground. field: half extents of the upright rectangle that
        every heading's camera and LiDAR see down at the tops of the targets, less the configured margin and three
        sigma of attitude and track, from the exposure that looks at the range's centre: the flight has one on every
        strip (nearest to it, with an even number of strips), so that one image holds all targets (6.2.3 b). A field
        that vanishes has half extents of 0.

    Raises
    ------
    ConfigError
        The LiDAR's sector does not contain the nadir.
    """
    camera, platform, flight = config.camera, config.platform, config.flight
    lens = camera.lens
    tan_across = min(lens.cx_px, camera.width_px - lens.cx_px) / lens.fx_px
    tan_along = min(lens.cy_px, camera.height_px - lens.cy_px) / lens.fy_px
    low, high = config.lidar.scanner.sector_deg
    if not low < 0.0 < high:
        raise ConfigError(
            "the sector must contain the nadir",
            where="lidar.scanner.sector_deg",
            got=f"{low:g} to {high:g} deg",
            expected="a negative and a positive encoder angle",
        )
    tan_lidar = float(np.tan(np.radians(min(-low, high, CONE_DEG))))
    cone = float(np.tan(np.radians(CONE_DEG)))

    above = max(height_m - _highest_m(config, height_m * min(tan_across, tan_along, tan_lidar)), 0.0)
    keep = 1.0 - config.targets.layout_margin
    track = WOBBLE_SIGMAS * platform.track_std_m
    roll, pitch, yaw = WOBBLE_SIGMAS * np.radians(
        [platform.roll_std_deg, platform.pitch_std_deg, platform.heading_std_deg]
    )

    def room(tangent: float, angle: float, other: float) -> float:
        """Half extent at the targets' tops without the margin and the wobble (angle at the edge, track, heading)."""
        wobble = np.sqrt((above * (1.0 + tangent**2) * angle) ** 2 + track**2 + (above * other * yaw) ** 2)
        return float(min(above * tangent * keep, above * cone) - wobble)

    across = min(room(tan_across, roll, tan_along), room(tan_lidar, roll, 0.0))
    across -= _line_offset_m(config, height_m, tan_lidar)
    along = room(tan_along, pitch, tan_across)
    field = (0.0, 0.0)
    if across > 0.0 and along > 0.0:
        field = _inscribed_rectangle(across, along, np.radians(np.asarray(flight.headings_deg, dtype=float)))
    return Layout(
        camera_half_m=(height_m * tan_across, height_m * tan_along),
        lidar_half_m=height_m * tan_lidar,
        cone_half_m=height_m * cone,
        field_half_m=field,
    )
