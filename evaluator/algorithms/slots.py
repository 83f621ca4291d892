"""What goes into each replaceable algorithm and what comes out: records of NumPy arrays and numbers, nothing of a campaign's files.

An algorithm is a callable with one positional argument, the task of its slot. It returns the slot's record, or a mapping with
the record's names as keys, or, where the task allows it, a line of text that says why nothing was found. It changes nothing
in the task. Frames and signs: docs/conventions.md. The evaluator's own algorithms are in `own`, checks of results in `check`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from evaluator.model import EvaluationError

if TYPE_CHECKING:
    from evaluator.boards.board_model import BoardProblem, Views
    from evaluator.boards.board_observations import BoardObservation
    from evaluator.mounting.mounting_model import Problem


@dataclass(frozen=True, kw_only=True)
class EchoTask:
    """Waveform packets of one strip that belong to returns on the panels (8.1.2 e)."""

    samples_dn: np.ndarray  # (p, s) float64 with baseline; NaN: no such sample, packets may differ in length [DN]
    sampling_ns: float  # interval of the samples
    echo_fwhm_ns: float  # width of the echo of a flat target, by the data sheet
    saturation_dn: float  # samples at or above this are clipped; infinite where not known [DN]


@dataclass(frozen=True, kw_only=True)
class FoundEchoes:
    """m echoes of p packets, in any order; a packet may have none."""

    packet: np.ndarray  # (m,) int row of the packet
    amplitude_dn: np.ndarray  # (m,) peak above the baseline, linear [DN]
    centre_ns: np.ndarray  # (m,) after the packet's first sample [ns]
    fwhm_ns: np.ndarray | None = None  # (m,) full width at half maximum; None or NaN: not estimated [ns]
    baseline_dn: np.ndarray | None = None  # (p,) for the report's picture; None or NaN: not estimated [DN]


@dataclass(frozen=True, kw_only=True)
class PanelTask:
    """Returns of one strip near one reflectance panel. Panel frame: origin at the predicted centre of its top face, x and y along
    its edges, z up."""

    points_m: np.ndarray  # (n, 3) panel frame [m]
    amplitude_dn: np.ndarray  # (n,) linear, as the file has it [DN]
    range_m: np.ndarray  # (n,) [m]
    cos_incidence: np.ndarray  # (n,) on the level panel
    single_return: np.ndarray  # (n,) bool: the pulse's only return
    size_m: float  # edge of the panel [m]
    divergence_rad: float  # full angle of the beam at 1/e^2 [rad]
    searched: bool  # the mounting is not known: the panel may be `reach_m` from its predicted place
    reach_m: float = 1.2  # 0.5 where the strip's other panels tell the common displacement, which is then taken off [m]


@dataclass(frozen=True, kw_only=True)
class FoundPanel:
    """Which returns lie on the panel."""

    inside: np.ndarray  # (k,) int rows on the panel, for the count of 5.5 b
    clear: np.ndarray  # (j,) int rows whose whole footprint is on it: the panel's amplitude and range are their means
    # the panel against its predicted place
    shift_m: np.ndarray = field(default_factory=lambda: np.zeros(2))  # (2,) [m]
    height_m: float | None = None  # of the panel against its predicted height; None: median of `clear` [m]


@dataclass(frozen=True, kw_only=True)
class MarkTask:
    """One image and one frustum target's mark in it: four sectors, white where target x times y is positive (9.3.2 e).

    Target frame: origin at the mark's centre, x right, y along the target's surveyed azimuth, z up."""

    grey: np.ndarray  # (h, w) float32 mean of the bands, linear, black level not removed [DN]
    predicted_px: (
        np.ndarray
    )  # (2,) u right, v down; the image's corner is (0, 0), the first pixel's centre (0.5, 0.5) [px]
    search_radius_px: float  # how far the mark may be from there [px]
    px_per_m: np.ndarray  # (2, 2) step in pixels (rows u, v) by target x and y (columns) [px/m]
    radius_m: float  # of the mark [m]
    sheets_m: np.ndarray  # (4, 8, 3) corners of the funnel's sheets, target frame: what may hide or shade the mark [m]
    eye_m: np.ndarray  # (3,) projection centre, target frame [m]
    to_sun: np.ndarray | None  # (3,) unit vector, target frame; None: no sun
    clipped_at: float  # grey values from here on are saturated [DN]


@dataclass(frozen=True, kw_only=True)
class FoundMark:
    """The mark's centre."""

    uv_px: np.ndarray  # (2,) as in the image, distorted [px]
    covariance_px2: np.ndarray  # (2, 2) [px^2]


@dataclass(frozen=True, kw_only=True)
class VertexTask:
    """Returns of one strip near one frustum target (9.3.2 d). Target frame: origin at the stated place of the vertex, x right, y
    along the surveyed azimuth, z up. Faces stand at 54.74 degrees; point = origin_m + range_m * direction."""

    origin_m: np.ndarray  # (n, 3) the sensor when it measured each return, target frame [m]
    direction: np.ndarray  # (n, 3) unit vectors of the beams, target frame
    range_m: np.ndarray  # (n,) measured [m]
    single_return: np.ndarray  # (n,) bool: the pulse's only return; others may be mixed with an edge
    long_edge_m: float  # b, edge of the large rim; small rim b/2; both are 0.7071 b and 0.3536 b from the vertex [m]
    inverted: bool  # the faces open upwards from the vertex; else they fall from it
    thickness_m: float  # of the sheet: a beam on a face's other side meets a plane this much further in [m]
    normals: np.ndarray  # (4, 3) of the stated faces, unit, towards the side that is seen from above
    face_angle_std_rad: float  # how well the faces keep their angles [rad]
    range_std_m: float  # noise of a range, along the beam [m]
    encoder_std_rad: float  # noise of a beam's direction [rad]
    footprint_m: float  # radius of the beam at 1/e^2 at the median range [m]
    located: bool  # the mounting is known: the vertex is within centimetres of the origin; else within 1.5 m

    @property
    def points_m(self) -> np.ndarray:
        """(n, 3) returns in the target frame. [m]"""
        return np.asarray(self.origin_m + self.range_m[:, None] * self.direction)


@dataclass(frozen=True, kw_only=True)
class FoundVertex:
    """The common vertex of the four stated face planes."""

    vertex_m: np.ndarray  # (3,) target frame [m]
    covariance_m2: np.ndarray  # (3, 3) [m^2]
    used: np.ndarray  # (k,) int rows that it rests on
    faces: int | None = None  # planes used; None: as many as `used` lies on
    rms_m: float | None = None  # of the residuals [m]
    variance_factor: float = 1.0  # multiplies covariance_m2


@dataclass(frozen=True, kw_only=True)
class ReflectanceTask:
    """Panels of one design height: those with known reflectance, and those whose reflectance is asked for (8.1.2 f-h)."""

    amplitude_dn: np.ndarray  # (n,) linear [DN]
    range_m: np.ndarray  # (n,) [m]
    reflectance_percent: np.ndarray  # (n,) by the spectrometer at the laser's wavelength [%]
    at_amplitude_dn: np.ndarray  # (m,) [DN]
    at_range_m: np.ndarray  # (m,) [m]


@dataclass(frozen=True, kw_only=True)
class ExtrinsicTask:
    """All marks and vertices of a campaign, for both mountings (9.3.2 f-i, formulas (21)-(24)).

    A target seen by the camera at t_e and by the LiDAR at t_s:
    p_camera = camera_from_body body_from_world(t_e) world_from_body(t_s) body_from_lidar p_lidar.
    Poses are world_from_body as navigation gives them. A lens is fx fy cx cy [px] k1 k2 k3 p1 p2.
    """

    targets: tuple[str, ...]  # t names, in the order of the indices below
    mark_world_m: np.ndarray  # (t, 3) surveyed centre of the mark [m]
    mark_world_covariance_m2: np.ndarray  # (t, 3, 3) [m^2]
    vertex_from_mark_m: np.ndarray  # (t, 3) stated vertex minus mark, world axes [m]
    mark_target: np.ndarray  # (n,) int
    mark_sortie: np.ndarray  # (n,) int
    mark_strip: np.ndarray  # (n,) int
    mark_time_s: np.ndarray  # (n,) adjusted GPS time [s]
    mark_uv_px: np.ndarray  # (n, 2) distorted pixels [px]
    mark_covariance_px2: np.ndarray  # (n, 2, 2) [px^2]
    mark_body_m: np.ndarray  # (n, 3) body's origin at that time, world [m]
    mark_world_from_body: np.ndarray  # (n, 3, 3)
    vertex_target: np.ndarray  # (k,) int
    vertex_sortie: np.ndarray  # (k,) int
    vertex_strip: np.ndarray  # (k,) int
    vertex_time_s: np.ndarray  # (k,) [s]
    vertex_lidar_m: np.ndarray  # (k, 3) LiDAR frame [m]
    vertex_covariance_m2: np.ndarray  # (k, 3, 3) LiDAR frame [m^2]
    vertex_body_m: np.ndarray  # (k, 3) [m]
    vertex_world_from_body: np.ndarray  # (k, 3, 3)
    lens: np.ndarray  # (9,)
    lens_covariance: np.ndarray  # (9, 9)
    camera_rotation: np.ndarray  # (3, 3) body_from_camera by the drawing
    camera_lever_arm_m: np.ndarray  # (3,) [m]
    lidar_rotation: np.ndarray  # (3, 3) body_from_lidar by the drawing
    lidar_lever_arm_m: np.ndarray  # (3,) [m]
    prior_std: np.ndarray  # (12,) of the drawing: camera roll pitch yaw [rad], x y z [m], LiDAR the same
    position_std_m: np.ndarray  # (3,) of the navigation, world axes; constant within a strip [m]
    attitude_std_rad: np.ndarray  # (3,) roll pitch heading [rad]
    problem: "Problem" = field(repr=False)  # the evaluator's own form, for its own solver; not part of the interface


@dataclass(frozen=True, kw_only=True)
class FoundMountings:
    """Both mountings, body_from_sensor."""

    camera_rotation: np.ndarray  # (3, 3) body_from_camera
    camera_lever_arm_m: np.ndarray  # (3,) [m]
    lidar_rotation: np.ndarray  # (3, 3) body_from_lidar
    lidar_lever_arm_m: np.ndarray  # (3,) [m]
    covariance: np.ndarray  # (12, 12) camera roll pitch yaw [rad], x y z [m], LiDAR the same; turns about body axes


@dataclass(frozen=True, kw_only=True)
class MountingTask:
    """Centres of the patent's 2x2 boards in the images, for the camera's mounting (steps S5 to S7)."""

    boards: tuple[str, ...]  # b names
    board_world_m: np.ndarray  # (b, 3) surveyed centres [m]
    board_covariance_m2: np.ndarray  # (b, 3, 3) [m^2]
    board: np.ndarray  # (n,) int index of the board of each observation
    sortie: np.ndarray  # (n,) int
    strip: np.ndarray  # (n,) int
    time_s: np.ndarray  # (n,) adjusted GPS time [s]
    uv_px: np.ndarray  # (n, 2) distorted pixels [px]
    covariance_px2: np.ndarray  # (n, 2, 2) [px^2]
    body_m: np.ndarray  # (n, 3) body's origin, world [m]
    world_from_body: np.ndarray  # (n, 3, 3)
    lens: np.ndarray  # (9,) fx fy cx cy [px] k1 k2 k3 p1 p2
    lens_covariance: np.ndarray  # (9, 9)
    camera_rotation: np.ndarray  # (3, 3) body_from_camera by the drawing
    camera_lever_arm_m: np.ndarray  # (3,) [m]
    prior_std: np.ndarray  # (6,) of the drawing: roll pitch yaw [rad], x y z [m]
    problem: "BoardProblem" = field(repr=False)  # this and the two below: for the evaluator's own solver, as above
    views: "Views" = field(repr=False)
    observations: tuple["BoardObservation", ...] = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class FoundCameraMounting:
    """The camera's mounting, body_from_camera."""

    camera_rotation: np.ndarray  # (3, 3)
    camera_lever_arm_m: np.ndarray  # (3,) [m]
    covariance: np.ndarray  # (6, 6) roll pitch yaw [rad], x y z [m]


class AlgorithmFailure(EvaluationError):
    """An algorithm that is not ours raised, took too long, or gave what its slot does not take; the text names slot and name."""


Answer = Mapping[str, Any]  # a record as a mapping of its names


class EchoDecomposition(Protocol):
    """Waveform packets to echoes."""

    def __call__(self, task: EchoTask, /) -> FoundEchoes | Answer: ...


class PanelFinding(Protocol):
    """Which returns lie on a reflectance panel; a text: not found, and why."""

    def __call__(self, task: PanelTask, /) -> FoundPanel | Answer | str: ...


class MarkFinding(Protocol):
    """The centre of a frustum target's mark in an image; a text: not found, and why."""

    def __call__(self, task: MarkTask, /) -> FoundMark | Answer | str: ...


class VertexEstimation(Protocol):
    """The common vertex of a frustum target's faces; a text: not found, and why."""

    def __call__(self, task: VertexTask, /) -> FoundVertex | Answer | str: ...


class ReflectanceModel(Protocol):
    """Amplitude and range to reflectance: (m,) percent at the places asked for."""

    def __call__(self, task: ReflectanceTask, /) -> np.ndarray: ...


class ExtrinsicSolver(Protocol):
    """Marks and vertices to both mountings."""

    def __call__(self, task: ExtrinsicTask, /) -> FoundMountings | Answer: ...


class MountingSolver(Protocol):
    """Boards' centres to the camera's mounting."""

    def __call__(self, task: MountingTask, /) -> FoundCameraMounting | Answer: ...
