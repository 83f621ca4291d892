"""What every export starts from: the campaign, the mountings and the lens that hold, poses of images, points in the world.

With results the adjusted mountings, clocks, interior orientation and ranges hold, without them the sheets'. No file format and
no formula of its own: frames and cameras are the evaluator's.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from campaign.config import Lens
from campaign.errors import CampaignError
from campaign.flight.las import Returns, StripReader
from campaign.flight.records import Exposure
from campaign.flight.trajectory import Trajectory
from campaign.sensors import CameraSheet, Rig
from campaign.survey import SurveyedTarget
from evaluator.camera_model import LENS_NAMES, lens_from_vector
from evaluator.frames import WorldFrame, body_pose, euler_angles
from evaluator.georeference import corrected_points, lidar_points, nominal_mountings, select_returns
from evaluator.georeference import world_points as placed
from evaluator.load import load_campaign
from evaluator.model import CampaignData, EvaluationError, Mounting, RangeCorrection, SortieData
from evaluator.results import read_results

# A camera that looks straight down with its image's top ahead, as turns of the body: x right, y back, z down.
_NADIR_CAMERA_FROM_BODY = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One image with its pose at the middle of the exposure."""

    name: str  # without suffix, unique in the campaign
    sortie: SortieData
    exposure: Exposure
    gps_time_s: float  # the camera clock's error taken off
    centre_world_m: np.ndarray  # (3,)
    world_from_camera: np.ndarray  # (3, 3), camera axes x right, y down, z forward
    position_std_m: np.ndarray  # (3,) north east down; NaN where it was not recorded

    @property
    def path(self) -> Path:
        return self.sortie.folder.images / self.exposure.image


@dataclass(frozen=True, kw_only=True)
class Source:
    """A campaign ready for export."""

    data: CampaignData
    frame: WorldFrame
    body_from_camera: Mounting | None
    body_from_lidar: Mounting | None
    lens: Lens | None
    camera_clock_s: float
    lidar_clock_s: float
    adjusted: bool
    results: Mapping[str, Any] | None
    results_folder: Path | None  # where results.json stands, with observations/
    basis: str  # one line: where mountings, lens and ranges come from

    @property
    def camera(self) -> CameraSheet:
        """The camera's sheet; raises CampaignError where there is none."""
        if self.data.camera is None:
            raise CampaignError("cannot be exported without sensors/camera.json", where=self.data.manifest.campaign)
        return self.data.camera

    @property
    def rig(self) -> Rig:
        """The mounting's sheet; raises CampaignError where there is none."""
        if self.data.rig is None:
            raise CampaignError("cannot be exported without sensors/rig.json", where=self.data.manifest.campaign)
        return self.data.rig

    @property
    def lens_or_nominal(self) -> Lens:
        """The interior orientation; without a certificate the nominal pinhole about the image's middle."""
        if self.lens is not None:
            return self.lens
        camera = self.camera
        focal = camera.nominal_focal_length_mm * 1000.0 / camera.pixel_size_um
        return Lens(fx_px=focal, fy_px=focal, cx_px=camera.width_px / 2.0, cy_px=camera.height_px / 2.0)

    def shots(self) -> list[Shot]:
        """Every image of the flight that can be placed, in order of sortie and table.

        Raises
        ------
        CampaignError
            There is none.
        """
        mounting = self.body_from_camera
        if mounting is None:
            self.rig  # noqa: B018 - names what is missing
            raise CampaignError("the camera's mounting is not known", where=self.data.manifest.campaign)
        found: list[Shot] = []
        for sortie, exposure, name in _named(self.data):
            trajectory = sortie.trajectory
            if trajectory is None:
                continue
            time = exposure.gps_time_s - self.camera_clock_s
            if not trajectory.gps_time_s[0] <= time <= trajectory.gps_time_s[-1]:
                continue
            position, world_from_body = (a[0] for a in body_pose(trajectory, np.array([time]), self.frame))
            found.append(
                Shot(
                    name=name,
                    sortie=sortie,
                    exposure=exposure,
                    gps_time_s=time,
                    centre_world_m=position + world_from_body @ mounting.lever_arm_m,
                    world_from_camera=world_from_body @ mounting.rotation,
                    position_std_m=np.array(
                        [np.interp(time, trajectory.gps_time_s, c) for c in trajectory.position_std_m.T]
                    ),
                )
            )
        if not found:
            remedy = "it needs sorties/NN/images/exposures.csv and sorties/NN/trajectory.out"
            raise CampaignError("no image that can be placed", where=self.data.manifest.campaign, remedy=remedy)
        return found

    def attitude_deg(self, shot: Shot) -> tuple[float, float, float]:
        """Roll, pitch and heading of the image as if it were the body's: zero pitch looks down, heading of its top edge. [deg]"""
        lat, lon, _ = self.frame.geodetic_from_world(shot.centre_world_m)
        ned_from_world = self.frame.world_from_local_ned(lat, lon).T
        roll, pitch, heading = np.degrees(
            euler_angles(ned_from_world @ shot.world_from_camera @ _NADIR_CAMERA_FROM_BODY)
        )
        return float(roll), float(pitch), float(heading % 360.0)

    def strips(self) -> list[tuple[SortieData, int]]:
        """Every LiDAR strip on disk; raises CampaignError where there is none."""
        found = [(sortie, strip) for sortie in self.data.sorties for strip in sortie.strips]
        if not found:
            raise CampaignError("no LiDAR strip", where=self.data.manifest.campaign, expected="sorties/NN/lidar")
        return found

    def points(self, sortie: SortieData, strip: int, rows: int = 500_000) -> Iterator[tuple[Returns, np.ndarray]]:
        """A strip's returns in pieces, with their world coordinates (n, 3). [m]

        Adjusted: through the adjusted mounting, clock and ranges; what lies outside the trajectory is left out. Else as
        the LAS file has them, which is by the nominal mounting.
        """
        unit = self.data.lidar.amplitude_unit if self.data.lidar is not None else "linear"
        path = self.data.folder.held(sortie.folder.strip_las(strip))
        reader = StripReader(path, gps_week=self.data.manifest.gps_week, amplitude_unit=unit)
        for _, block in reader.chunks(rows):
            if not self.adjusted:
                yield block, self.frame.world_from_map(block.xyz_m)
                continue
            if sortie.trajectory is None or self.body_from_lidar is None:
                return
            inside = _inside(sortie.trajectory, block.gps_time_s, self.lidar_clock_s)
            kept = block if inside.all() else select_returns(block, inside)
            if len(kept.gps_time_s):
                yield kept, self._adjusted_points(sortie.trajectory, self.body_from_lidar, kept)

    def _adjusted_points(self, trajectory: Trajectory, mounting: Mounting, rows: Returns) -> np.ndarray:
        own = lidar_points(rows.xyz_m, rows.gps_time_s, trajectory, self.rig, self.frame)
        own = corrected_points(own, self.data.range_correction)
        return placed(own, rows.gps_time_s - self.lidar_clock_s, trajectory, mounting, self.frame)

    def surveyed_world(self, target: SurveyedTarget) -> np.ndarray:
        """A target's surveyed point. [m]"""
        return self.frame.world_from_map(np.array([target.easting_m, target.northing_m, target.height_m]))


def open_source(campaign: Path, results: Path | None) -> Source:
    """Reads the campaign, and the mounting block of its results where they are given."""
    data = load_campaign(campaign)
    camera, lidar = nominal_mountings(data.rig) if data.rig is not None else (None, None)
    certificate = data.camera.calibration if data.camera is not None else None
    stated = f"certificate {certificate.certificate}" if certificate else "nominal"
    plain = Source(
        data=data,
        frame=WorldFrame(data.manifest),
        body_from_camera=camera,
        body_from_lidar=lidar,
        lens=certificate.lens if certificate else None,
        camera_clock_s=0.0,
        lidar_clock_s=0.0,
        adjusted=False,
        results=None,
        results_folder=None,
        basis=f"mountings: nominal (sensors/rig.json); lens: {stated}; ranges: as measured",
    )
    if results is None:
        return plain
    file = results / "results.json" if results.is_dir() else results
    content = read_results(file)
    if content["campaign"] != data.manifest.campaign:
        raise EvaluationError(
            "results of another campaign", where=str(file), got=content["campaign"], expected=data.manifest.campaign
        )
    return _with_results(replace(plain, results=content, results_folder=file.parent), content, file)


def check_lens(found: Lens | None, stated: Lens | None) -> None:
    """ValueError where a lens of results.json cannot be the camera's: more than a factor of two from the sheet's."""
    if found is not None and stated is not None and not 0.5 < found.fx_px / stated.fx_px < 2.0:
        raise ValueError(f"fx_px is {found.fx_px:.5g}, the sheet's {stated.fx_px:.5g}")


def _with_results(plain: Source, content: dict[str, Any], file: Path) -> Source:
    """What the results adjusted, in the place of what the sheets state."""
    block = content["mounting"]
    if block.get("status") != "measured":
        reason = str(block.get("reason", ""))[:200]
        return replace(plain, basis=f"{plain.basis}; the results hold no adjusted mounting: {reason}")
    try:
        clocks = dict(zip(block["names"], block["estimates"]))
        companions = content["indicators"]["calibration_error"]["companions"]
        lens, lens_line = _lens(plain, content, str(companions.get("interior_orientation", "")))
        check_lens(lens, plain.lens)
        correction = _ranges(content, str(companions.get("ranges", "")))
        return replace(
            plain,
            data=replace(plain.data, range_correction=correction),
            body_from_camera=_mounting(block["body_from_camera"]),
            body_from_lidar=_mounting(block["body_from_lidar"]),
            lens=lens,
            camera_clock_s=_number(clocks.get("camera_clock", 0.0)),
            lidar_clock_s=_number(clocks.get("lidar_clock", 0.0)),
            adjusted=True,
            basis=f"mountings and clocks: adjusted (results.json); lens: {lens_line}; ranges: "
            + ("as measured" if correction is None else "corrected by (15)"),
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        got = " ".join(f"{type(error).__name__} {error}".split())[:100]
        raise EvaluationError("its mounting block cannot be read", where=str(file), got=got) from None


def _mounting(block: Mapping[str, Any]) -> Mounting:
    rotation, arm = np.array(block["rotation"], float), np.array(block["lever_arm_m"], float)
    if rotation.shape != (3, 3) or arm.shape != (3,) or not np.isfinite(arm).all():
        raise ValueError("not a mounting")
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0.0:
        raise ValueError("not a rotation")
    return Mounting(rotation=rotation, lever_arm_m=arm)


def _number(value: object) -> float:
    number = float(value)  # type: ignore[arg-type]
    if not np.isfinite(number):
        raise ValueError("not finite")
    return number


def _lens(plain: Source, content: Mapping[str, Any], used: str) -> tuple[Lens | None, str]:
    """The interior orientation that the adjustment used: 9.2's own where results say so, else the certificate."""
    found = content["indicators"]["camera_reprojection_error"]["companions"].get("estimates")
    if not used.startswith("calibration of 9.2") or found is None:
        certificate = plain.data.camera.calibration if plain.data.camera else None
        return plain.lens, f"certificate {certificate.certificate}" if certificate else "nominal"
    values = np.array([_number(v) for v in found])
    if values.shape != (len(LENS_NAMES),):
        raise ValueError("not a lens")
    return lens_from_vector(values), "calibration of 9.2 (results.json)"


def _ranges(content: Mapping[str, Any], used: str) -> RangeCorrection | None:
    if not used.startswith("corrected"):
        return None
    found = content["indicators"]["lidar_ranging_rmse_relative"]["companions"]
    return RangeCorrection(
        additive_constant_m=_number(found["additive_constant_m"]),
        multiplication_constant=_number(found["multiplication_constant"]),
        covariance=np.zeros((2, 2)),
    )


def _named(data: CampaignData) -> Iterator[tuple[SortieData, Exposure, str]]:
    """Exposures with names that are unique in the whole campaign, whatever the case of letters."""
    pairs = [(sortie, exposure) for sortie in data.sorties for exposure in sortie.exposures]
    stems = [Path(exposure.image).stem for _, exposure in pairs]
    if max(Counter(s.lower() for s in stems).values(), default=0) > 1:
        stems = [f"s{sortie.folder.number:02d}_{stem}" for (sortie, _), stem in zip(pairs, stems)]
    if max(Counter(s.lower() for s in stems).values(), default=0) > 1:
        stems = [f"{stem}_{i:05d}" for i, stem in enumerate(stems)]
    for (sortie, exposure), stem in zip(pairs, stems):
        yield sortie, exposure, stem


def _inside(trajectory: Trajectory, gps_time_s: np.ndarray, clock_s: float) -> np.ndarray:
    first, last = trajectory.gps_time_s[[0, -1]]
    low, high = first + max(0.0, clock_s), last + min(0.0, clock_s)
    return np.asarray((gps_time_s >= low) & (gps_time_s <= high))
