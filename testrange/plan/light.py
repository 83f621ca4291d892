"""What the camera will see: ground resolution, blur, overlaps, and how bright each panel comes out at the sun of that time."""

import numpy as np

from campaign.config import Band, Config
from evaluator.camera_model import project_exposure
from evaluator.frames import WorldFrame
from evaluator.georeference import nominal_mountings
from evaluator.model import CampaignData, EvaluationError, MarkObservation
from evaluator.mounting.geometry import certified_lens, mark_view
from evaluator.observe.frustums import frustum_model
from scenes.model import Material, SunSky
from scenes.sunsky import band_irradiance, sun_sky
from simulator.camera import sensor
from simulator.flight.plan import Sortie
from simulator.times import utc_from_gps_time
from testrange.plan.model import PanelLight
from testrange.plan.rehearsal import Rehearsal

MARK_STD_PX = 0.006  # of a mark's centre, as rendered ones are found; a field's air and optics may cost some hundredths
_RATE_SPAN_S = 0.02


def ground_resolution_m(config: Config, height_m: float) -> tuple[float, tuple[float, float]]:
    """GSD on level ground under the aircraft, and the image's footprint across and along the track.

    Parameters
    ----------
    height_m : float
        Above the ground. [m]

    Returns
    -------
    float, (float, float)
        [m], [m]

    References
    ----------
    GB/T 41450-2022, 7.4 a, formula (1), with the lens's principal distance for f/a.
    """
    camera = config.camera
    return height_m / camera.lens.fx_px, (
        camera.width_px * height_m / camera.lens.fx_px,
        camera.height_px * height_m / camera.lens.fy_px,
    )


def blur_px(config: Config, height_m: float, speed_m_s: float, exposure_time_s: float) -> float:
    """How far a point on the ground moves in the image during an exposure, by the flight's speed alone. [px]"""
    return speed_m_s * exposure_time_s * config.camera.lens.fy_px / height_m


def attitude_blur_px(config: Config, sortie: Sortie, exposure_time_s: float) -> float:
    """The same by roll and pitch rates, the greatest of a sortie's exposures. [px]"""
    times = np.array([t for strip in sortie.strips for t in strip.exposure_s])
    if not times.size:
        return 0.0
    change = sortie.motion.rpy(times + 0.5 * _RATE_SPAN_S) - sortie.motion.rpy(times - 0.5 * _RATE_SPAN_S)
    rate = np.hypot(change[:, 0], change[:, 1]) / _RATE_SPAN_S
    return float(rate.max()) * exposure_time_s * config.camera.lens.fx_px


def overlap(spacing_m: float, extent_m: float) -> float:
    """Share of an extent that a neighbour at some spacing has in common; negative where there is a gap. [1]"""
    return 1.0 - spacing_m / extent_m


def band_reflectance(material: Material, band: Band) -> float:
    """Reflectance averaged over a band's Gaussian response. [1]"""
    sigma = band.fwhm_nm / np.sqrt(8.0 * np.log(2.0))
    nm = np.linspace(band.centre_nm - 3.0 * sigma, band.centre_nm + 3.0 * sigma, 201)
    response = np.exp(-0.5 * ((nm - band.centre_nm) / sigma) ** 2)
    return float(np.sum(response * np.interp(nm, material.wavelength_nm, material.reflectance)) / response.sum())


def level_panel_dn(config: Config, exposing: sensor.Exposing, light: SunSky, material: Material) -> np.ndarray:
    """Expected signal of a level Lambertian panel in the open, (bands,), above the black level, clipped as the sensor does. [DN]

    E = E_direct sin(h) + E_diffuse, L = rho E / pi; no neighbour throws light or shade on it.
    """
    up = max(float(light.to_sun[2]), 0.0)
    camera = config.camera
    electrons = []
    for band, per_radiance in zip(camera.bands, exposing.e_per_radiance, strict=True):
        direct, diffuse = band_irradiance(light, band)
        radiance = band_reflectance(material, band) * (direct * up + diffuse) / np.pi
        electrons.append(min(radiance * float(per_radiance), camera.full_well_e))
    dn = np.array(electrons) * config.faults.camera_gain / exposing.e_per_dn
    return np.minimum(dn, sensor.full_scale_dn(camera))


def panel_lights(rehearsal: Rehearsal, echoes_dn: dict[str, tuple[float, float]]) -> tuple[PanelLight, ...]:
    """Every panel's signal, mean over the planned exposures; brightness by the preview's own curve."""
    config, exposing = rehearsal.config, rehearsal.exposing
    if exposing is None:
        return ()
    times = [t for sortie in rehearsal.sorties for strip in sortie.strips for t in strip.exposure_s]
    lights = [sun_sky(config.site, config.environment, utc_from_gps_time(t)) for t in times]
    found = []
    for target in rehearsal.scene.targets:
        if target.kind != "panel" or target.spectrum is None:
            continue
        dn = np.array([level_panel_dn(config, exposing, light, target.spectrum) for light in lights])
        raw = np.round(dn + config.camera.black_level_dn).astype(np.uint16)
        shown = sensor.preview(raw[None], config.camera)[0].max(axis=1) / 255.0
        found.append(
            PanelLight(
                panel=target.id,
                nominal_percent=target.nominal_reflectance_percent or 0.0,
                dn=tuple(float(v) for v in dn.mean(axis=0)),
                full_scale_dn=sensor.full_scale_dn(config.camera),
                brightness=float(shown.mean()),
                echo_dn=echoes_dn.get(target.id),
            )
        )
    return tuple(found)


def expected_marks(data: CampaignData) -> list[MarkObservation]:
    """The mark of every frustum in every image that holds it, where the drawing's mounting puts it."""
    if data.camera is None or data.rig is None:
        return []
    lens, frame, mounting = certified_lens(data.camera)[0], WorldFrame(data.manifest), nominal_mountings(data.rig)[0]
    found = []
    models = {t.id: (frustum_model(t, frame), t.mark_radius_m or 0.0) for t in data.targets if t.kind == "frustum"}
    for sortie in data.sorties:
        for exposure in sortie.exposures:
            for name, (model, radius) in models.items():
                try:
                    view = mark_view(model, radius, data.camera, lens, mounting, sortie, exposure, frame)
                except EvaluationError:
                    continue  # the exposure lies outside the trajectory
                if view is None or sortie.trajectory is None:
                    continue
                mark = (
                    model.vertex_world_m
                    - (0.0 if model.inverted else model.long_edge_m * np.sqrt(0.5)) * (model.world_from_target[:, 2])
                )
                _, time = project_exposure(
                    data.camera, lens, mounting, sortie.trajectory, exposure.gps_time_s, mark, frame
                )
                found.append(
                    MarkObservation(
                        target=name,
                        sortie=sortie.folder.number,
                        strip=exposure.strip,
                        image=exposure.image,
                        gps_time_s=float(time[0]),
                        uv_px=view.predicted_px,
                        covariance_px2=MARK_STD_PX**2 * np.eye(2),
                        radius_px=radius * float(np.linalg.norm(view.px_per_m, axis=0).mean()),
                    )
                )
    return found
