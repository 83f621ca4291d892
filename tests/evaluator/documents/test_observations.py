"""The evaluator's own picks as files, and a person's picks in their place. Returns, images and targets written by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from campaign.flight.las import LasSpec, Returns, StripReader, StripWriter
from campaign.flight.records import (
    CameraObservation,
    LidarObservation,
    read_camera_observations,
    read_lidar_observations,
    write_lidar_observations,
)
from campaign.manifest import write_manifest
from campaign.survey import write_targets
from evaluator.conformity import ConformityInputs, conformity_rows
from evaluator.documents.observations import rejected_marks, write_observations
from evaluator.frames import WorldFrame, body_pose
from evaluator.georeference import TargetReturns, collect_target_returns, nominal_mountings, world_points
from evaluator.load import load_campaign
from evaluator.model import CampaignData, MountingSolution
from evaluator.mounting.geometry import observe_vertices
from evaluator.observe.frustums import frustum_model
from evaluator.observe.panel_images import panel_image_values
from evaluator.observe.panels import lidar_panel_observations, panel_axes_world
from evaluator.observe.picks import PointNumbers, read_picked_points, target_points
from evaluator.results import Evaluation, Region

SLOPE = np.sqrt(2.0)
FACES = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]])


def _points_of_targets(data: CampaignData, rng: np.random.Generator) -> np.ndarray:
    """(n, 3) world points on and about every panel, and on the inner faces and the plate of every frustum."""
    frame = WorldFrame(data.manifest)
    parts = []
    for t in data.targets:
        if t.kind == "panel":
            centre, axes = panel_axes_world(t, frame)
            local = np.column_stack([rng.uniform(-1.4, 1.4, (700, 2)), np.zeros(700)])
            local[~(np.abs(local[:, :2]) <= 0.5 * t.size_m).all(axis=1), 2] = -0.17
            parts.append(centre + local @ axes)
            continue
        model = frustum_model(t, frame)
        run = rng.uniform(0.25, 0.5, 320) * t.size_m
        along, lateral = FACES[rng.integers(0, 4, 320)], rng.uniform(-1.0, 1.0, 320) * run
        across = along[:, ::-1] * [1.0, -1.0]
        local = np.column_stack([run[:, None] * along + lateral[:, None] * across, SLOPE * run])
        plate = np.column_stack([rng.uniform(-0.6, 0.6, (120, 2)), np.full(120, -0.15)])
        parts.append(model.vertex_world_m + np.concatenate([local, plate]) @ model.world_from_target.T)
    return np.concatenate(parts)


@pytest.fixture
def flown(campaign_data: CampaignData) -> CampaignData:
    """Strip 1 of sortie 1 on disk with returns about all 44 targets, nominal mounting, 4 mm of range noise, no waveforms."""
    rng = np.random.default_rng(11)
    data = campaign_data
    assert data.rig is not None
    nominal = nominal_mountings(data.rig)[1]
    frame, sortie = WorldFrame(data.manifest), data.sorties[0]
    trajectory = sortie.trajectory
    assert trajectory is not None
    point = _points_of_targets(data, rng)
    time = float(trajectory.gps_time_s[0]) + 5.0 + point[:, 1] / 5.0
    order = np.argsort(time)
    point, time = point[order], time[order]
    n = time.size
    position, world_from_body = body_pose(trajectory, time, frame)
    in_body = np.einsum("nji,nj->ni", world_from_body, point - position)
    p_lidar = (in_body - nominal.lever_arm_m) @ nominal.rotation
    range_m = np.linalg.norm(p_lidar, axis=1)
    p_lidar *= (1.0 + rng.normal(0.0, 0.004, n) / range_m)[:, None]
    xyz = frame.map_from_world(world_points(p_lidar, time, trajectory, nominal, frame))
    one = np.ones(n)
    returns = Returns(
        xyz_m=xyz,
        gps_time_s=time,
        intensity=one.astype(np.uint16),
        return_number=one.astype(np.uint8),
        number_of_returns=one.astype(np.uint8),
        scan_angle_deg=np.zeros(n, np.float32),
        encoder_angle_deg=np.zeros(n, np.float32),
        channel=np.zeros(n, np.uint8),
        amplitude=np.where(np.arange(n) % 97, rng.normal(800.0, 20.0, n), 200.0).astype(np.float32),  # some grazed
        pulse_width_ns=np.full(n, 4.27, np.float32),
        reflectance_db=np.zeros(n, np.float32),
        strip=one.astype(np.uint16),
        packet=np.full(n, -1),
        return_location_ps=np.zeros(n, np.float32),
        wave_direction_m_ps=np.zeros((n, 3), np.float32),
    )
    spec = LasSpec(
        projection_epsg=4549,
        height_epsg=5737,
        creation_date="2026-06-12",
        system_identifier="hand",
        offset_m=tuple(np.floor(xyz[0])),
        sample_count=64,
        sampling_ps=1000,
        bit_depth=16,
        file_source_id=1,
    )
    sortie.folder.lidar.mkdir(parents=True)
    with StripWriter(sortie.folder.strip_las(1), sortie.folder.strip_points(1), spec) as writer:
        writer.write(returns, np.zeros((0, 64), np.uint16))
    return replace(data, sorties=(replace(sortie, strips=(1,)),))


def _returns(data: CampaignData) -> dict[tuple[int, int, str], TargetReturns]:
    centres = {t.id: np.array([t.easting_m, t.northing_m, t.height_m]) for t in data.targets}
    return collect_target_returns(data, centres, 2.2)


def _own_points(data: CampaignData) -> tuple[list, list, PointNumbers]:
    assert data.rig is not None
    mounting = nominal_mountings(data.rig)[1]
    returns = _returns(data)
    panels = lidar_panel_observations(data, returns, mounting)
    vertices = observe_vertices(data, returns, mounting, located=True)[0]
    return panels, vertices, target_points(data, returns, panels, vertices)


def _picked(data: CampaignData, evaluation: Evaluation, tmp_path: Path, points: PointNumbers) -> CampaignData:
    """The campaign with what the evaluator itself picked brought as a person's list."""
    own = replace(evaluation, data=data, companions={"target_points": points})
    files = write_observations(tmp_path / "observations", own)
    place = data.sorties[0].folder
    (tmp_path / "observations" / "01" / "observations_lidar.csv").rename(place.observations_lidar)
    assert [f.name for f in files][:2] == ["observations_camera.csv", "observations_lidar.csv"]
    found, wrong = read_picked_points(place, (1,), [t.id for t in data.targets])
    assert not wrong
    return replace(data, sorties=(replace(data.sorties[0], picked_points=found),))


def test_own_points_brought_back_give_the_same(flown: CampaignData, evaluation: Evaluation, tmp_path: Path) -> None:
    """Rationale: the files are the proof of what was measured; a laboratory that brings them back must get the same figures.
    Expected: every panel and vertex again, from exactly the points named. Tolerance: panels 1e-9 (the same points in the same
    order), vertices 0.3 mm: Huber weights of the fit rest on the median residual, which moves when outliers are gone."""
    panels, vertices, points = _own_points(flown)
    assert len(panels) == 20 and len(vertices) == 24 and len(points) == 44
    again = _picked(flown, evaluation, tmp_path, points)
    assert again.sorties[0].picked_points.keys() == {(1, t) for _, _, t in points}
    panels_again, vertices_again, points_again = _own_points(again)
    for a, b in zip(panels, panels_again, strict=True):
        assert (b.panel, b.used, b.picked_by) == (a.panel, a.used, "person")
        assert (b.amplitude_dn, b.range_m, b.cos_incidence) == pytest.approx(
            (a.amplitude_dn, a.range_m, a.cos_incidence), rel=1e-9
        )
    for v, w in zip(vertices, vertices_again, strict=True):
        assert v.target == w.target
        assert np.linalg.norm(v.point_lidar_m - w.point_lidar_m) < 3e-4
    for key, numbers in points_again.items():
        assert np.isin(numbers, points[key]).all()


def test_points_are_records_of_the_file(flown: CampaignData) -> None:
    """Rationale: a number is worth something only if it leads to the point. Expected: the records named for a panel lie on its
    face, those of a frustum within its rim. Tolerance: 2 cm in height (4 mm of range noise), half the edge in plan."""
    frame = WorldFrame(flown.manifest)
    _, _, points = _own_points(flown)
    xyz = np.concatenate([c.xyz_m for _, c in StripReader(flown.sorties[0].folder.strip_las(1)).chunks()])
    world = frame.world_from_map(xyz)
    for t in flown.targets:
        mine = world[points[1, 1, t.id]]
        if t.kind == "panel":
            centre, axes = panel_axes_world(t, frame)
            local = (mine - centre) @ axes.T
            assert np.abs(local[:, 2]).max() < 0.02 and np.abs(local[:, :2]).max() <= 0.5 * t.size_m
        else:
            model = frustum_model(t, frame)
            local = (mine - model.vertex_world_m) @ model.world_from_target
            assert local[:, 2].min() > 0.3 * t.size_m and np.abs(local[:, :2]).max() < 0.52 * t.size_m


def test_no_other_points_are_used(flown: CampaignData) -> None:
    """Rationale: 8.3.2 c gives the choice to the person, even where it differs from the program's. Expected: ten named points of
    P01, one of them an outlier, make its mean; the ground beside P02, named for it, makes P02's. Other targets as before."""
    panels, _, points = _own_points(flown)
    returns = _returns(flown)
    rows = returns[1, 1, "P02"]
    ground = np.setdiff1d(rows.record, points[1, 1, "P02"])[:40]
    own = returns[1, 1, "P01"]
    grazed = own.record[own.returns.amplitude < 300.0]
    assert grazed.size and not np.isin(grazed, points[1, 1, "P01"]).any()  # the evaluator leaves them out
    ten = np.sort(np.append(points[1, 1, "P01"][:9], grazed[0]))
    sortie = replace(flown.sorties[0], picked_points={(1, "P01"): ten, (1, "P02"): np.sort(ground)})
    again = {o.panel: o for o in _own_points(replace(flown, sorties=(sortie,)))[0]}
    amplitude = dict(zip(returns[1, 1, "P01"].record, returns[1, 1, "P01"].returns.amplitude, strict=True))
    assert again["P01"].used == 10
    assert again["P01"].amplitude_dn == pytest.approx(np.mean([amplitude[i] for i in ten]), rel=1e-6)
    assert again["P02"].record.tolist() == np.sort(ground).tolist()
    for o in panels[2:]:
        assert again[o.panel].amplitude_dn == o.amplitude_dn and again[o.panel].picked_by == "evaluator"


def test_picks_are_found_in_any_chunk(flown: CampaignData) -> None:
    """Rationale: strips are streamed. Expected: the same records whether a strip comes in one piece or in pieces of 1000."""
    picked = {(1, "P01"): np.array([3, 999, 1000, 4321, 15_000])}
    data = replace(flown, sorties=(replace(flown.sorties[0], picked_points=picked),))
    target = next(t for t in flown.targets if t.id == "P01")
    centre = {"P01": np.array([target.easting_m, target.northing_m, target.height_m])}
    whole, pieces = (collect_target_returns(data, centre, 2.2, points_per_chunk=n)[1, 1, "P01"] for n in (10**6, 1000))
    assert whole.record.tolist() == pieces.record.tolist() == picked[1, "P01"].tolist()
    assert pieces.returns.xyz_m.tolist() == whole.returns.xyz_m.tolist() and pieces.picked_by == "person"


def test_bad_numbers_are_refused_by_name(flown: CampaignData) -> None:
    """Rationale: a list that belongs to another file must not pick points at random. Expected: one line each for a number beyond
    the file, a strip and a target that are not there, which say where, what and the limit; the good target is kept."""
    place = flown.sorties[0].folder
    rows = [
        LidarObservation(target="P01", strip=1, point=7),
        LidarObservation(target="P01", strip=1, point=7),
        LidarObservation(target="P02", strip=1, point=3),
        LidarObservation(target="P02", strip=1, point=99_999_999),
        LidarObservation(target="P03", strip=9, point=3),
        LidarObservation(target="P99", strip=1, point=3),
    ]
    write_lidar_observations(place.observations_lidar, rows)
    root = flown.folder.root
    write_manifest(root, flown.manifest)
    flown.folder.targets.parent.mkdir()
    write_targets(flown.folder.targets, list(flown.targets), flown.manifest.projection_epsg, flown.manifest.height_epsg)
    read = load_campaign(root)
    assert {k: v.tolist() for k, v in read.sorties[0].picked_points.items()} == {(1, "P01"): [7]}
    lines = [p for p in read.problems if "observations_lidar" in p]
    assert len(lines) == 3 and not any(str(root) in line for line in lines)
    beyond = next(line for line in lines if "P02" in line)
    assert "sorties/01/observations_lidar.csv" in beyond and "out of range" in beyond
    assert "99999999" in beyond and "0 to " in beyond and "strip_01.las" in beyond
    assert any("P03" in line and "strip 9" in line for line in lines) and any("P99" in line for line in lines)


def test_pixels_of_the_evaluator_and_of_a_person(evaluation: Evaluation, campaign_data: CampaignData) -> None:
    """Rationale: 8.3.2 c for images. Expected: the region that was read, brought back as four picks in any order, gives the same
    mean bit by bit; one pick in the panel's middle moves the outline there; the others are the evaluator's. Tolerance: none, but
    for the moved outline, whose values are a plane's: its mean is the plane at its centre, half a pixel's slope."""
    data, sortie = campaign_data, campaign_data.sorties[0]
    assert data.camera is not None and data.rig is not None and sortie.trajectory is not None
    exposure = sortie.exposures[0]
    rows, columns = np.mgrid[: data.camera.height_px, : data.camera.width_px].astype(np.float32)
    image = np.repeat((1000.0 + columns + 2.0 * rows)[..., None], 3, axis=2)
    panels = [t for t in data.targets if t.kind == "panel"]
    camera = nominal_mountings(data.rig)[0]
    frame = WorldFrame(data.manifest)

    def values(picked: list[CameraObservation]) -> dict:
        found = panel_image_values(
            image, exposure, 1, panels, data.camera, camera, sortie.trajectory, frame, picked=picked
        )
        return {o.panel: o for o in found}

    own = values([])
    first, second, *rest = own

    def pick(name: str, uv: np.ndarray) -> CameraObservation:
        return CameraObservation(target=name, image=exposure.image, u_px=float(uv[0]), v_px=float(uv[1]))

    centre = own[second].region_px.mean(axis=0) + [12.0, -5.0]
    again = values([pick(first, own[first].region_px[k]) for k in (2, 0, 3, 1)] + [pick(second, centre)])
    assert again[first].mean_dn == own[first].mean_dn and again[first].pixels == own[first].pixels
    assert again[first].picked_by == again[second].picked_by == "person"
    expected = 1000.0 + centre[0] - 0.5 + 2.0 * (centre[1] - 0.5) - data.camera.black_level_dn
    assert again[second].mean_dn[0] == pytest.approx(expected, abs=1.5)
    assert all(again[name].mean_dn == own[name].mean_dn and again[name].picked_by == "evaluator" for name in rest)


def test_files_hold_every_pick_but_blunders(
    evaluation: Evaluation, mounting_solution: MountingSolution, tmp_path: Path
) -> None:
    """Rationale: what stands behind the figures, no more: a mark that the adjustment left out would come back as a person's word.
    Expected: 4 corners of each of 20 panels and 24 marks less the rejected one in sortie 1, pixel by pixel as in the
    evaluation; points sorted, each once; the same bytes again."""
    solution = replace(mounting_solution, rejected=("mark of F03 in s01_000.tif (sortie 1): 5.2 sigma",))
    points = {(1, 1, "F01"): np.array([3, 9]), (2, 4, "P02"): np.array([1, 2, 8])}
    kept = replace(evaluation, mounting=solution, companions={"target_points": points})
    assert rejected_marks(kept) == {(1, "s01_000.tif", "F03")}
    files = write_observations(tmp_path / "a", kept)
    assert [str(f.relative_to(tmp_path / "a")) for f in files] == [
        f"{n}/observations_{what}.csv" for n in ("01", "02") for what in ("camera", "lidar")
    ]
    rows = read_camera_observations(files[0])
    assert len(rows) == 4 * 20 + 23 and not any(r.target == "F03" for r in rows)
    region = next(r for r in evaluation.regions if isinstance(r, Region) and (r.target, r.sortie) == ("P07", 1))
    assert [[r.u_px, r.v_px] for r in rows if r.target == "P07"] == region.corners_px.tolist()
    mark = next(m for m in evaluation.marks if (m.target, m.sortie) == ("F11", 1))
    assert [[r.u_px, r.v_px] for r in rows if r.target == "F11"] == [mark.uv_px.tolist()]
    assert [(r.target, r.strip, r.point) for r in read_lidar_observations(files[3])] == [
        ("P02", 4, n) for n in (1, 2, 8)
    ]
    again = write_observations(tmp_path / "b", kept)
    assert [f.read_bytes() for f in again] == [f.read_bytes() for f in files]


@pytest.mark.parametrize(
    ("camera", "points", "status", "words"),
    [
        ("evaluator", False, "warning", "found by the evaluator"),
        ("evaluator", True, "warning", "LiDAR points from the campaign's observation records"),
        ("person", False, "pass", "pixels from the campaign's observation records"),
        ("person", True, "pass", "pixels and LiDAR points"),
    ],
)
def test_who_picked_is_said(
    campaign_data: CampaignData, conformity_inputs: ConformityInputs, camera: str, points: bool, status: str, words: str
) -> None:
    """Rationale: 8.3.2 c asks for a person. Expected: the row tells pixels and points apart; points alone are not enough."""
    picked = {(1, "P01"): np.array([1, 2])} if points else {}
    sorties = (replace(campaign_data.sorties[0], picked_points=picked), *campaign_data.sorties[1:])
    rows = conformity_rows(replace(campaign_data, sorties=sorties), replace(conformity_inputs, panels_picked_by=camera))
    row = next(r for r in rows if r.clause == "8.3.2 c")
    assert row.status == status and words in row.measured
    frustums = next(r for r in rows if r.clause == "9.3.2 c")
    assert frustums.status == "warning" and "LiDAR points" not in frustums.measured
