"""This project's evaluator as one candidate: pair id -> call of the evaluator's own public functions, in double precision.

Holds no formula. The longest beginning of a pair's id that the table knows chooses the call.
"""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from campaign.config import Lens
from campaign.sensors import MountingSheet, NavigationSheet, Rig
from evaluator.algorithms.slots import VertexTask
from evaluator.benches.board_adjustment import Observations, Poses, poses_only
from evaluator.benches.camera_calibration import calibrate
from evaluator.boards.board_blunders import gauss_newton
from evaluator.boards.board_model import BoardProblem, Views, remap
from evaluator.c8_1_lidar_reflectance import fit_reflectance_surface, lidar_reflectance_rmse
from evaluator.c8_2_camera_radiometry import mean_dn, repeatability, stability_rsd, standard_deviation_dn
from evaluator.c8_3_reflectance_consistency import reflectance_correlation, reflectance_rmse_relative
from evaluator.c9_1_lidar_ranging import (
    corrected_range,
    group_refractive_index,
    mean_range,
    meteorological_correction,
    range_correction_constants,
    range_residuals,
    ranging_rmse,
    relative_rmse,
    saturation_pressure_hpa,
)
from evaluator.c9_2_camera_geometry import mean_reprojection_error, project_16
from evaluator.c9_3_calibration import calibration_error, project_24, residual_norms
from evaluator.camera_model import lens_vector, project_with_jacobian, undistorted_px
from evaluator.conformity.clause_7 import flight_height
from evaluator.frames import euler_angles, euler_rotation
from evaluator.model import EvaluationError, Mounting
from evaluator.mounting.mounting_model import observe_points
from evaluator.mounting.single_instant import rigid_by_pixels
from evaluator.observe.half_window import half_window_centre
from evaluator.other_methods.vertices import common_point, orthogonal_planes
from testrange.pairs.build import numbers
from testrange.pairs.model import Pair
from testrange.pairs.verify import Answer

Values = dict[str, Any]

# (22) has photo axes: y up, the camera looks along -z. Image axes from photo axes.
_IMAGE_FROM_PHOTO = np.diag([1.0, -1.0, -1.0])
_CENTRE_PX = 1.0  # a principal point where a formula has none; taken off again
_NADIR = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_NOTHING_KNOWN = 1e9  # rad and m: the standard deviation of a prior that says nothing


def ours(pairs: Iterable[Pair]) -> dict[str, Answer]:
    """Answers to the pairs, by id; none where the evaluator has no such function."""
    out: dict[str, Answer] = {}
    for pair in pairs:
        call = call_for(pair.id)
        if call is not None:
            values = {i.name: np.asarray(numbers(i.value, float)) for i in pair.inputs}
            found = np.asarray(call(values), dtype=np.float64)
            out[pair.id] = float(found) if found.ndim == 0 else [float(x) for x in found.ravel()]
    return out


def call_for(pair_id: str) -> Callable[[Values], Any] | None:
    """The evaluator's call for a pair; None where it has no such function."""
    fitting = [name for name in CALLS if pair_id.startswith(name)]
    return CALLS[max(fitting, key=len)] if fitting else None


def _lens(k: np.ndarray, d: np.ndarray | None = None) -> Lens:
    fx, fy, cx, cy = (float(x) for x in k)
    if d is None:
        return Lens(fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy)
    k1, k2, k3, p1, p2 = (float(x) for x in d)
    return Lens(fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, k1=k1, k2=k2, k3=k3, p1=p1, p2=p2)


def _turn(degrees: np.ndarray) -> np.ndarray:
    return euler_rotation(*np.radians(degrees))


def _surface(v: Values) -> list[float]:
    surface = fit_reflectance_surface(v["amplitude"], v["range"], v["reflectance"])
    found = surface(v["amplitude"], v["range"])
    return [*found, lidar_reflectance_rmse(found, v["reflectance"])]


def _air(v: Values) -> float:
    t = float(v["temperature"])
    humidity = v["humidity"] if "humidity" in v else 100.0 * v["vapour"] / saturation_pressure_hpa(t)
    index = group_refractive_index(float(v["wavelength"]), t, float(v["pressure"]), float(humidity))
    return (index - 1.0) * 1e6


def _whole_line(v: Values) -> float:
    k2, r2, _ = range_correction_constants(v["measured"], v["reference"])
    corrected = corrected_range(v["measured"], k2, r2)
    return relative_rmse(ranging_rmse(corrected, v["reference"]), mean_range(v["reference"]))


def _projected(v: Values) -> np.ndarray:
    return project_16(_lens(v["intrinsics"]), _turn(v["angles"]), v["translation"], v["points"])


def _pose(v: Values) -> tuple[np.ndarray, np.ndarray]:
    observations = Observations(
        board_m=v["points"],
        uv_px=v["pixels"][None],
        covariance_px2=np.broadcast_to(np.eye(2), (1, len(v["points"]), 2, 2)),
        size_px=(int(2 * v["intrinsics"][2]), int(2 * v["intrinsics"][3])),
    )
    start = Poses(rotation=_turn(v["start_angles"])[None], translation_m=v["start_translation"][None])
    found = poses_only(_lens(v["intrinsics"]), start, observations, observations.covariance_px2)
    return found.rotation[0], found.translation_m[0]


def _pose_error(v: Values) -> float:
    rotation, translation = _pose(v)
    return mean_reprojection_error(project_16(_lens(v["intrinsics"]), rotation, translation, v["points"]), v["pixels"])


def _photo(v: Values, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x_c, y_c and their derivatives by dX, dY, dZ, alpha, beta, gamma: (n, 2), (n, 2, 6)."""
    rpy = np.radians(v["angles"])
    mounting = Mounting(rotation=euler_rotation(*rpy) @ _IMAGE_FROM_PHOTO, lever_arm_m=v["offset"])
    n = len(points)
    p, by_mounting, _, _ = observe_points(
        mounting, rpy, np.zeros((n, 3)), np.broadcast_to(np.eye(3), (n, 3, 3)), points
    )
    f = float(v["focal"])
    uv, by_point, _ = project_with_jacobian(Lens(fx_px=f, fy_px=f, cx_px=_CENTRE_PX, cy_px=_CENTRE_PX), p)
    up = np.array([1.0, -1.0])
    return (uv - _CENTRE_PX) * up, (by_point @ by_mounting)[:, :, [3, 4, 5, 0, 1, 2]] * up[:, None]


def _error_equations(v: Values) -> np.ndarray:
    xy, design = _photo(v, v["point"][None])
    return np.concatenate([design[0].ravel(), xy[0] - v["observed"]])


def _boresight(v: Values) -> list[float]:
    lens = _lens(v["intrinsics"])
    rpy, translation = rigid_by_pixels(lens, v["points"], v["pixels"], _NADIR, v["start_translation"])
    projected = project_24(lens, _NADIR @ euler_rotation(*rpy), translation, v["points"])
    return [*rpy, *translation, calibration_error(residual_norms(projected, v["pixels"]))]


def _calibration(v: Values) -> list[float]:
    n = len(v["board"])
    uv = v["pixels"].reshape(-1, n, 2)
    observations = Observations(
        board_m=v["board"],
        uv_px=uv,
        covariance_px2=np.broadcast_to(np.eye(2), (*uv.shape, 2)),
        size_px=(int(2 * v["start_lens"][2]), int(2 * v["start_lens"][3])),
    )
    found = calibrate(observations, focal_px=float(v["start_lens"][0]), uniform=True, reject=False)
    lens, poses = found.lens, found.poses
    projected = [project_16(lens, r, t, v["board"]) for r, t in zip(poses.rotation, poses.translation_m, strict=True)]
    error = mean_reprojection_error(np.concatenate(projected), undistorted_px(lens, uv.reshape(-1, 2)))
    return [*lens_vector(lens), error]


def _vertex(v: Values) -> np.ndarray:
    """From points alone: no beam is known, so each point is its own origin, seen from above."""
    n = len(v["points"])
    outward = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]])
    task = VertexTask(
        origin_m=v["points"],
        direction=np.broadcast_to([0.0, 0.0, -1.0], (n, 3)),
        range_m=np.zeros(n),
        single_return=np.ones(n, dtype=bool),
        long_edge_m=0.5,
        inverted=True,
        thickness_m=0.0,
        normals=np.column_stack([-np.sqrt(2.0) * outward, np.ones(4)]) / np.sqrt(3.0),
        face_angle_std_rad=1e-3,
        range_std_m=2e-3,
        encoder_std_rad=0.0,
        footprint_m=0.0,
        located=True,
    )
    found = orthogonal_planes(task)
    if isinstance(found, str):
        raise EvaluationError(found)
    return found.vertex_m


def _board_problem(v: Values, photo: np.ndarray, board: np.ndarray) -> tuple[BoardProblem, Views]:
    still = NavigationSheet(
        grade="exact",
        position_std_m=(0.0, 0.0, 0.0),
        attitude_std_deg=(0.0, 0.0, 0.0),
        position_correlation_s=1.0,
        attitude_correlation_s=1.0,
    )
    sheet = MountingSheet(
        lever_arm_m=tuple(float(x) for x in v["t_cb"]),
        boresight_deg=(0.0, 0.0, 0.0),
        axes="rdf_nadir",
        boresight_std_deg=1.0,
        lever_arm_std_m=1.0,
    )
    count = len(v["places"])
    n = len(photo)
    problem = BoardProblem(
        rig=Rig(platform="", kind="multirotor", camera=sheet, lidar=sheet, navigation=still),
        lens=_lens(v["intrinsics"]),
        lens_covariance=np.zeros((9, 9)),
        image_size_px=(int(2 * v["intrinsics"][2]), int(2 * v["intrinsics"][3])),
        boards=tuple(f"B{i + 1}" for i in range(count)),
        places_m=v["places"],
        place_covariance_m2=np.zeros((count, 3, 3)),
        prior_std=np.full(6, _NOTHING_KNOWN),
    )
    views = Views(
        board=board,
        sortie=np.ones(n, dtype=np.int64),
        strip=np.ones(n, dtype=np.int64),
        time_s=photo.astype(np.float64),
        body_m=np.atleast_2d(v["positions"])[photo],
        world_from_body=np.stack([_turn(a) for a in np.atleast_2d(v["attitudes"])])[photo],
        velocity_m_s=np.zeros((n, 3)),
        turn_rate_rad_s=np.zeros((n, 3)),
        covariance_px2=np.broadcast_to(np.eye(2), (n, 2, 2)),
    )
    return problem, views


def _remapped(v: Values) -> np.ndarray:
    """One photo of all boards; without `mounting` the mounting is as drawn."""
    one = {**v, "positions": v["position"], "attitudes": v["attitude"]}
    n = len(v["places"])
    problem, views = _board_problem(one, np.zeros(n, dtype=np.int64), np.arange(n))
    xi = np.concatenate([np.radians(v["mounting"]), v["shift"]]) if "mounting" in v else np.zeros(6)
    return remap(problem, views, xi).uv_px


def _count(v: Values) -> np.ndarray | None:
    grey = v["image"]
    size = np.array(grey.shape[::-1])
    return half_window_centre(grey, size / 2.0, float(size.max()), int(v["window"]), float(v["threshold"]))


def _mounting(v: Values) -> list[float]:
    problem, views = _board_problem(v, v["photo"].astype(np.int64) - 1, v["board"].astype(np.int64) - 1)
    fit = gauss_newton(problem, views, v["pixels"], np.zeros(6))
    return [*fit.xi, float(np.mean(np.linalg.norm(fit.residual.reshape(-1, 2), axis=1)))]


CALLS: dict[str, Callable[[Values], Any]] = {
    "f01": lambda v: flight_height(float(v["focal_mm"]), float(v["gsd_m"]), float(v["pixel_mm"])),
    "f02": lambda v: lidar_reflectance_rmse(v["measured"], v["reference"]),
    "f02_surface": _surface,
    "f03": lambda v: stability_rsd(v["dn"]),
    "f04": lambda v: mean_dn(v["dn"]),
    "f05": lambda v: standard_deviation_dn(v["dn"]),
    "f06": lambda v: repeatability(v["dn"]),
    "f07": lambda v: reflectance_correlation(v["lidar"], v["camera"]),
    "f08": lambda v: reflectance_rmse_relative(v["lidar"], v["camera"]),
    "f09": lambda v: ranging_rmse(v["measured"], v["reference"]),
    "f10": lambda v: mean_range(v["reference"]),
    "f11": lambda v: relative_rmse(float(v["m_j"]), float(v["mean_range"])),
    "f11_whole": _whole_line,
    "f12": lambda v: meteorological_correction(
        float(v["distance"]), float(v["reference_index"]), float(v["group_index"])
    ),
    "f12_air": _air,
    "f13": lambda v: corrected_range(v["measured"], v["k2"], v["r2"]) + v["v"],
    "f14": lambda v: range_residuals(v["measured"], v["reference"], v["k2"], v["r2"]),
    "f14_constants": lambda v: range_correction_constants(v["measured"], v["reference"])[:2],
    "f15": lambda v: corrected_range(v["measured"], v["k2"], v["r2"]),
    "f16": _projected,
    "f17": _projected,
    "f18": lambda v: (lambda pose: [*euler_angles(pose[0]), *pose[1]])(_pose(v)),
    "f19": _pose_error,
    "f19_norms": lambda v: mean_reprojection_error(v["projected"], v["observed"]),
    "c9_2_2_f": _calibration,
    "c9_2_2_g": lambda v: undistorted_px(_lens(v["intrinsics"], v["distortion"]), v["pixels"]),
    "c9_3_2_d_points": _vertex,
    "c9_3_2_d_vertex": lambda v: common_point(v["planes"][:, :3], v["planes"][:, 3]),
    "f20": lambda v: calibration_error(v["errors"]),
    "f20_b2_coordinates": lambda v: calibration_error(residual_norms(v["projected"], v["observed"])),
    "f21": lambda v: _turn(v["angles"]),
    "f22": lambda v: _photo(v, v["points"])[0],
    "f23": _error_equations,
    "f24": lambda v: project_24(_lens(v["intrinsics"]), _turn(v["angles"]), v["translation"], v["points"]),
    "f24_adjusted": _boresight,
    "s3": _remapped,
    "s4": _count,
    "s5": _remapped,
    "s6": lambda v: v["pixels"] - _remapped(v),
    "s7": _mounting,
}
