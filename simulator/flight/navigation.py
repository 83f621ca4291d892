"""The post-processed trajectory that the customer gets: the true motion plus first-order Gauss-Markov errors.

x_{k+1} = phi x_k + sqrt(1 - phi^2) sigma w_k with phi = exp(-dt/T): stationary, standard deviation sigma, correlation time T
(A. Gelb, Applied Optimal Estimation, 1974, section 3.8). Position errors are along north, east, down; attitude errors are added to
roll, pitch and heading.
"""

import numpy as np

from campaign.config import NAVIGATION_GRADES, Config, Vector3
from campaign.flight.trajectory import Trajectory
from simulator.flight.frames import ENU_FROM_NED, SiteFrame, rpy_from_rotation
from simulator.flight.motion import Motion
from simulator.randomness import Stream, generator


def navigation_std(config: Config) -> tuple[Vector3, Vector3]:
    """Standard deviations: position north east down [m], attitude roll pitch heading [deg]."""
    navigation = config.navigation
    if navigation.grade == "custom":
        assert navigation.position_std_m is not None and navigation.attitude_std_deg is not None
        return navigation.position_std_m, navigation.attitude_std_deg
    return NAVIGATION_GRADES[navigation.grade]


def gauss_markov(rng: np.random.Generator, t_s: np.ndarray, std: np.ndarray, correlation_s: float) -> np.ndarray:
    """Stationary first-order Gauss-Markov process at evenly spaced times.

    Parameters
    ----------
    t_s : (n,) times [s]
    std : (k,) standard deviations of k independent components
    correlation_s : correlation time T [s]

    Returns
    -------
    (n, k)
    """
    from scipy.signal import lfilter

    phi = np.exp(-(t_s[1] - t_s[0]) / correlation_s)
    drive = rng.standard_normal((len(t_s), len(std)))
    drive[1:] *= np.sqrt(1.0 - phi**2)
    return np.asarray(lfilter([1.0], [1.0, -phi], drive, axis=0)) * std


def estimate_motion(config: Config, true: Motion, sortie: int) -> Motion:
    """The estimated motion of one sortie; its errors are independent of every other sortie's."""
    position_std, attitude_std = navigation_std(config)
    rng = generator(config.seed, Stream.NAVIGATION, sortie)
    navigation = config.navigation
    position = gauss_markov(rng, true.gps_time_s, np.asarray(position_std), navigation.position_correlation_s)
    attitude = gauss_markov(
        rng, true.gps_time_s, np.radians(np.asarray(attitude_std)), navigation.attitude_correlation_s
    )
    error_world = position @ ENU_FROM_NED.T
    return Motion(
        gps_time_s=true.gps_time_s,
        position_world_m=true.position_world_m + error_world,
        velocity_world_m_s=true.velocity_world_m_s + np.gradient(error_world, true.gps_time_s, axis=0),
        rpy_rad=true.rpy_rad + attitude,
    )


def trajectory_of(motion: Motion, frame: SiteFrame, config: Config) -> Trajectory:
    """A motion in the form of the campaign folder: geodetic, attitude against local north-east-down."""
    latitude, longitude, height = frame.geodetic_from_world(motion.position_world_m)
    ned_from_world = frame.local_ned_from_world(latitude, longitude)
    world_from_body = motion.world_from_body(motion.gps_time_s)
    roll, pitch, heading = rpy_from_rotation(ned_from_world @ world_from_body)
    t = motion.gps_time_s
    acceleration_world = np.gradient(motion.velocity_world_m_s, t, axis=0)
    body_from_world = np.swapaxes(world_from_body, -1, -2)
    step = body_from_world[:-1] @ world_from_body[1:]
    skew = (step - np.swapaxes(step, -1, -2)) / 2.0
    rate = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1) / np.diff(t)[:, None]
    position_std, attitude_std = navigation_std(config)
    n = len(t)
    return Trajectory(
        gps_time_s=t,
        latitude_rad=latitude,
        longitude_rad=longitude,
        ellipsoid_height_m=height,
        roll_rad=roll,
        pitch_rad=pitch,
        heading_rad=heading % (2.0 * np.pi),
        velocity_ned_m_s=np.einsum("nij,nj->ni", ned_from_world, motion.velocity_world_m_s),
        acceleration_body_m_s2=np.einsum("nij,nj->ni", body_from_world, acceleration_world),
        angular_rate_body_rad_s=np.concatenate([rate, rate[-1:]]),
        position_std_m=np.tile(np.asarray(position_std, float), (n, 1)),
        attitude_std_rad=np.tile(np.radians(np.asarray(attitude_std, float)), (n, 1)),
    )
