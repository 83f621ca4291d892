"""The evaluator's own algorithm for each slot, in the slot's form: what stands in a slot that nobody replaced.

Each imports its room when it is called; the methods live there.
"""

import numpy as np

from evaluator.algorithms.slots import (
    EchoTask,
    ExtrinsicTask,
    FoundCameraMounting,
    FoundEchoes,
    FoundMark,
    FoundMountings,
    FoundPanel,
    FoundVertex,
    MarkTask,
    MountingTask,
    PanelTask,
    ReflectanceTask,
    VertexTask,
)


def gaussian_decomposition(task: EchoTask, /) -> FoundEchoes:
    """Sums of Gaussians, weighted by the noise (`observe.waveforms`)."""
    from evaluator.observe.waveforms import decompose

    saturation = task.saturation_dn if np.isfinite(task.saturation_dn) else None
    found = decompose(task.samples_dn, task.sampling_ns, echo_fwhm_ns=task.echo_fwhm_ns, saturation_dn=saturation)
    return FoundEchoes(
        packet=found.packet,
        amplitude_dn=found.amplitude_dn,
        centre_ns=found.centre_ns,
        fwhm_ns=found.fwhm_ns,
        baseline_dn=found.packet_baseline_dn,
    )


def panel_by_place(task: PanelTask, /) -> FoundPanel | str:
    """Where survey and mounting put it, or by contrast near there (`observe.panels`)."""
    from evaluator.observe.panels import find_on_panel

    return find_on_panel(task)


def four_sector_fit(task: MarkTask, /) -> FoundMark | str:
    """Least squares on the mark's predicted appearance (`observe.marks`)."""
    from evaluator.observe.mark_view import MarkView
    from evaluator.observe.marks import find_mark

    view = MarkView(
        predicted_px=task.predicted_px,
        px_per_m=task.px_per_m,
        radius_m=task.radius_m,
        sheets_m=task.sheets_m,
        eye_m=task.eye_m,
        to_sun=task.to_sun,
    )
    found = find_mark(task.grey, view, task.search_radius_px, clipped_at=task.clipped_at)
    return found if isinstance(found, str) else FoundMark(uv_px=found.uv_px, covariance_px2=found.covariance_px2)


def along_ray_vertex(task: VertexTask, /) -> FoundVertex | str:
    """Four planes through one point, residuals along the ray (`observe.frustums`)."""
    from evaluator.observe.frustums import fit_vertex

    return fit_vertex(task)


def polynomial_surface(task: ReflectanceTask, /) -> np.ndarray:
    """Second-order polynomial f(A, L) by least squares (`c8_1_lidar_reflectance`)."""
    from evaluator.c8_1_lidar_reflectance import fit_reflectance_surface

    surface = fit_reflectance_surface(task.amplitude_dn, task.range_m, task.reflectance_percent)
    return surface(task.at_amplitude_dn, task.at_range_m)


def joint_adjustment(task: ExtrinsicTask, /) -> FoundMountings:
    """Both mountings in one adjustment with data snooping (`adjustment`)."""
    from evaluator.mounting.adjustment import solve_mountings

    found = solve_mountings(task.problem)
    return FoundMountings(
        camera_rotation=found.body_from_camera.rotation,
        camera_lever_arm_m=found.body_from_camera.lever_arm_m,
        lidar_rotation=found.body_from_lidar.rotation,
        lidar_lever_arm_m=found.body_from_lidar.lever_arm_m,
        covariance=found.covariance[:12, :12],
    )


def board_adjustment(task: MountingTask, /) -> FoundCameraMounting:
    """Gauss-Newton on the boards' centres with blunders named (`mounting_by_boards`)."""
    from evaluator.boards.mounting_by_boards import solve_board_problem
    from evaluator.georeference import nominal_mountings
    from evaluator.mounting.mounting_model import mounting_of

    found = solve_board_problem(task.problem, task.views, list(task.observations))
    mounting = mounting_of(nominal_mountings(task.problem.rig)[0], found.parameters)
    return FoundCameraMounting(
        camera_rotation=mounting.rotation, camera_lever_arm_m=mounting.lever_arm_m, covariance=found.covariance
    )
