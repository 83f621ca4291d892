"""What hides and what shades a mark: the funnel's faces projected on the base plate from the camera and from the sun.

Only the mark's centre is never hidden. The sun's place is computed here from date and site; no pixel is read.
"""

import numpy as np

from evaluator.observe.frustums import SLOPE, FrustumModel

_GPS_EPOCH_FROM_J2000_S = (
    -630_763_200.0 + 1_000_000_000.0
)  # adjusted time 0, seconds from 2000-01-01 12:00 on GPS' clock
_DAY_S = 86_400.0


def to_sun(gps_time_s: float, gps_minus_utc_s: float, latitude_deg: float, longitude_deg: float) -> np.ndarray:
    """Unit vector to the sun, east north up, without refraction; 0.01 degrees from 1950 to 2050.

    Parameters
    ----------
    gps_time_s : float
        Adjusted standard GPS time. [s]
    gps_minus_utc_s : float
        Leap seconds. [s]
    latitude_deg, longitude_deg : float
        Geodetic. [deg]

    Returns
    -------
    (3,) np.ndarray

    References
    ----------
    The Astronomical Almanac, section C, low-precision formulas for the sun's coordinates.
    """
    days = (gps_time_s + _GPS_EPOCH_FROM_J2000_S - gps_minus_utc_s) / _DAY_S
    mean_longitude = np.radians(280.460 + 0.9856474 * days)
    anomaly = np.radians(357.528 + 0.9856003 * days)
    ecliptic = mean_longitude + np.radians(1.915 * np.sin(anomaly) + 0.020 * np.sin(2.0 * anomaly))
    obliquity = np.radians(23.439 - 4.0e-7 * days)
    right_ascension = np.arctan2(np.cos(obliquity) * np.sin(ecliptic), np.cos(ecliptic))
    declination = np.arcsin(np.sin(obliquity) * np.sin(ecliptic))
    sidereal = np.radians(280.46061837 + 360.98564736629 * days + longitude_deg)
    hour, latitude = sidereal - right_ascension, np.radians(latitude_deg)
    return np.array(
        [
            -np.cos(declination) * np.sin(hour),
            np.sin(declination) * np.cos(latitude) - np.cos(declination) * np.cos(hour) * np.sin(latitude),
            np.sin(declination) * np.sin(latitude) + np.cos(declination) * np.cos(hour) * np.cos(latitude),
        ]
    )


def sheet_corners(model: FrustumModel) -> np.ndarray:
    """Corners of the four sheets, each a convex slab of eight corners, target frame about the mark: (4, 8, 3). [m]"""
    b, shift = model.long_edge_m, max(model.thickness_m, 0.0) * np.sqrt(1.5)
    low, high = (0.25 * b, 0.5 * b) if model.inverted else (0.5 * b, 0.25 * b)
    z_low, z_high = (0.25 * b * SLOPE, 0.5 * b * SLOPE) if model.inverted else (0.0, 0.25 * b * SLOPE)
    other = shift if model.inverted else -shift
    corner = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
    rings = [
        np.column_stack([half * corner, np.full(4, z)])
        for half, z in ((low, z_low), (high, z_high), (low + other, z_low), (high + other, z_high))
    ]
    return np.array([[ring[i] for ring in rings for i in (k, (k + 1) % 4)] for k in range(4)])


def on_plate(points_m: np.ndarray, towards: np.ndarray, *, finite: bool) -> np.ndarray:
    """Points (..., 3) projected on the plate z = 0, (..., 2): from a point `towards` [m] or along a direction."""
    if finite:
        share = points_m[..., 2:] / (towards[2] - points_m[..., 2:])
        return np.asarray(points_m[..., :2] - share * (towards[:2] - points_m[..., :2]))
    return np.asarray(points_m[..., :2] - points_m[..., 2:] * towards[:2] / towards[2])
