"""2x2 boards in the campaign's images (the patent's S3 and S4): where each should be, its centre, or why it has none.

The pattern itself is fitted by `observe.boards`; the mounting is solved by `mounting_by_boards`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from campaign.config import Lens
from campaign.flight.records import CameraObservation, Exposure
from campaign.survey import SurveyedTarget
from evaluator.camera_model import camera_points, project, project_exposure, row_time
from evaluator.frames import WorldFrame, body_pose
from evaluator.model import CampaignData, EvaluationError, Mounting, SortieData
from evaluator.mounting.geometry import certified_lens, mean_band
from evaluator.observe.boards import BoardFit, BoardView, find_board, sides_px

MOST_OBSERVATIONS = 3000  # 0.3 GB a matrix, eight at a time
_HAND_STD_PX = 0.5  # of a pixel that a person picked
_SHADOW_SHARE = 0.6  # a board whose white has less than this of the others' lies in a shadow
_OTHER_AZIMUTH, _OR = "the board that stands there has the azimuth of ", " or "
_NEAREST = 0.9  # of a board's size: nearer centres are one place
# Tried where no board has the surveyed azimuth; a fit converges from ten degrees. So the search costs the same for any number
# of boards.
_TURNS_DEG = (90.0, 20.0, 34.0, 48.0, 62.0, 76.0, 104.0, 118.0, 132.0, 146.0, 160.0)
_NEAR_TURN_DEG = 15.0  # of the best of them: boards whose azimuth it may be
_AS_GOOD = 2.0  # times the least rms: a board some degrees away from another's azimuth is fitted nearly as well
# Points of the two edges that cross in the centre, over the board's size: what the plane's homography is fitted to, as the
# fit rests on these edges. A square grid's corners bend it by the lens's distortion, which moved centres outward by 0.002 px.
_GRID = np.array([[t, 0.0] for t in np.linspace(-0.5, 0.5, 9)] + [[0.0, t] for t in np.linspace(-0.5, 0.5, 9)])


@dataclass(frozen=True, kw_only=True)
class BoardObservation:
    """The centre of one board in one image."""

    target: str
    sortie: int
    strip: int
    image: str
    gps_time_s: float  # of the row of the image in which the centre lies
    uv_px: np.ndarray  # (2,) as observed (distorted); the first pixel's centre is (0.5, 0.5)
    covariance_px2: np.ndarray  # (2, 2)
    count_px: np.ndarray | None = None  # (2,) whole numbers: the half-window count of S4
    edge_px: float = 0.0
    white: float = 0.0  # level of the white squares above black
    picked_by: str = "evaluator"  # or "person"


def boards(data: CampaignData) -> tuple[SurveyedTarget, ...]:
    """The 2x2 boards of the survey."""
    return tuple(t for t in data.targets if t.kind == "board")


def board_search_px(data: CampaignData, target: SurveyedTarget, height_m: float) -> float:
    """How far a board may lie from its nominal prediction: two prior deviations of the mounting, less than half the distance
    to the next board, so that a neighbour stays outside. Boards that the survey puts nearer than their own size cannot both
    stand there: such a blunder narrows no window. [px]"""
    if data.rig is None or data.camera is None:
        raise EvaluationError("no sensors/rig.json or sensors/camera.json")
    focal = data.camera.nominal_focal_length_mm * 1000.0 / data.camera.pixel_size_um
    height = max(height_m, 1.0)
    angle = 2.0 * (np.radians(data.rig.camera.boresight_std_deg) + data.rig.camera.lever_arm_std_m / height)
    apart = [
        distance
        for t in boards(data)
        if t.id != target.id
        and (distance := float(np.hypot(t.easting_m - target.easting_m, t.northing_m - target.northing_m)))
        >= _NEAREST * target.size_m
    ]
    return float(max(focal * min(angle, 0.45 * min(apart, default=1e9) / height), 15.0))


def world_from_board(target: SurveyedTarget, world_frame: WorldFrame) -> tuple[np.ndarray, np.ndarray]:
    """(centre (3,) [m], axes (3, 3): x right, y along the azimuth, z up as columns) in the world."""
    place = np.array([target.easting_m, target.northing_m, target.height_m])
    a = np.radians(target.azimuth_deg)
    grid_from_board = np.array([[np.cos(a), np.sin(a), 0.0], [-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    return world_frame.world_from_map(place), world_frame.world_from_grid(place) @ grid_from_board


def surveyed_boards(data: CampaignData) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Centre in the world (3,) [m] and covariance (3, 3) [m^2] of each board, as surveyed."""
    world_frame = WorldFrame(data.manifest)
    out = {}
    for t in boards(data):
        axes = world_frame.world_from_grid(np.array([t.easting_m, t.northing_m, t.height_m]))
        variance = np.array([t.easting_std_m, t.northing_std_m, t.height_std_m]) ** 2
        covariance = axes @ np.diag(np.maximum(variance, 1e-10)) @ axes.T
        out[t.id] = world_from_board(t, world_frame)[0], covariance
    return out


def _homography(points: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(3, 3) that takes plane points (n, 2) to pixels (n, 2), by the direct linear transformation."""
    x, y = points.T
    one, zero = np.ones_like(x), np.zeros_like(x)
    scale = np.abs(pixels).max()
    u, v = pixels.T / scale
    rows = np.concatenate(
        [
            np.stack([x, y, one, zero, zero, zero, -u * x, -u * y], axis=1),
            np.stack([zero, zero, zero, x, y, one, -v * x, -v * y], axis=1),
        ]
    )
    h = np.append(np.linalg.lstsq(rows, np.concatenate([u, v]), rcond=None)[0], 1.0).reshape(3, 3)
    return np.asarray(np.diag([scale, scale, 1.0]) @ h)


def board_view(
    target: SurveyedTarget,
    data: CampaignData,
    lens: Lens,
    body_from_camera: Mounting,
    sortie: SortieData,
    exposure: Exposure,
    world_frame: WorldFrame,
) -> BoardView | None:
    """How one board should look in one image (S3, (7) and (8)); None where no camera of this lens can see it."""
    camera = data.camera
    if camera is None or sortie.trajectory is None:
        return None
    centre, axes = world_from_board(target, world_frame)
    uv, time = project_exposure(
        camera, lens, body_from_camera, sortie.trajectory, exposure.gps_time_s, centre, world_frame
    )
    if not np.all(np.isfinite(uv)):
        return None
    points = target.size_m * _GRID
    world = centre + points @ axes[:, :2].T
    position, world_from_body = body_pose(sortie.trajectory, time, world_frame)
    eye = position[0] + world_from_body[0] @ body_from_camera.lever_arm_m
    if (eye - centre) @ axes[:, 2] <= 0.0:
        return None
    in_camera = camera_points(body_from_camera, sortie.trajectory, np.full(len(world), time[0]), world, world_frame)
    pixels = project(lens, in_camera)
    if not np.all(np.isfinite(pixels)):
        return None
    return BoardView(predicted_px=uv[0], offset_from_board=_homography(points, pixels - uv[0]), size_m=target.size_m)


def observe_boards(
    data: CampaignData,
    sortie: SortieData,
    exposure: Exposure,
    image: np.ndarray,
    body_from_camera: Mounting,
    search_px: float | None = None,
    picked: Sequence[CameraObservation] = (),
) -> tuple[list[BoardObservation], dict[str, str]]:
    """Centres of every board in one image (S4).

    Parameters
    ----------
    data, sortie, exposure
    image : (h, w) or (h, w, bands) np.ndarray
        Linear DN.
    body_from_camera : Mounting
        Approximate.
    search_px : float, optional
        How far a board may be from its predicted place; `board_search_px` at the flown height when absent. [px]
    picked : sequence of CameraObservation
        Pixels that a person gave: taken where the campaign has them, for the boards they name.

    Returns
    -------
    observations : list of BoardObservation
    reasons : dict
        "target, image" -> why there is none; boards that are wholly outside the image are not listed.

    Raises
    ------
    EvaluationError
        No camera sheet.
    """
    camera = data.camera
    if camera is None:
        raise EvaluationError("no sensors/camera.json")
    lens = certified_lens(camera)[0]
    world_frame = WorldFrame(data.manifest)
    grey = image if image.ndim == 2 else mean_band(image)
    by_hand = {o.target: np.array([o.u_px, o.v_px]) for o in picked if o.image == exposure.image}
    size = np.array([camera.width_px, camera.height_px])
    found: list[BoardObservation] = []
    reasons: dict[str, str] = {}
    for target in boards(data):
        view = board_view(target, data, lens, body_from_camera, sortie, exposure, world_frame)
        count, edge, white = None, 0.0, 0.0
        if target.id in by_hand:
            uv, covariance = by_hand[target.id], _HAND_STD_PX**2 * np.eye(2)
        else:
            if view is None:
                continue
            radius = search_px if search_px is not None else board_search_px(data, target, _height(data, view, target))
            half = 0.5 * sides_px(view)[1]
            if np.any(view.predicted_px < -half) or np.any(view.predicted_px > size + half):
                continue
            fit = _find(grey, target, data, view, radius, camera.black_level_dn, 2.0**camera.bit_depth - 1.0)
            if isinstance(fit, str):
                reasons[f"{target.id}, {exposure.image}"] = fit
                continue
            uv, covariance = fit.uv_px, fit.covariance_px2
            count, edge, white = fit.count_px, fit.edge_px, fit.white
        found.append(
            BoardObservation(
                target=target.id,
                sortie=sortie.folder.number,
                strip=exposure.strip,
                image=exposure.image,
                gps_time_s=float(row_time(camera, exposure.gps_time_s, uv[1])),
                uv_px=uv,
                covariance_px2=covariance,
                count_px=count,
                edge_px=edge,
                white=white,
                picked_by="person" if target.id in by_hand else "evaluator",
            )
        )
    return _without_shadowed(found, reasons), reasons


def boards_not_found(
    surveyed: Iterable[str], reasons: Mapping[str, str], observations: Sequence[BoardObservation]
) -> dict[str, str]:
    """Boards of the survey without any observation, and the reason that most of their images give."""
    found = {o.target for o in observations}
    by_board: dict[str, list[str]] = {b: [] for b in surveyed}
    for key, reason in sorted(reasons.items()):
        by_board.setdefault(key.split(", ")[0], []).append(reason)
    return {
        b: max(lines, key=lines.count) if lines else "outside every image"
        for b, lines in by_board.items()
        if b not in found
    }


def thinned(observations: list[BoardObservation]) -> tuple[list[BoardObservation], int]:
    """(observations that fit into memory, images left out): the adjustment holds matrices of twice their number squared. Of more
    than it can hold every k-th image stays; navigation makes neighbours in time alike, so that little is lost."""
    step = -(-len(observations) // MOST_OBSERVATIONS)
    if step <= 1:
        return observations, 0
    images = sorted({(o.sortie, o.image) for o in observations})
    kept = set(images[::step])
    return [o for o in observations if (o.sortie, o.image) in kept], len(images) - len(kept)


def swapped_by_azimuth(not_found: Mapping[str, str]) -> list[tuple[str, str]]:
    """Pairs of boards each of which stands at the other's azimuth: their places are exchanged in the survey."""
    other = {
        b: set(r.removeprefix(_OTHER_AZIMUTH).split(_OR)) for b, r in not_found.items() if r.startswith(_OTHER_AZIMUTH)
    }
    return sorted((a, b) for a in other for b in other[a] if a < b and a in other.get(b, ()))


def _height(data: CampaignData, view: BoardView, target: SurveyedTarget) -> float:
    """Distance at which the board has its predicted size. [m]"""
    assert data.camera is not None
    focal = data.camera.nominal_focal_length_mm * 1000.0 / data.camera.pixel_size_um
    return focal * target.size_m / max(sides_px(view)[1], 1.0)


def _find(
    grey: np.ndarray,
    target: SurveyedTarget,
    data: CampaignData,
    view: BoardView,
    search_px: float,
    black_level: float,
    full_scale: float,
) -> BoardFit | str:
    """The board, or a reason; one that stands there at the azimuth of another, or of some others, or turned against the survey
    otherwise, is named as such."""

    def turned_by(turn_deg: float) -> BoardFit | str:
        c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
        turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        seen = replace(view, offset_from_board=view.offset_from_board @ turned)
        return find_board(grey, seen, search_px, clipped_at=0.995 * full_scale, black_level=black_level)

    fit = turned_by(0.0)
    if isinstance(fit, BoardFit):
        return fit
    tried = {turn: turned_by(turn) for turn in _TURNS_DEG}
    at = {turn: there.rms for turn, there in tried.items() if isinstance(there, BoardFit)}
    if not at:
        return fit
    best = min(at, key=lambda turn: at[turn])
    fits: dict[str, float] = {}
    for other in boards(data):
        turn = other.azimuth_deg - target.azimuth_deg
        if other.id != target.id and abs(np.sin(np.radians(turn - best))) < np.sin(np.radians(_NEAR_TURN_DEG)):
            there = turned_by(turn)
            if isinstance(there, BoardFit):
                fits[other.id] = there.rms
    if not fits:
        turn = best if best <= 90.0 else best - 180.0
        return f"the board that stands there is turned by about {turn:+.0f} degrees against its surveyed azimuth"
    least = min(fits.values())
    return _OTHER_AZIMUTH + _OR.join(sorted(name for name, rms in fits.items() if rms <= _AS_GOOD * least))


def _without_shadowed(found: list[BoardObservation], reasons: dict[str, str]) -> list[BoardObservation]:
    """Boards that are much darker than the others of the same image are left out and named."""
    levels = {o.target: o.white for o in found if o.picked_by == "evaluator"}
    if len(levels) < 3:
        return found
    usual = float(np.median(list(levels.values())))
    dark = {t for t, level in levels.items() if level < _SHADOW_SHARE * usual}
    for o in found:
        if o.target in dark:
            reasons[f"{o.target}, {o.image}"] = (
                f"in shadow: its white has {100.0 * o.white / usual:.0f} % of the others'"
            )
    return [o for o in found if o.target not in dark]
