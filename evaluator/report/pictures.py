"""Which drawings stand in which section of the page, each as a data URI, or the reason why there is none."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

from campaign.errors import TestrangeError
from evaluator.report import bench_plots, plots, radiometry_plots
from evaluator.report.style import svg_uri
from evaluator.report.texts import Texts
from evaluator.results import Evaluation
from evaluator.scores.score import Score


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A drawing, or the reason why there is none."""

    title: str
    caption: str
    uri: str | None
    reason: str = ""


class _Album:
    """Drawings by section, in order."""

    def __init__(self, t: Texts) -> None:
        self.t = t
        self.pages: dict[str, list[Picture]] = {}

    def add(
        self, section: str, key: str, draw: Callable[[], Figure | None], title: str = "", caption: str | None = None
    ) -> None:
        """Draws; an error that is the input's fault becomes the picture's reason."""
        named = {"title": title or self.t(f"p_{key}"), "caption": self.t(f"c_{key}") if caption is None else caption}
        try:
            drawn = draw()
            uri = None if drawn is None else svg_uri(drawn)
            reason = self.t("nothing_observed") if drawn is None else ""
        except TestrangeError as error:
            uri, reason = None, str(error)
        self.pages.setdefault(section, []).append(Picture(**named, uri=uri, reason=reason))


def pictures(
    evaluation: Evaluation, results: Mapping[str, Any], score: Score | None, t: Texts
) -> dict[str, list[Picture]]:
    """Every drawing but the photographs. Sections: flight, mounting, boards, diagnosis, truth, and the indicators' ids."""
    album = _Album(t)
    _flight(album, evaluation)
    _radiometry(album, evaluation)
    _benches(album, evaluation)
    _mounting(album, evaluation, results)
    if evaluation.deviations:
        album.add("diagnosis", "diagnosis", lambda: plots.deviation_bars(evaluation.deviations, t))
    if score is not None and score.items:
        album.add("truth", "score", lambda: plots.truth_errors(score, t))
    return album.pages


def _flight(album: _Album, evaluation: Evaluation) -> None:
    data, t = evaluation.data, album.t
    if data is None:
        return
    if data.targets or data.sorties or data.plan is not None:
        album.add("flight", "layout", lambda: plots.layout(data, t))
    for sortie in data.sorties:
        if sortie.trajectory is not None:
            album.add(
                "flight",
                "profile",
                lambda s=sortie: plots.profile(evaluation, data, s, t),  # type: ignore[misc]
                title=t("p_profile", n=sortie.folder.number),
            )


def _radiometry(album: _Album, evaluation: Evaluation) -> None:
    t = album.t
    if evaluation.waveforms:
        album.add("lidar_reflectance_rmse", "waveforms", lambda: radiometry_plots.waveforms(evaluation.waveforms, t))
    if evaluation.indicator("lidar_reflectance_rmse").companions.get("surfaces"):
        album.add("lidar_reflectance_rmse", "surface", lambda: radiometry_plots.surfaces(evaluation, t))
    if evaluation.panels:
        album.add("reflectance_correlation", "reflectance", lambda: radiometry_plots.reflectance(evaluation, t))


def _benches(album: _Album, evaluation: Evaluation) -> None:
    """Those of 8.2, 9.1 and 9.2 that the campaign has."""
    sphere, board, ranging, t = evaluation.sphere, evaluation.chessboard, evaluation.ranging, album.t
    if sphere is not None and (sphere.stability_series or sphere.repeatability_series):
        section = "camera_stability" if sphere.stability_series else "camera_repeatability"
        album.add(section, "sphere", lambda: bench_plots.sphere_series(sphere, t))
    if board is not None and (board.images or board.lens is not None):
        section = "camera_reprojection_error"
        album.add(section, "chessboard", lambda: bench_plots.board_residuals(board, t))
        album.add(section, "coverage", lambda: bench_plots.coverage(board, t))
        album.add(section, "distortion", lambda: bench_plots.distortion_map(board, t))
        album.add(section, "lens_correlations", lambda: bench_plots.lens_correlations(board, t))
        album.add(section, "image_errors", lambda: bench_plots.image_errors(board, t))
    if ranging is not None and ranging.panels:
        album.add("lidar_ranging_rmse_relative", "ranging", lambda: bench_plots.ranging_errors(ranging, t))


def _mounting(album: _Album, evaluation: Evaluation, results: Mapping[str, Any]) -> None:
    t, block = album.t, results["mounting"]
    if evaluation.residuals:
        album.add("calibration_error", "residuals", lambda: plots.residual_vectors(evaluation, t))
    if evaluation.indicator("calibration_error").companions.get("per_target_px"):
        album.add("calibration_error", "targets", lambda: plots.target_errors(evaluation, t))
    if evaluation.mounting is not None:
        album.add("mounting", "correlations", lambda: plots.correlations(evaluation, t))
        album.add(
            "mounting",
            "relative_correlations",
            lambda: plots.block_correlations(block["camera_from_lidar"], t),
            caption=t("c_figures", level=0.1),
        )
    boards = block.get("boards") or {}
    if boards.get("status") == "measured":
        album.add("boards", "board_residuals", lambda: plots.board_residuals(evaluation, t))
        album.add(
            "boards",
            "board_correlations",
            lambda: plots.block_correlations(boards, t),
            caption=t("c_figures", level=0.1),
        )
