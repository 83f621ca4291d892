"""Camera calibration of clause 9.2: one lens and a pose for each image from a plane board's corners, formulas (16)-(18).

Start values, weights from the residuals, blunders. The normal equations live in `board_adjustment`, corners in
`observe.chessboard`, M_z and what is said of it in `c9_2_camera_geometry`.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from campaign.config import Lens
from evaluator.benches.board_adjustment import Observations, Poses, System, adjust, reduced, residuals_and_jacobian
from evaluator.model import EvaluationError

_CORNER_SIGMAS = 6.0  # a corner beyond this many robust standard deviations is wild
_IMAGE_FACTOR = (
    3.0  # an image whose residuals are beyond this many times the median image's is not of this board or lens
)
_MOST_REJECTED = 0.25  # of the images
_MOST_WILD = 0.05  # of an image's corners; more, and the image goes


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """The adjusted lens and poses, in the order of the observations given; rejected images keep their pose."""

    lens: Lens
    covariance: np.ndarray  # (9, 9) corners independent of each other
    covariance_by_image: np.ndarray  # (9, 9) only images independent of each other (sandwich)
    poses: Poses
    use: np.ndarray  # (k, n) bool corners that took part
    image_use: np.ndarray  # (k,) bool
    residual_px: np.ndarray  # (k, n, 2) observed minus projected, with distortion; NaN: not observed
    sigma0_px: float  # a posteriori standard deviation of one coordinate, unweighted
    floor_px: float  # standard deviation that every coordinate has beside its own covariance
    factor: np.ndarray  # (k,) variance factor of each image
    iterations: int
    redundancy: int
    rejected: dict[int, str]  # image -> why
    wild: tuple[tuple[int, int], ...]  # (image, corner)


def _homographies(obs: Observations) -> np.ndarray:
    """(k, 3, 3) image from board, pixels of image axes."""
    out = []
    for uv in obs.uv_px:
        good = np.isfinite(uv[:, 0])
        h, _ = cv2.findHomography(obs.board_m[good, :2], uv[good], 0)
        if h is None:
            raise EvaluationError("the corners of an image lie on no plane board")
        out.append(h)
    return np.stack(out)


def focal_from_homographies(homographies: np.ndarray, size_px: tuple[int, int]) -> float | None:
    """Focal length that makes both board axes perpendicular and equal, principal point in the middle. [px]

    None where the boards' tilts do not tell it.

    References
    ----------
    Zhang, A flexible new technique for camera calibration, IEEE PAMI 22(11), 2000, section 3.1, with one unknown.
    """
    shift = np.array([[1.0, 0.0, -size_px[0] / 2.0], [0.0, 1.0, -size_px[1] / 2.0], [0.0, 0.0, 1.0]])
    h = shift @ homographies
    h = h / np.linalg.norm(h[:, :, :1], axis=1, keepdims=True)
    a, b = h[:, :, 0], h[:, :, 1]
    left = np.concatenate([np.sum(a[:, :2] * b[:, :2], axis=1), np.sum(a[:, :2] ** 2 - b[:, :2] ** 2, axis=1)])
    right = -np.concatenate([a[:, 2] * b[:, 2], a[:, 2] ** 2 - b[:, 2] ** 2])
    w = float(left @ right / max(left @ left, 1e-300))
    if not w > 0.0:
        return None
    f = 1.0 / np.sqrt(w)
    return float(f) if 0.1 < f / max(size_px) < 50.0 else None


def _start(homographies: np.ndarray, focal_px: float, size_px: tuple[int, int]) -> tuple[Lens, Poses]:
    lens = Lens(fx_px=focal_px, fy_px=focal_px, cx_px=size_px[0] / 2.0, cy_px=size_px[1] / 2.0)
    k = np.array([[focal_px, 0.0, lens.cx_px], [0.0, focal_px, lens.cy_px], [0.0, 0.0, 1.0]])
    m = np.linalg.solve(k, homographies)
    scale = 2.0 / (np.linalg.norm(m[:, :, 0], axis=1) + np.linalg.norm(m[:, :, 1], axis=1))
    m = m * (scale * np.sign(m[:, 2, 2]))[:, None, None]
    raw = np.stack([m[:, :, 0], m[:, :, 1], np.cross(m[:, :, 0], m[:, :, 1])], axis=-1)
    u, _, vt = np.linalg.svd(raw)
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    return lens, Poses(rotation=u @ vt, translation_m=m[:, :, 2])


def _start_values(obs: Observations, focal_px: float | None) -> tuple[Lens, Poses]:
    """Best of several starts after a first adjustment with equal weights: sheet, Zhang, and a common focal length."""
    h = _homographies(obs)
    weight = np.where(np.isfinite(obs.uv_px[..., :1]), 1.0, 0.0)[..., None] * np.eye(2)
    few = np.isin(np.arange(9), (0, 1, 4))
    best: tuple[float, Lens, Poses] | None = None
    reason: EvaluationError | None = None
    for focal in (focal_px, focal_from_homographies(h, obs.size_px), 1.2 * max(obs.size_px)):
        if focal is None:
            continue
        try:
            lens, poses, _, _ = adjust(*_start(h, focal, obs.size_px), obs, weight, few)
            lens, poses, s, _ = adjust(lens, poses, obs, weight, np.ones(9, bool))
        except EvaluationError as error:
            reason = error
            continue
        if best is None or s.cost < best[0]:
            best = (s.cost, lens, poses)
        if np.sqrt(best[0] / max(weight[..., 0, 0].sum(), 1.0)) < 2.0:
            break
    if best is None:
        raise reason or EvaluationError("the calibration has no start values")
    return best[1], best[2]


def weights(obs: Observations, use: np.ndarray, floor: float, factor: np.ndarray) -> np.ndarray:
    """Inverse of (covariance + floor^2) times the image's factor; zero where not in use."""
    covariance = np.where(use[..., None, None], obs.covariance_px2, np.eye(2)) + floor**2 * np.eye(2)
    return np.asarray(np.linalg.inv(covariance * factor[:, None, None, None]) * use[..., None, None])


def _image_means(value: np.ndarray, use: np.ndarray) -> np.ndarray:
    """Mean over the corners in use, (k,); NaN without any."""
    count = use.sum(axis=1)
    return np.where(count > 0, np.where(use, value, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)


def _floor(residual: np.ndarray, obs: Observations, use: np.ndarray, share: float) -> float:
    """Standard deviation that, beside each corner's own covariance, explains the median image's residuals. [px]"""
    squares = np.sum(residual**2, axis=-1)
    own = np.trace(obs.covariance_px2, axis1=-2, axis2=-1)

    def excess(variance: float) -> float:
        return float(np.nanmedian(_image_means(squares / (own + 2.0 * variance), use))) / share - 1.0

    if excess(0.0) <= 0.0:
        return 0.0
    low, high = 0.0, float(np.nanmedian(_image_means(squares, use)))
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
    return float(np.sqrt(0.5 * (low + high)))


def calibrate(
    obs: Observations, *, focal_px: float | None = None, uniform: bool = False, reject: bool = True
) -> Calibration:
    """Lens and poses by least squares, with blunders out.

    Parameters
    ----------
    obs : Observations
        At least four images.
    focal_px : float, optional
        From the camera's sheet, to start with.
    uniform : bool
        Every corner the same weight, whatever its covariance.
    reject : bool
        Leave out images whose median residual (weighted) is beyond 3 times the typical image's, one after the other, the worst
        first; then corners beyond 6 robust standard deviations of their image. An image with more than 5 % of those goes too.

    Returns
    -------
    Calibration

    Raises
    ------
    EvaluationError
        Fewer than four images, no convergence, or more than a quarter of the images rejected.

    Notes
    -----
    Weights: the inverse of the corner's own covariance plus a floor common to all (what no noise explains: print, flatness, a lens
    that the model does not reach), times one variance factor an image; floor and factors are estimated from the residuals.

    References
    ----------
    GB/T 41450-2022, 9.2.2 e-f, formulas (16)-(18).
    """
    k = len(obs.uv_px)
    if k < 4:
        raise EvaluationError("too few images of the board for a calibration", got=k, expected="at least 4")
    lens, poses = _start_values(obs, focal_px)
    use = np.isfinite(obs.uv_px[..., 0])
    total = int(use.sum())
    share = 1.0 - (9 + 6 * k) / (2.0 * total)
    if share <= 0.05:
        raise EvaluationError("too few corners for a calibration", got=total)
    rejected: dict[int, str] = {}
    wild: list[tuple[int, int]] = []
    factor = np.ones(k)
    everything = np.ones(9, bool)
    floor = 0.0
    iterations = 0
    for round_ in range(40):
        residual = residuals_and_jacobian(lens, poses, obs.board_m, obs.uv_px)[0]
        before = (floor, factor)
        if uniform:
            plain = replace(obs, covariance_px2=np.broadcast_to(np.eye(2), obs.covariance_px2.shape))
        else:
            plain = obs
            floor = _floor(residual, obs, use, share)
        unit = weights(plain, use, floor, np.ones(k))
        squares = np.einsum("kni,knij,knj->kn", np.where(use[..., None], residual, 0.0), unit, np.nan_to_num(residual))
        rms = np.sqrt(_image_means(squares, use) / 2.0)
        gone = reject and _reject(squares, use, rejected, wild)
        if not uniform:
            factor = np.where(use.any(axis=1), np.clip(rms**2 / share, 0.05, 20.0), 1.0)
        if gone:
            if len(rejected) > _MOST_REJECTED * k or (~np.isin(np.arange(k), list(rejected))).sum() < 4:
                raise EvaluationError(
                    "too many images contradict the rest",
                    got=f"{len(rejected)} of {k} rejected",
                    remedy="check board.json, and that zoom and focus were locked",
                )
        elif (
            round_ > 1
            and np.isclose(floor, before[0], rtol=1e-3, atol=1e-6)
            and np.allclose(factor, before[1], rtol=0.01)
        ):
            break
        weight = weights(plain, use, floor, factor)
        lens, poses, _, steps = _adjust_used(lens, poses, plain, weight, everything)
        iterations += steps
    weight = weights(plain, use, floor, factor)
    lens, poses, system, steps = _adjust_used(lens, poses, plain, weight, everything)
    return _result(lens, poses, system, obs, use, floor, factor, rejected, wild, iterations + steps)


def _adjust_used(
    lens: Lens, poses: Poses, obs: Observations, weight: np.ndarray, free: np.ndarray
) -> tuple[Lens, Poses, System, int]:
    """`_adjust` on the images that have weight; the others keep their poses."""
    on = np.any(weight != 0.0, axis=(1, 2, 3))
    part = replace(obs, uv_px=obs.uv_px[on], covariance_px2=obs.covariance_px2[on])
    used = Poses(rotation=poses.rotation[on], translation_m=poses.translation_m[on])
    lens, used, system, steps = adjust(lens, used, part, weight[on], free)
    rotation, translation = poses.rotation.copy(), poses.translation_m.copy()
    rotation[on], translation[on] = used.rotation, used.translation_m
    return lens, Poses(rotation=rotation, translation_m=translation), system, steps


def _reject(squares: np.ndarray, use: np.ndarray, rejected: dict[int, str], wild: list[tuple[int, int]]) -> bool:
    """Takes the worst image, or else the wild corners, out of `use`; whether anything went. Medians: one wild corner does not make
    an image bad."""
    middle = np.array([np.median(s[u]) if u.any() else 0.0 for s, u in zip(squares, use, strict=True)])
    typical = float(np.median(middle[use.any(axis=1)]))
    worst = int(np.argmax(middle))
    if middle[worst] > _IMAGE_FACTOR**2 * typical:
        ratio = np.sqrt(middle[worst] / typical)
        rejected[worst] = f"its residuals are {ratio:.1f} times the median image's (limit {_IMAGE_FACTOR:g})"
        use[worst] = False
        return True
    # the median of chi-square with two degrees of freedom is 1.386
    off = use & (squares > _CORNER_SIGMAS**2 / 1.3863 * np.maximum(middle, typical)[:, None])
    for image in np.flatnonzero(off.any(axis=1)):
        count, of = int(off[image].sum()), int(use[image].sum())
        if count > max(_MOST_WILD * of, 1):
            rejected[int(image)] = f"{count} of {of} corners are beyond {_CORNER_SIGMAS:g} standard deviations"
            use[image] = False
        else:
            wild += [(int(image), int(corner)) for corner in np.flatnonzero(off[image])]
            use[image] &= ~off[image]
    return bool(off.any())


def _result(
    lens: Lens,
    poses: Poses,
    system: System,
    obs: Observations,
    use: np.ndarray,
    floor: float,
    factor: np.ndarray,
    rejected: dict[int, str],
    wild: list[tuple[int, int]],
    iterations: int,
) -> Calibration:
    matrix, by_image, _ = reduced(system, 0.0)
    redundancy = 2 * int(use.sum()) - 9 - 6 * int(use.any(axis=1).sum())
    scale = np.sqrt(np.diag(matrix))
    try:
        inverse = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
    except np.linalg.LinAlgError:
        raise EvaluationError("the images do not determine the camera", remedy="tilt the board") from None
    covariance = inverse * (system.cost / redundancy)
    images = len(by_image)
    if np.any(np.diag(covariance) <= 0.0) or not np.all(np.isfinite(covariance)):
        raise EvaluationError("the images do not determine the camera", remedy="tilt the board")
    # every image's reduced gradient is a sum over its own corners: their scatter needs no independence within an image
    sandwich = inverse @ (by_image.T @ by_image) @ inverse * (images / max(images - 1, 1))
    residual = residuals_and_jacobian(lens, poses, obs.board_m, obs.uv_px)[0]
    return Calibration(
        lens=lens,
        covariance=(covariance + covariance.T) / 2.0,
        covariance_by_image=(sandwich + sandwich.T) / 2.0,
        poses=poses,
        use=use,
        image_use=np.asarray(use.any(axis=1)),
        residual_px=residual,
        sigma0_px=float(np.sqrt(np.sum(residual[use] ** 2) / redundancy)),
        floor_px=floor,
        factor=factor,
        iterations=iterations,
        redundancy=redundancy,
        rejected=rejected,
        wild=tuple(wild),
    )
