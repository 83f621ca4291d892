"""Reads a campaign configuration: TOML, ready-made devices (`use = "name"`), overrides, and errors that a person can act on.

The models live in `campaign.config`. What one field cannot know about another is checked here (`_cross_checks`): order of
limits, fields that need each other, and values that can only be a wrong unit or sign.
"""

import datetime
import difflib
import importlib.resources
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from campaign.config import Config
from campaign.errors import CampaignError, ConfigError
from campaign.formats.toml import toml_text
from campaign.survey import crs_wkt

MAX_BYTES = 1_000_000
DEVICE_FOLDERS = {"camera": "sensors", "lidar": "sensors", "platform": "platforms", "site": "sites"}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_KEY = re.compile(r"[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*")
_BARE = re.compile(r"[^\[\]{}\"'=#\x00-\x1f]+")

# Bounds beyond which a value can only be in a wrong unit: key -> (least magnitude, greatest magnitude, unit).
_PLAUSIBLE: dict[str, tuple[float, float, str]] = {
    "camera.pixel_size_um": (0.3, 100.0, "micrometres"),
    "camera.nominal_focal_length_mm": (0.5, 2000.0, "millimetres"),
    "camera.exposure_time_s": (1e-6, 10.0, "seconds"),
    "lidar.divergence_rad": (1e-6, 0.1, "radians"),
    "lidar.prr_hz": (10.0, 1e8, "hertz"),
    "lidar.pulse_fwhm_ns": (0.05, 200.0, "nanoseconds"),
    "lidar.sampling_ns": (0.02, 50.0, "nanoseconds"),
    "lidar.aperture_diameter_m": (1e-3, 1.0, "metres"),
    "lidar.scanner.scan_rate_hz": (0.1, 10_000.0, "hertz"),
    "targets.panels.size_m": (0.02, 50.0, "metres"),
    "targets.frustums.long_edge_m": (0.02, 20.0, "metres"),
    "targets.frustums.thickness_m": (0.0, 0.05, "metres"),
    "flight.heights_m": (1.0, 10_000.0, "metres"),
    "flight.speed_m_s": (0.2, 60.0, "metres a second"),
    "flight.run_in_m": (0.0, 1000.0, "metres"),
    "flight.image_spacing_m": (0.01, 1000.0, "metres"),
    "site.texture_scale_m": (1e-3, 100.0, "metres"),
    "environment.visibility_km": (0.01, 1000.0, "kilometres"),
    "environment.wind_speed_m_s": (0.0, 60.0, "metres a second"),
    "environment.wind_from_deg": (0.0, 360.0, "degrees"),
    "environment.aerosol_optical_depth_500nm": (0.0, 5.0, "optical depths"),
    "environment.precipitable_water_cm": (0.0, 20.0, "centimetres"),
    "environment.ozone_atm_cm": (0.0, 2.0, "atm-cm"),
    "targets.panels.thickness_m": (1e-4, 0.5, "metres"),
    "targets.panels.stand_height_m": (0.0, 10.0, "metres"),
    "targets.panels.spectrum_std": (0.0, 0.5, "parts of the level"),
    "targets.frustums.mark_radius_m": (0.005, 5.0, "metres"),
    "targets.frustums.stand_heights_m": (0.0, 10.0, "metres"),
    "targets.survey.horizontal_std_m": (0.0, 5.0, "metres"),
    "targets.survey.height_std_m": (0.0, 5.0, "metres"),
    "targets.survey.spectrometer_std": (0.0, 0.5, "parts of the value"),
    "camera.f_number": (0.3, 64.0, "focal lengths"),
    "camera.full_well_e": (10.0, 1e8, "electrons"),
    "camera.read_noise_e": (0.0, 1e4, "electrons"),
    "camera.dark_current_e_s": (0.0, 1e6, "electrons a second"),
    "camera.dsnu_e": (0.0, 1e5, "electrons"),
    "camera.prnu": (0.0, 0.5, "parts of the gain"),
    "camera.psf_sigma_px": (0.0, 20.0, "pixels"),
    "camera.readout_time_s": (0.0, 1.0, "seconds"),
    "lidar.pulse_energy_uj": (1e-6, 1e6, "microjoules"),
    "lidar.receiver_fwhm_ns": (0.0, 100.0, "nanoseconds"),
    "lidar.full_scale_power_nw": (1e-3, 1e12, "nanowatts"),
    "lidar.noise_dn": (0.0, 1e4, "DN"),
    "lidar.shot_noise_dn": (0.0, 1e4, "DN"),
    "lidar.solar_background_dn": (0.0, 1e4, "DN"),
    "lidar.gain_jitter": (0.0, 0.5, "parts of the energy"),
    "lidar.range_noise_m": (0.0, 1.0, "metres"),
    "lidar.threshold_sigma": (0.5, 1000.0, "standard deviations"),
    "lidar.min_range_m": (0.0, 1000.0, "metres"),
    "lidar.stated_precision_m": (1e-5, 1.0, "metres"),
    "lidar.stated_accuracy_m": (1e-5, 1.0, "metres"),
    "lidar.encoder_std_deg": (0.0, 1.0, "degrees"),
    "platform.max_acceleration_m_s2": (0.05, 50.0, "metres a second squared"),
    "platform.roll_std_deg": (0.0, 20.0, "degrees"),
    "platform.pitch_std_deg": (0.0, 20.0, "degrees"),
    "platform.heading_std_deg": (0.0, 20.0, "degrees"),
    "platform.attitude_period_s": (0.05, 600.0, "seconds"),
    "platform.track_std_m": (0.0, 10.0, "metres"),
    "platform.pitch_per_speed_deg_s_m": (0.0, 5.0, "degrees for 1 m/s"),
    "platform.camera.lever_arm_m": (0.0, 20.0, "metres"),
    "platform.lidar.lever_arm_m": (0.0, 20.0, "metres"),
    "platform.camera.boresight_deg": (0.0, 360.0, "degrees"),
    "platform.lidar.boresight_deg": (0.0, 360.0, "degrees"),
    "platform.mounting_boresight_std_deg": (1e-4, 20.0, "degrees"),
    "platform.mounting_lever_arm_std_m": (1e-4, 5.0, "metres"),
    "navigation.position_correlation_s": (0.01, 1e6, "seconds"),
    "navigation.attitude_correlation_s": (0.01, 1e6, "seconds"),
    "navigation.clock_std_s": (0.0, 1.0, "seconds"),
    "navigation.position_std_m": (0.0, 100.0, "metres"),
    "navigation.attitude_std_deg": (0.0, 20.0, "degrees"),
    "faults.lidar_gain": (1e-4, 1e4, "factors"),
    "faults.camera_gain": (1e-4, 1e4, "factors"),
    "faults.camera_boresight_deg": (0.0, 45.0, "degrees"),
    "faults.lidar_boresight_deg": (0.0, 45.0, "degrees"),
    "faults.camera_lever_arm_m": (0.0, 5.0, "metres"),
    "faults.lidar_lever_arm_m": (0.0, 5.0, "metres"),
    "faults.camera_clock_s": (0.0, 1.0, "seconds"),
    "faults.lidar_clock_s": (0.0, 1.0, "seconds"),
    "faults.range_offset_m": (0.0, 10.0, "metres"),
    "faults.range_scale": (0.0, 0.1, "parts of the range"),
}


def configs_folder() -> Path:
    """configs/ of a checkout (beside this package) or of the installed wheel (inside testrange)."""
    beside = Path(__file__).resolve().parent.parent / "configs"
    if (beside / "campaigns").is_dir():
        return beside
    packaged = Path(str(importlib.resources.files("testrange") / "configs"))
    return packaged if packaged.is_dir() else beside


def load_config(path: Path | str, overrides: Sequence[str] = ()) -> Config:
    """Read, merge, override and validate one campaign configuration.

    Parameters
    ----------
    path : Path or str
        A TOML file, or the bare name of a ready-made one in configs/campaigns.
    overrides : sequence of str
        "key.subkey=value" with a TOML value; a bare word that is no TOML is taken as a string.

    Raises
    ------
    ConfigError
        One line; `problems` holds a line for each problem.
    """
    data = read_toml(resolve_config(path))
    for override in overrides:
        apply_override(data, override)
    for section, folder in DEVICE_FOLDERS.items():
        if section in data:
            data[section] = _with_device(data[section], section, folder)
    try:
        text = json.dumps(data, default=_plain)
        config = Config.model_validate_json(text, strict=True)
    except ValidationError as error:
        found = error.errors(include_url=False)
        inner = [e["loc"] for e in found]
        # an array whose items are wrong is also reported as too short: the items' lines are enough
        found = [e for e in found if not any(len(i) > len(e["loc"]) and i[: len(e["loc"])] == e["loc"] for i in inner)]
        raise _config_error([_explain(e) for e in found]) from None
    except (RecursionError, ValueError):
        raise ConfigError("the values are nested too deeply or cannot be read", where=str(path)) from None
    problems = list(_cross_checks(config))
    if problems:
        raise _config_error(problems)
    return config


def resolve_config(path: Path | str) -> Path:
    """The file that a path or a bare name means."""
    given = Path(path)
    if given.is_file() or len(given.parts) != 1 or given.suffix == ".toml":
        return given
    return _named("campaigns", str(given), "configuration")


def resolve_study(path: Path | str) -> Path:
    """The file that a path, or the bare name of a ready-made study, means."""
    given = Path(path)
    if given.is_file() or len(given.parts) != 1 or given.suffix == ".toml":
        return given
    return _named("studies", str(given), "study")


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file of at most 1 MB."""
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise ConfigError(
            "no such file", where=str(path), remedy="check the path, or name a file of configs/"
        ) from None
    except (OSError, ValueError) as error:
        raise ConfigError("cannot be read", where=str(path), got=getattr(error, "strerror", None) or error) from None
    if len(raw) > MAX_BYTES:
        raise ConfigError("too large for a configuration", where=str(path), expected=f"at most {MAX_BYTES} bytes")
    try:
        return tomllib.loads(raw.decode("utf-8"))
    except UnicodeDecodeError:
        raise ConfigError("is not UTF-8 text", where=str(path), expected="a TOML file") from None
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise ConfigError("is not valid TOML", where=str(path), got=str(error) or "too deep") from None


def apply_override(data: dict[str, Any], override: str) -> None:
    """Set one "a.b=value" in a nested dict, in place."""
    key, equals, text = override.partition("=")
    key, text = key.strip(), text.strip()
    if not equals or not _KEY.fullmatch(key):
        raise ConfigError("is not a setting", where=f"--set {override}", expected="key=value, for example seed=7")
    value = _override_value(override, text)
    *parents, last = key.split(".")
    place = data
    for parent in parents:
        below = place.setdefault(parent, {})
        if not isinstance(below, dict):
            raise ConfigError(f"{parent} holds a value, no settings below it", where=f"--set {override}")
        place = below
    if isinstance(place.get(last), dict) and not isinstance(value, dict):
        raise ConfigError(f"{key} is a section", where=f"--set {override}", expected=f"a setting inside it: {key}.…")
    place[last] = value


def _override_value(override: str, text: str) -> Any:
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError, ValueError):
        if not _BARE.fullmatch(text):
            raise ConfigError(
                "the value is no TOML", where=f"--set {override}", expected='a number, true, "text" or [1.0, 2.0]'
            ) from None
        return text
    if list(parsed) != ["value"]:
        raise ConfigError("one setting at a time", where=f"--set {override}")
    return parsed["value"]


def merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """`over` on top of `base`, table by table."""
    out = dict(base)
    for key, value in over.items():
        below = out.get(key)
        out[key] = merge(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return out


def dump_toml(config: Config) -> str:
    """The configuration as TOML, devices merged in; `load_config` of it gives an equal Config, but for the place where renders
    are kept: a path of one machine, on which nothing that is written depends."""
    body = config.model_dump(mode="python", exclude_none=True, exclude={"render": {"cache", "cache_limit_gb"}})
    return toml_text(body)


def json_schema() -> dict[str, Any]:
    """JSON Schema of a configuration, for editors."""
    return Config.model_json_schema()


def _fits(path: Path, section: str) -> bool:
    """Whether a ready-made file holds settings of that section alone: configs/sensors/ has cameras and LiDARs."""
    field = Config.model_fields.get(section)
    model = None if field is None else field.annotation
    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        return True
    return read_toml(path).keys() <= model.model_fields.keys()


def _named(folder: str, name: object, what: str) -> Path:
    """configs/<folder>/<name>.toml; a name is letters, digits, _ . - only, so that no path escapes.

    `what` is the section that the file is for, or a word for it; of the sections' files only those that fit are offered.
    """
    place = configs_folder() / folder
    got = repr(name)
    if isinstance(name, str) and _NAME.fullmatch(name) and (place / f"{name}.toml").is_file():
        if _fits(place / f"{name}.toml", what):
            return place / f"{name}.toml"
        got += ", a file of another kind"
    known = sorted(p.stem for p in place.glob("*.toml") if _fits(p, what)) if place.is_dir() else []
    near = difflib.get_close_matches(str(name), known, 1)
    raise ConfigError(
        f"no ready-made {what} of that name",
        got=got,
        expected="one of " + ", ".join(known) if known else f"a file in configs/{folder}",
        remedy=f"did you mean {near[0]}?" if near else None,
    )


def _with_device(section: Any, name: str, folder: str) -> Any:
    if not isinstance(section, dict) or "use" not in section:
        return section
    device = read_toml(_named(folder, section["use"], name))
    if "use" in device:
        raise ConfigError(f"configs/{folder}/{section['use']}.toml may not use another file", where=f"{name}.use")
    return merge(device, {k: v for k, v in section.items() if k != "use"})


def _plain(value: object) -> str:
    """TOML's dates and times as ISO text."""
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat()
    raise ValueError(f"{type(value).__name__} is no setting")


def _config_error(problems: Sequence[str]) -> ConfigError:
    more = f"and {len(problems) - 1} more: " + " | ".join(problems[1:]) if len(problems) > 1 else None
    return ConfigError(problems[0], remedy=more, problems=problems)


def _dotted(location: Sequence[str | int]) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _explain(error: Mapping[str, Any]) -> str:
    """One pydantic error as: key, what, got, expected."""
    location = error["loc"]
    key = _dotted(location)
    if error["type"] == "extra_forbidden":
        near = _nearest(location)
        return f"{key} is not a setting" + (f"; did you mean {near}?" if near else "")
    if error["type"] == "missing":
        device = location[0] in DEVICE_FOLDERS and len(location) <= 2
        return f"{key} is missing; add it" + (', or name a device with use = "…"' if device else "")
    got = json.dumps(error["input"], default=str, ensure_ascii=False)
    expected = re.sub(r"^(Input|Value|String|Tuple) should (be |have )?", "", error["msg"])
    expected = re.sub(r" after validation, not \d+$", "", expected)
    return f"{key or 'configuration'}: got {got if len(got) <= 60 else got[:57] + '…'}; expected {expected}"


def _nearest(location: Sequence[str | int]) -> str | None:
    """The known setting that a wrong key most likely means: in its own section first, then anywhere."""
    *parents, last = [part for part in location if isinstance(part, str)]
    keys = list(_keys(Config))
    prefix = ".".join(parents)
    here = {k.rsplit(".", 1)[-1]: k for k in keys if k.rpartition(".")[0] == prefix}
    match = difflib.get_close_matches(last, here, 1)
    if match:
        return here[match[0]]
    anywhere = {k.rsplit(".", 1)[-1]: k for k in keys}
    match = difflib.get_close_matches(last, anywhere, 1, cutoff=0.8)
    return anywhere[match[0]] if match else None


def _keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Every dotted key of a model; the items of an array share their table's keys."""
    for name, field in model.model_fields.items():
        yield prefix + name
        kinds = [field.annotation, *get_args(field.annotation)]
        for kind in kinds:
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from _keys(kind, f"{prefix}{name}.")


def _cross_checks(config: Config) -> Iterator[str]:
    """Problems that one field alone does not show, one line each."""
    yield from _implausible(config)
    camera, lidar, scanner, nav = config.camera, config.lidar, config.lidar.scanner, config.navigation
    try:
        start = datetime.datetime.fromisoformat(config.campaign.start_time)
        if start.tzinfo is None or not 1990 <= start.year <= 2100:
            raise ValueError
    except ValueError:
        yield (
            f"campaign.start_time: got {config.campaign.start_time!r}; "
            "expected ISO 8601 with UTC offset, for example 2026-06-12T10:30:00+08:00"
        )
    if not -180.0 <= scanner.sector_deg[0] < scanner.sector_deg[1] <= 180.0:
        yield f"lidar.scanner.sector_deg: got {list(scanner.sector_deg)}; expected least before greatest, in -180 to 180"
    if scanner.type == "channels" and not scanner.channel_elevations_deg:
        yield "lidar.scanner.channel_elevations_deg is empty; expected one angle for each beam of type channels"
    if scanner.type == "line" and scanner.channel_elevations_deg:
        yield 'lidar.scanner.channel_elevations_deg belongs to type = "channels"; got type = "line"'
    if any(abs(e) >= 80.0 for e in scanner.channel_elevations_deg):
        yield "lidar.scanner.channel_elevations_deg: expected angles within ±80 degrees"
    for name in ("position_std_m", "attitude_std_deg"):
        values = getattr(nav, name)
        if nav.grade == "custom" and values is None:
            yield f'navigation.{name} is missing; expected three values with navigation.grade = "custom"'
        if nav.grade != "custom" and values is not None:
            yield f'navigation.{name} needs navigation.grade = "custom"; got grade "{nav.grade}"'
        if values is not None and min(values) < 0.0:
            yield f"navigation.{name}: got {list(values)}; expected no negative standard deviation"
    if min(camera.calibration_std) < 0.0:
        yield "camera.calibration_std: expected no negative standard deviation"
    if not (0.0 < camera.lens.cx_px < camera.width_px and 0.0 < camera.lens.cy_px < camera.height_px):
        yield f"camera.lens: principal point outside the image of {camera.width_px} x {camera.height_px} px"
    stated = camera.nominal_focal_length_mm * 1000.0 / camera.pixel_size_um
    if not 0.7 < camera.lens.fx_px / stated < 1.43:
        yield f"camera.lens.fx_px: got {camera.lens.fx_px:g}; expected about {stated:.0f} by focal length and pixel size"
    elif not 0.9 < camera.lens.fy_px / camera.lens.fx_px < 1.1:
        yield f"camera.lens.fy_px: got {camera.lens.fy_px:g}; expected about camera.lens.fx_px = {camera.lens.fx_px:g}"
    if max(camera.calibration_std[:4]) > 0.05 * camera.lens.fx_px or max(camera.calibration_std[4:]) > 0.5:
        yield "camera.calibration_std: expected at most 5 % of fx_px for fx fy cx cy, in pixels, and 0.5 for the distortion"
    if max(abs(k) for k in (camera.lens.k1, camera.lens.k2, camera.lens.k3, camera.lens.p1, camera.lens.p2)) > 10.0:
        yield "camera.lens: a distortion coefficient above 10; expected those of normalised image coordinates, not of pixels"
    if len({band.name for band in camera.bands}) < len(camera.bands):
        yield "camera.bands: two bands have the same name"
    if camera.black_level_dn >= 2**camera.bit_depth - 1:
        yield f"camera.black_level_dn: got {camera.black_level_dn:g}; expected below 2^bit_depth"
    if lidar.baseline_dn >= 2**lidar.bit_depth - 1:
        yield f"lidar.baseline_dn: got {lidar.baseline_dn:g}; expected below 2^bit_depth"
    if camera.shutter == "rolling" and camera.readout_time_s == 0.0:
        yield 'camera.readout_time_s is 0; expected a positive time with shutter = "rolling"'
    if any(not 0.0 < r <= 100.0 for r in config.targets.panels.nominal_reflectance_percent):
        yield "targets.panels.nominal_reflectance_percent: expected values above 0 and at most 100"
    try:
        crs_wkt(config.site.projection_epsg, config.site.height_epsg, "WKT1_GDAL")
    except CampaignError as error:
        yield f"site.projection_epsg, site.height_epsg: {error}"
    epsg, longitude = config.site.projection_epsg, config.site.longitude_deg
    if 4513 <= epsg <= 4554:
        meridian = 75.0 + 3.0 * ((epsg - 4513) % 21)
        if abs(longitude - meridian) > 3.0:
            yield (
                f"site.longitude_deg: got {longitude:g}; expected within 3 degrees of {meridian:g}, the central meridian of "
                f"site.projection_epsg = {epsg}; check the sign, or choose the zone"
            )


def _implausible(config: Config) -> Iterator[str]:
    for key, (least, most, unit) in _PLAUSIBLE.items():
        value: Any = config
        for part in key.split("."):
            value = getattr(value, part)
        if value is None:
            continue
        for number in value if isinstance(value, tuple) else (value,):
            if not least <= abs(number) <= most:
                yield f"{key}: got {number:g}; expected {least:g} to {most:g} in {unit}; is the unit wrong?"
