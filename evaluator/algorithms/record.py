"""The record of all seven slots. Whoever evaluates passes it on; a slot that nobody replaced holds the evaluator's own."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields

import numpy as np

from evaluator.algorithms import own
from evaluator.algorithms.slots import (
    EchoDecomposition,
    EchoTask,
    ExtrinsicSolver,
    ExtrinsicTask,
    FoundCameraMounting,
    FoundEchoes,
    FoundMark,
    FoundMountings,
    FoundPanel,
    FoundVertex,
    MarkFinding,
    MarkTask,
    MountingSolver,
    MountingTask,
    PanelFinding,
    PanelTask,
    ReflectanceModel,
    ReflectanceTask,
    VertexEstimation,
    VertexTask,
)


@dataclass(frozen=True, kw_only=True)
class Algorithms:
    """One algorithm for each slot."""

    echo_decomposition: EchoDecomposition = own.gaussian_decomposition
    panel_finding: PanelFinding = own.panel_by_place
    mark_finding: MarkFinding = own.four_sector_fit
    vertex_estimation: VertexEstimation = own.along_ray_vertex
    reflectance_model: ReflectanceModel = own.polynomial_surface
    extrinsic_solver: ExtrinsicSolver = own.joint_adjustment
    mounting_solver: MountingSolver = own.board_adjustment
    names: Mapping[str, str] = field(default_factory=dict)  # slot -> package.module:function of those that are not ours


@dataclass(frozen=True, kw_only=True)
class Tools:
    """The same, as the evaluator's rooms call them: results are checked, in the slot's record, and a failure is an
    `AlgorithmFailure`. Made by `guard.guarded`."""

    echo_decomposition: Callable[[EchoTask], FoundEchoes] = own.gaussian_decomposition
    panel_finding: Callable[[PanelTask], FoundPanel | str] = own.panel_by_place
    mark_finding: Callable[[MarkTask], FoundMark | str] = own.four_sector_fit
    vertex_estimation: Callable[[VertexTask], FoundVertex | str] = own.along_ray_vertex
    reflectance_model: Callable[[ReflectanceTask], np.ndarray] = own.polynomial_surface
    extrinsic_solver: Callable[[ExtrinsicTask], FoundMountings] | None = (
        None  # None: `adjustment`, with all its companions
    )
    mounting_solver: Callable[[MountingTask], FoundCameraMounting] | None = None  # None: `mounting_by_boards`, the same
    replaced: Mapping[str, str] = field(default_factory=dict)  # slot -> name of the algorithm that is not ours


SLOTS = tuple(f.name for f in fields(Algorithms) if f.name != "names")
OWN = Algorithms()
OWN_TOOLS = Tools()
