"""Injected faults that are more than one number at one place: the lens that differs from its certificate, blunders of the survey.

Faults of mountings live in `rig`, of clocks, ranges and gains where the sensor is read out.
"""

from dataclasses import replace

import numpy as np
from pydantic import ValidationError

from campaign.config import Config, Faults, Lens
from campaign.errors import ConfigError
from scenes.model import Material, Scene


def true_lens(config: Config) -> Lens:
    """The lens that forms every picture: `camera.lens` with the faults of principal distance, principal point and k1.

    Raises
    ------
    ConfigError
        A fault as large as the value itself.
    """
    lens, faults = config.camera.lens, config.faults
    faulty = {
        "fx_px": lens.fx_px + faults.principal_distance_px,
        "fy_px": lens.fy_px + faults.principal_distance_px,
        "cx_px": lens.cx_px + faults.principal_point_px[0],
        "cy_px": lens.cy_px + faults.principal_point_px[1],
        "k1": lens.k1 + faults.k1,
    }
    try:
        return Lens(**(lens.model_dump() | faulty))
    except ValidationError as error:
        key = str(error.errors()[0]["loc"][0])
        name = "principal_distance_px" if key.startswith("f") else "principal_point_px"
        raise ConfigError(
            "the fault leaves no lens",
            where=f"faults.{name}",
            got=f"camera.lens.{key} = {faulty[key]:g} with it",
            expected="more than 0",
        ) from None


def with_true_lens(config: Config) -> Config:
    """The configuration as the optics are: the fault stands in `camera.lens` and no longer in `faults`, so that doing this twice
    is doing it once. Whatever renders or projects works with it; sheets, plan and truth/campaign.toml with the one asked for.
    """
    none = Faults()
    keys = ("principal_distance_px", "principal_point_px", "k1")
    cleared = config.faults.model_copy(update={key: getattr(none, key) for key in keys})
    camera = config.camera.model_copy(update={"lens": true_lens(config)})
    return config.model_copy(update={"camera": camera, "faults": cleared})


def require_targets(config: Config, ids: tuple[str, ...]) -> None:
    """Targets that the survey's faults name stand on the range.

    Raises
    ------
    ConfigError
        An unknown id, one target swapped with itself, or an error of the survey without its target.
    """
    faults = config.faults
    named = [("survey_target", faults.survey_target)] if faults.survey_target is not None else []
    named += [("swapped_targets", each) for each in faults.swapped_targets or ()]
    named += [("panel_laser_gain", each) for each, _ in faults.panel_laser_gain]
    for key, target in named:
        if target not in ids:
            raise ConfigError(
                "not a target of this range",
                where=f"faults.{key}",
                got=target,
                expected=f"one of {ids[0]} ... {ids[-1]}" if ids else "no target stands on this range",
            )
    if faults.swapped_targets is not None and len(set(faults.swapped_targets)) < 2:
        raise ConfigError(
            "a target cannot be swapped with itself", where="faults.swapped_targets", got=faults.swapped_targets[0]
        )
    if faults.survey_target is None and any(faults.survey_error_m):
        raise ConfigError(
            "no target is named for it", where="faults.survey_error_m", remedy="set faults.survey_target to its id"
        )


def with_panel_gains(config: Config, scene: Scene, sign: float = 1.0) -> Scene:
    """The scene whose panels reflect more (less) at the laser's line by `faults.panel_laser_gain`: moist or dirty since they were
    measured. A narrow band of the spectrum changes, far from the camera's; `sign` -1 takes it back.

    Raises
    ------
    ConfigError
        No such panel, or a reflectance below 0.002 or above 1.
    """
    gains = dict(config.faults.panel_laser_gain)
    if not gains:
        return scene
    require_targets(config, tuple(target.id for target in scene.targets))
    line = config.lidar.wavelength_nm
    spectra: dict[str, Material] = {}
    for target in scene.targets:
        if target.id in gains and target.spectrum is not None:
            nm, old = target.spectrum.wavelength_nm, target.spectrum.reflectance
            new = old + sign * gains[target.id] * np.clip(1.0 - (np.abs(nm - line) - 10.0) / 20.0, 0.0, 1.0)
            if new.min() < 0.002 or new.max() > 1.0:
                raise ConfigError(
                    "leaves no reflectance of a panel",
                    where=f"faults.panel_laser_gain {target.id}",
                    got=f"{new.min():.3f} to {new.max():.3f}",
                    expected="0.002 to 1",
                )
            spectra[target.spectrum.name] = replace(target.spectrum, reflectance=new)
    return replace(
        scene,
        materials=tuple(spectra.get(m.name, m) for m in scene.materials),
        targets=tuple(
            replace(t, spectrum=spectra.get(t.spectrum.name, t.spectrum)) if t.spectrum is not None else t
            for t in scene.targets
        ),
    )


def faulty_survey(config: Config, ids: tuple[str, ...], map_m: np.ndarray) -> np.ndarray:
    """Surveyed places with the blunders of `faults`.

    Parameters
    ----------
    ids : tuple of str
    map_m : (n, 3) np.ndarray
        Easting, northing, height as surveyed. [m]

    Returns
    -------
    (n, 3) np.ndarray
        With `survey_error_m` added to `survey_target`, then the places of the two `swapped_targets` exchanged: a point booked
        under the other's name. Azimuths stay, they come from the setting out. [m]
    """
    require_targets(config, ids)
    faults = config.faults
    out = np.array(map_m, dtype=np.float64)
    if faults.survey_target is not None:
        out[ids.index(faults.survey_target)] += np.asarray(faults.survey_error_m)
    if faults.swapped_targets is not None:
        a, b = (ids.index(each) for each in faults.swapped_targets)
        out[[a, b]] = out[[b, a]]
    return out
