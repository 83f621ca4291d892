"""How fast the body moves and turns at any time, from its trajectory's poses. The poses themselves are `frames`'."""

import numpy as np

from campaign.flight.trajectory import Trajectory
from evaluator.frames import WorldFrame, body_pose

_RATE_SPAN_S = 0.02  # rates of the body by differences over it: a tenth of a step's noise, far below any sway


def body_rates(
    trajectory: Trajectory, gps_time_s: np.ndarray, world_frame: WorldFrame
) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and angular rate of the body at any times inside the trajectory.

    By differences of its poses over 20 ms: a trajectory's own columns of rates may be absent, and from one record to the next
    a filter's noise would be a hundredth of the speed.

    Returns
    -------
    velocity, turn : (n, 3) np.ndarray
        In world axes. [m/s], [rad/s]
    """
    samples = trajectory.gps_time_s
    before = np.maximum(gps_time_s - 0.5 * _RATE_SPAN_S, samples[0])
    after = np.minimum(gps_time_s + 0.5 * _RATE_SPAN_S, samples[-1])
    span = np.maximum(after - before, 1e-9)[:, None]
    (p0, r0), (p1, r1) = body_pose(trajectory, before, world_frame), body_pose(trajectory, after, world_frame)
    turned = r1 @ np.swapaxes(r0, -1, -2)
    small = 0.5 * np.stack(
        [turned[:, 2, 1] - turned[:, 1, 2], turned[:, 0, 2] - turned[:, 2, 0], turned[:, 1, 0] - turned[:, 0, 1]], -1
    )
    return (p1 - p0) / span, small / span
