"""One campaign folder in, one `Evaluation` out: the order of the evaluator's rooms. No formula and no file format here.

First the benches (5.1), whose camera calibration serves the flight where it fits. Then the geometry: marks from every image,
vertices from every strip, both mountings. With the mountings known the panels are where the survey says; without them each is
searched. Then the indicators, then conformity. An indicator that cannot be had carries its reason and never stops the
others. Nothing under truth/ is opened.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from campaign.errors import TestrangeError
from campaign.flight.images import read_image, read_preview
from campaign.flight.records import CameraObservation, Exposure, read_camera_observations
from campaign.progress import Report, silent
from campaign.threads import one_blas_thread
from evaluator.algorithms.guard import Log, guarded
from evaluator.algorithms.record import OWN, Algorithms, Tools
from evaluator.algorithms.solvers import mountings_solver
from evaluator.benches.order import evaluate_benches, flight_lens, flight_ranges
from evaluator.boards.board_observations import BoardObservation, observe_boards
from evaluator.boards.mounting_by_boards import solve_by_boards
from evaluator.c8_1_lidar_reflectance import PanelReflectances, evaluate_lidar_reflectance
from evaluator.c8_3_reflectance_consistency import evaluate_reflectance_consistency
from evaluator.c9_3_calibration import CalibrationResult, evaluate_calibration
from evaluator.conformity import conformity_rows
from evaluator.conformity.observed import observed_inputs
from evaluator.coverage import targets_outside_images, targets_outside_strips
from evaluator.frames import WorldFrame
from evaluator.georeference import TargetReturns, collect_target_returns, nominal_mountings
from evaluator.lidar_response import lidar_response
from evaluator.load import in_folder
from evaluator.load import load_campaign as read_campaign
from evaluator.model import CampaignData, EvaluationError, MarkObservation, Mounting, SortieData
from evaluator.mounting.closure import closure
from evaluator.mounting.diagnosis import deviations, suspects
from evaluator.mounting.geometry import GeometryResult, observe_marks, search_radius_px, solve_geometry
from evaluator.observe.examples import waveform_examples
from evaluator.observe.panel_images import panel_image_values, region_pixels
from evaluator.observe.panels import ImagePanelObservation, LidarPanelObservation, lidar_panel_observations
from evaluator.observe.picks import target_points
from evaluator.results import Evaluation, PanelValue, Region
from evaluator.results_model import IndicatorValue, not_measured
from evaluator.returns_store import ReturnsStore

__all__ = ["evaluate_campaign", "read_campaign"]

_NO_IMAGE = np.empty((0, 0, 0), np.uint16)  # in the place of one that is done with, so that two are never held at once
COLLECT_MARGIN_M = 1.4  # round a target's own radius: one degree of unknown mounting at 80 m


@dataclass(kw_only=True)
class _Findings:
    """What accumulates while images are read one by one."""

    marks: list[MarkObservation] = field(default_factory=list)
    mark_reasons: dict[str, str] = field(default_factory=dict)
    boards: list[BoardObservation] = field(default_factory=list)
    board_reasons: dict[str, str] = field(default_factory=dict)
    panels: list[ImagePanelObservation] = field(default_factory=list)
    regions: list[Region] = field(default_factory=list)
    brightness: dict[str, list[float]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    root: Path

    def problem(self, error: TestrangeError) -> None:
        """Each once, whatever room met it."""
        line = in_folder(error, self.root)
        if line not in self.problems:
            self.problems.append(line)


def evaluate_campaign(
    root: Path, progress: Report = silent, *, strict: bool = False, algorithms: Algorithms = OWN
) -> Evaluation:
    """Evaluate one campaign folder.

    Parameters
    ----------
    root : Path
    progress : callable
    strict : bool
        A target that no image or no strip can hold ends the evaluation; else it is named among the problems.
    algorithms : Algorithms
        What stands in the seven slots. What fails of it is named among the problems and missing in the results. One that never
        returns is stopped where signals reach it; `algorithms.apart` runs the whole in a process that can be ended.

    Raises
    ------
    CampaignError
        `root` is no campaign folder.
    EvaluationError
        `strict`, and a target lies outside.
    """
    return evaluate_with(root, progress, *guarded(algorithms), strict=strict)


@one_blas_thread()
def evaluate_with(root: Path, progress: Report, tools: Tools, log: Log, *, strict: bool = False) -> Evaluation:
    """`evaluate_campaign` with tools from `algorithms.guard.guarded`, whose calls `log` counts."""
    data = read_campaign(root)
    findings = _Findings(problems=list(data.problems), root=root)
    benches = evaluate_benches(data, progress)
    certificate = data.camera.calibration if data.camera else None
    data, lens_source = flight_lens(data, benches.chessboard)
    own_lens = data.camera is not None and data.camera.calibration is not certificate
    data = flight_ranges(data, benches.ranging)
    _outside(targets_outside_images(data), strict, findings)
    returns = _returns_near_targets(data, findings, progress)
    _outside(targets_outside_strips(data, returns, _collect_radius_m(data)), strict, findings)
    _look_for_targets(data, findings, tools, progress)
    geometry, geometry_reason = _geometry(data, returns, findings, tools, progress)
    camera, lidar = _mountings(data, geometry)
    progress("panels", 0, 2)
    lidar_panels = _lidar_panels(data, returns, lidar if geometry else None, findings, tools)
    progress("panels", 1, 2)
    _image_panels(data, camera, geometry is not None, findings, progress)
    m_f, lidar_values = evaluate_lidar_reflectance(lidar_panels, data.targets, data.spectra, data.lidar, tools)
    r_f, m_relative, camera_values = evaluate_reflectance_consistency(
        lidar_values, findings.panels, data.targets, data.spectra, data.camera, lidar_reason=m_f.reason or "8.1 failed"
    )
    progress("panels", 2, 2)
    progress("calibration error", 0, 1)
    calibration, p_m = _calibration(geometry, geometry_reason, tools)
    if p_m.value is not None:
        by = data.range_correction
        ranges = "as measured" if by is None else f"corrected by (15): {by.additive_constant_m:+.4f} m"
        ranges += "" if by is None else f" {1e6 * by.multiplication_constant:+.0f} ppm"
        p_m = replace(p_m, companions={**p_m.companions, "interior_orientation": lens_source, "ranges": ranges})
    progress("calibration error", 1, 1)
    solution = geometry.solution if geometry else None
    boards = _boards_block(data, findings, tools)
    indicators = benches.indicators | {
        "lidar_reflectance_rmse": m_f,
        "reflectance_correlation": r_f,
        "reflectance_rmse_relative": m_relative,
        "calibration_error": p_m,
    }
    examples = waveform_examples(data, returns, lidar_panels, tools)
    measured = replace(
        observed_inputs(
            data,
            marks=findings.marks,
            panels=findings.panels,
            brightness=findings.brightness,
            geometry=geometry,
            lidar_panels=lidar_panels,
            returns=returns,
            camera=camera,
            indicators_measured=sum(v.value is not None for v in indicators.values()),
        ),
        sphere=benches.sphere,
        chessboard=benches.chessboard,
        ranging=benches.ranging,
    )
    return Evaluation(
        campaign=data.manifest.campaign,
        synthetic=data.manifest.synthetic,
        indicators=indicators,
        conformity=tuple(conformity_rows(data, measured)),
        mounting=solution,
        mounting_reason=geometry_reason,
        mounting_prior_std=solution.prior_std if solution else None,
        boards=boards,
        closure=_closure_block(geometry, tools),
        problems=(*findings.problems, *log.problems()),
        algorithms=tools.replaced,
        data=data,
        marks=tuple(findings.marks),
        vertices=geometry.vertices if geometry else (),
        residuals=calibration.residuals if calibration else (),
        panels=_panel_values(data, lidar_values, camera_values),
        regions=tuple(findings.regions),
        waveforms=tuple(examples),
        strip_window_s=measured.strip_window_s,
        companions={
            "marks_not_found": dict(sorted(findings.mark_reasons.items())),
            "vertices_not_found": dict(sorted(geometry.vertex_reasons.items())) if geometry else {},
            "planes_not_found": dict(sorted(geometry.plane_reasons.items())) if geometry else {},
            "target_points": target_points(data, returns, lidar_panels, geometry.vertices if geometry else ()),
            "panel_returns": tuple((o.panel, o.sortie, o.strip, o.points) for o in lidar_panels),
        },
        sphere=benches.sphere,
        chessboard=benches.chessboard,
        ranging=benches.ranging,
        deviations=deviations(
            solution,
            benches.chessboard if own_lens else None,  # of another focus setting it says nothing of the certificate
            certificate,
            benches.ranging,
            benches.photon_transfer,
            lidar_response(lidar_panels, data.spectra, data.lidar),
        ),
        survey_doubts=suspects(
            (*(solution.rejected if solution else ()), *boards.get("rejected", ())),
            [t.id for t in data.targets],
            boards.get("swapped", ()),
        ),
    )


def _outside(lines: list[str], strict: bool, findings: _Findings) -> None:
    if lines and strict:
        more = f"and {len(lines) - 1} more" if len(lines) > 1 else None
        raise EvaluationError(lines[0], remedy=more, problems=lines)
    findings.problems += lines


def _collect_radius_m(data: CampaignData) -> float:
    return max((t.size_m for t in data.targets), default=0.0) / float(np.sqrt(2.0)) + COLLECT_MARGIN_M


def _returns_near_targets(
    data: CampaignData, findings: _Findings, progress: Report
) -> Mapping[tuple[int, int, str], TargetReturns]:
    strips = sum(len(s.strips) for s in data.sorties)
    progress("point cloud", 0, strips)
    centres = {t.id: np.array([t.easting_m, t.northing_m, t.height_m]) for t in data.targets}
    found = ReturnsStore()
    done = 0
    for sortie in data.sorties:
        for strip in sortie.strips:
            one = _only(data, sortie, (strip,))
            try:
                found.add(collect_target_returns(one, centres, _collect_radius_m(data)))
            except TestrangeError as error:
                findings.problem(error)
            done += 1
            progress("point cloud", done, strips)
    return found


def _only(data: CampaignData, sortie: SortieData, strips: tuple[int, ...]) -> CampaignData:
    """The campaign as if it had but these strips of one sortie."""
    return replace(data, sorties=(replace(sortie, strips=strips),))


def _exposures(data: CampaignData) -> Iterator[tuple[SortieData, Exposure]]:
    for sortie in data.sorties:
        for exposure in sortie.exposures:
            if sortie.trajectory is not None:
                yield sortie, exposure


def _image(data: CampaignData, sortie: SortieData, exposure: Exposure) -> np.ndarray:
    sheet = data.camera
    if sheet is None:
        raise EvaluationError("no sensors/camera.json")
    path = sortie.folder.images / exposure.image
    if not path.is_file():  # a pipe would never end
        raise EvaluationError("no such file", where=str(path))
    return read_image(path, width_px=sheet.width_px, height_px=sheet.height_px, bands=len(sheet.bands))


def _picked(sortie: SortieData, findings: _Findings) -> list[CameraObservation]:
    """What a person picked, where the campaign has it (8.3.2 c, 9.3.2 c)."""
    path = sortie.folder.observations_camera
    if not path.is_file():
        return []
    try:
        return read_camera_observations(path)
    except TestrangeError as error:
        findings.problem(error)
        return []


def _look_for_targets(data: CampaignData, findings: _Findings, tools: Tools, progress: Report) -> None:
    """Marks and boards of every image; nothing without the rig and the camera's sheet."""
    wanted = {t.kind for t in data.targets} & {"frustum", "board"}
    if data.rig is None or data.camera is None or not wanted:
        return
    nominal = nominal_mountings(data.rig)[0]
    heights = {(s.sortie, s.strip): s.height_m for s in data.plan.strips} if data.plan is not None else {}
    frames = list(_exposures(data))
    progress("marks", 0, len(frames))
    hand = {sortie.folder.number: _picked(sortie, findings) for sortie in data.sorties}
    for done, (sortie, exposure) in enumerate(frames, start=1):
        height = heights.get((sortie.folder.number, exposure.strip), exposure.focus_distance_m)
        picked = hand[sortie.folder.number]
        try:
            image = _image(data, sortie, exposure)
            if "frustum" in wanted:
                search = search_radius_px(data, height)
                marks, reasons = observe_marks(data, sortie, exposure, image, nominal, search, picked, tools)
                findings.marks += marks
                findings.mark_reasons |= reasons
            if "board" in wanted:
                boards, reasons = observe_boards(data, sortie, exposure, image, nominal, None, picked)
                findings.boards += boards
                findings.board_reasons |= reasons
        except TestrangeError as error:
            findings.problem(error)
        image = _NO_IMAGE
        progress("marks", done, len(frames))


def _geometry(
    data: CampaignData,
    returns: Mapping[tuple[int, int, str], TargetReturns],
    findings: _Findings,
    tools: Tools,
    progress: Report,
) -> tuple[GeometryResult | None, str | None]:
    """Both mountings from the marks and the returns; or why there are none."""
    if data.rig is None or data.camera is None:
        missing = "sensors/rig.json" if data.rig is None else "sensors/camera.json"
        return None, f"{missing} is missing or unreadable"
    if not any(t.kind == "frustum" for t in data.targets):
        return None, "the survey holds no frustum target" if data.targets else "no survey/targets.csv"
    progress("mounting", 0, 1)
    try:
        result = solve_geometry(data, findings.marks, returns, tools)
    except EvaluationError as error:
        return None, str(error)
    finally:
        progress("mounting", 1, 1)
    return result, None


def _boards_block(data: CampaignData, findings: _Findings, tools: Tools) -> dict[str, Any]:
    """The camera's mounting by the patent's boards; empty where the survey holds none."""
    if not any(t.kind == "board" for t in data.targets):
        return {}
    not_in_images = {"not_in_images": dict(sorted(findings.board_reasons.items()))}
    try:
        found = solve_by_boards(data, findings.boards, findings.board_reasons, tools)
    except EvaluationError as error:
        return {"status": "not_measured", "reason": str(error), **not_in_images}
    return {"status": "measured", **found.results_block(), **not_in_images}


def _closure_block(geometry: GeometryResult | None, tools: Tools) -> dict[str, object]:
    """Camera-body and LiDAR-body against camera-LiDAR."""
    if geometry is None:
        return {}
    if tools.extrinsic_solver is not None:
        return {"reason": "the mountings come from an algorithm of the user's own"}
    try:
        return closure(geometry.problem, geometry.solution).block()
    except EvaluationError as error:
        return {"reason": str(error)}


def _mountings(data: CampaignData, geometry: GeometryResult | None) -> tuple[Mounting | None, Mounting | None]:
    """Camera and LiDAR: solved, else as drawn, else unknown."""
    if geometry is not None:
        return geometry.solution.body_from_camera, geometry.solution.body_from_lidar
    return nominal_mountings(data.rig) if data.rig is not None else (None, None)


def _lidar_panels(
    data: CampaignData,
    returns: Mapping[tuple[int, int, str], TargetReturns],
    body_from_lidar: Mounting | None,
    findings: _Findings,
    tools: Tools,
) -> list[LidarPanelObservation]:
    if data.rig is None or data.lidar is None:
        return []
    try:
        return lidar_panel_observations(data, returns, body_from_lidar, tools)
    except TestrangeError as error:
        findings.problem(error)
        return []


def _image_panels(
    data: CampaignData, body_from_camera: Mounting | None, solved: bool, findings: _Findings, progress: Report
) -> None:
    """Panel values, outlines and brightness of every image; images that cannot be read were named with the marks."""
    panels = [t for t in data.targets if t.kind == "panel"]
    if data.camera is None or body_from_camera is None or not panels:
        return
    frame = WorldFrame(data.manifest)
    frames = list(_exposures(data))
    hand = {sortie.folder.number: _picked(sortie, findings) for sortie in data.sorties}
    progress("images", 0, len(frames))
    for done, (sortie, exposure) in enumerate(frames, start=1):
        trajectory = sortie.trajectory
        assert trajectory is not None
        try:
            image = _image(data, sortie, exposure)
            values = panel_image_values(
                image,
                exposure,
                sortie.folder.number,
                panels,
                data.camera,
                body_from_camera,
                trajectory,
                frame,
                search=not solved,
                picked=hand[sortie.folder.number],
            )
            image = _NO_IMAGE
            _brightness(data, sortie, exposure, values, findings)
        except TestrangeError as error:
            image = _NO_IMAGE
            findings.problem(error)
            continue
        findings.panels += values
        findings.regions += [
            Region(target=v.panel, sortie=v.sortie, image=v.image, corners_px=v.region_px) for v in values
        ]
        progress("images", done, len(frames))


def _brightness(
    data: CampaignData,
    sortie: SortieData,
    exposure: Exposure,
    values: list[ImagePanelObservation],
    findings: _Findings,
) -> None:
    """HSV V (the greatest channel) of the 8-bit preview inside each panel's region, 5.5 a."""
    path = (sortie.folder.images / exposure.image).with_suffix(".jpg")
    if data.camera is None or not path.is_file():
        return
    preview = read_preview(path, width_px=data.camera.width_px, height_px=data.camera.height_px)
    for value in values:
        rows, columns, _ = region_pixels(value.region_px)
        v = preview[rows, columns].max(axis=1).mean() / 255.0
        findings.brightness.setdefault(value.panel, []).append(float(v))


def _calibration(
    geometry: GeometryResult | None, reason: str | None, tools: Tools
) -> tuple[CalibrationResult | None, IndicatorValue]:
    if geometry is None:
        return None, not_measured("pixel", "(20)", "9.3", reason or "the mountings are not known")
    try:
        result = evaluate_calibration(geometry.problem, geometry.solution, mountings_solver(tools))
    except EvaluationError as error:
        return None, not_measured("pixel", "(20)", "9.3", str(error))
    return result, result.indicator


def _panel_values(
    data: CampaignData, lidar: PanelReflectances | None, camera: PanelReflectances | None
) -> tuple[PanelValue, ...]:
    def value(of: PanelReflectances | None, panel: str, column: str) -> float | None:
        if of is None or panel not in of.panels:
            return None
        return float(getattr(of, column)[of.panels.index(panel)])

    return tuple(
        PanelValue(
            id=t.id,
            nominal_percent=t.nominal_reflectance_percent or 0.0,
            lidar_percent=value(lidar, t.id, "measured_percent"),
            camera_percent=value(camera, t.id, "measured_percent"),
            laser_reference_percent=value(lidar, t.id, "reference_percent"),
            band_reference_percent=value(camera, t.id, "reference_percent"),
        )
        for t in sorted(data.targets, key=lambda t: t.id)
        if t.kind == "panel"
    )
