"""Configurations: overrides, ready-made devices, and that every mistake is one line that helps."""

import math
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from campaign.config import Config
from campaign.errors import ConfigError
from campaign.formats.toml import toml_text
from campaign.load import apply_override, configs_folder, dump_toml, json_schema, load_config, merge

BASE = """
[campaign]
id = "t"
[camera]
width_px = 3072
height_px = 2048
pixel_size_um = 4.5
nominal_focal_length_mm = 13.5
lens = {fx_px = 3000.0, fy_px = 3000.0, cx_px = 1536.0, cy_px = 1024.0}
bands = [{name = "red", centre_nm = 640.0, fwhm_nm = 60.0}]
"""


@pytest.fixture
def base(tmp_path: Path) -> Path:
    path = tmp_path / "base.toml"
    path.write_text(BASE)
    return path


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ("lidar.divergence_mrad=0.5", "lidar.divergence_mrad is not a setting; did you mean lidar.divergence_rad?"),
        ("flight.heights_m=[-45.0]", "flight.heights_m[0]: got -45.0; expected greater than 0"),
        ("seed=abc", 'seed: got "abc"; expected a valid integer'),
        ('seed="3"', 'seed: got "3"; expected a valid integer'),
        ("flight.speed_m_s=true", "flight.speed_m_s: got true; expected a valid number"),
        ("faults.range_scale=nan", "faults.range_scale: got NaN; expected a finite number"),
        (
            "lidar.divergence_rad=0.5",
            "lidar.divergence_rad: got 0.5; expected 1e-06 to 0.1 in radians; is the unit wrong?",
        ),
        ("camera.nominal_focal_length_mm=0.135", "camera.nominal_focal_length_mm: got 0.135"),
        ("site.longitude_deg=-121.2", "site.longitude_deg: got -121.2; expected within 3 degrees of 120"),
        (
            "lidar.scanner.sector_deg=[35.0, -35.0]",
            "lidar.scanner.sector_deg: got [35.0, -35.0]; expected least before",
        ),
        ("lidar.scanner.type=channels", "lidar.scanner.channel_elevations_deg is empty"),
        ("navigation.grade=custom", "navigation.position_std_m is missing"),
        ("navigation.position_std_m=[0.1, 0.1, 0.1]", 'navigation.position_std_m needs navigation.grade = "custom"'),
        ("campaign.start_time=yesterday", "campaign.start_time: got 'yesterday'"),
        ("campaign.start_time=2026-06-12T10:30:00", "campaign.start_time: got '2026-06-12T10:30:00'"),
        ("camera.use=../../etc/passwd", "no ready-made camera of that name; got '../../etc/passwd'"),
        ("lidar.range=[1", "--set lidar.range=[1: the value is no TOML"),
        ("nonsense", "--set nonsense: is not a setting; expected key=value"),
        ("campaign=3", "--set campaign=3: campaign is a section"),
        ("seed.x=3", "seed: got"),
        ("camera.lens.fx_px=300.0", "camera.lens.fx_px: got 300; expected about 3000"),
    ],
)
def test_a_mistake_is_one_line_that_names_it(base: Path, override: str, line: str) -> None:
    """Rationale: a user corrects the file from the message alone. Expected: key, what was got, what is right; no newline."""
    with pytest.raises(ConfigError) as caught:
        load_config(base, [override])
    assert str(caught.value).startswith(line)
    assert "\n" not in str(caught.value)


def test_only_devices_that_fit_are_offered(base: Path) -> None:
    """Rationale: configs/sensors/ holds cameras and LiDARs; a camera offered for lidar.use leads into a page of unknown settings.
    Expected: names of the asked kind alone, and a file of the other kind refused by what it is. Tolerance: none."""
    with pytest.raises(ConfigError) as lidar:
        load_config(base, ["lidar.use=nonsense"])
    assert str(lidar.value).endswith("expected one of riegl_vux1uav, velodyne_vlp16, vux1_quickstart")
    with pytest.raises(ConfigError) as camera:
        load_config(base, ["camera.use=riegl_vux1uav"])
    assert "got 'riegl_vux1uav', a file of another kind; expected one of dji_p1_35mm, quickstart_6mp" in str(
        camera.value
    )


def test_every_problem_is_listed(base: Path) -> None:
    """Rationale: correcting one mistake a run is tedious. Expected: three mistakes, three lines."""
    with pytest.raises(ConfigError) as caught:
        load_config(base, ["lidar.prf_hz=1.0", "seed=-1", "flight.heights_m=[]"])
    lines = sorted(caught.value.problems)
    assert len(lines) == 3
    assert lines[0] == "flight.heights_m: got []; expected at least 1 item"
    assert lines[1].startswith("lidar.prf_hz is not a setting; did you mean lidar.prr_hz?")
    assert lines[2] == "seed: got -1; expected greater than or equal to 0"


@pytest.mark.parametrize(
    ("raw", "what"),
    [
        (b"\xff\xfe", "is not UTF-8 text"),
        (b"a = ", "is not valid TOML"),
        (b"x = " + b"[" * 100_000, "is not valid TOML"),
        (b"#" * 1_000_001, "too large"),
    ],
)
def test_a_file_that_is_no_configuration(tmp_path: Path, raw: bytes, what: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(raw)
    with pytest.raises(ConfigError, match=what):
        load_config(path)


def test_missing_file_and_unknown_name() -> None:
    with pytest.raises(ConfigError, match="no such file"):
        load_config("nowhere/x.toml")
    with pytest.raises(ConfigError, match="no ready-made configuration of that name"):
        load_config("quickstrat")


def test_dump_round_trip_is_exact(base: Path) -> None:
    """Rationale: truth/campaign.toml must reproduce the run. Expected: equality of every value; tolerance none."""
    config = load_config(
        base,
        ['campaign.title="a \\"quoted\\" \\\\ 标题\\n"', "faults.camera_clock_s=1e-5", "flight.heights_m=[45.0, 65.1]"],
    )
    again = base.with_name("again.toml")
    again.write_text(dump_toml(config), encoding="utf-8")
    assert load_config(again) == config


def test_dump_says_nothing_of_where_renders_are_kept(base: Path) -> None:
    """Rationale: truth/campaign.toml is handed on, and the same seed gives the same bytes on any machine. Expected: one text."""
    kept = load_config(base, ['render.cache="/somewhere/renders"', "render.cache_limit_gb=3.0"])
    assert dump_toml(kept) == dump_toml(load_config(base))


def test_section_overrides_the_device_it_uses(base: Path) -> None:
    """Rationale: `use` names a device, keys beside it win, nested tables merge. Expected: 1234 Hz, the rest from the file."""
    folder = configs_folder() / "sensors"
    name = next((p.stem for p in sorted(folder.glob("*.toml")) if "prr_hz" in p.read_text(encoding="utf-8")), None)
    if name is None:
        pytest.skip("no LiDAR in configs/sensors")
    device = tomllib.loads((folder / f"{name}.toml").read_text(encoding="utf-8"))
    config = load_config(base, [f"lidar.use={name}", "lidar.prr_hz=1234.0", "lidar.scanner.scan_rate_hz=7.0"])
    assert config.lidar.prr_hz == 1234.0
    assert config.lidar.scanner.scan_rate_hz == 7.0
    assert config.lidar.wavelength_nm == device["wavelength_nm"]
    assert config.lidar.use is None


def test_toml_date_is_taken(base: Path) -> None:
    config = load_config(base, ["campaign.start_time=2026-06-12T10:30:00+08:00"])
    assert config.campaign.start_time == "2026-06-12T10:30:00+08:00"


def test_every_campaign_of_configs_loads() -> None:
    """Rationale: a ready-made configuration that is refused is worse than none."""
    names = sorted(p.stem for p in (configs_folder() / "campaigns").glob("*.toml"))
    assert names
    for name in names:
        assert isinstance(load_config(name), Config)


def test_json_schema_knows_units_and_refuses_unknown_keys() -> None:
    schema = json_schema()
    assert schema["$defs"]["Lidar"]["additionalProperties"] is False
    assert schema["$defs"]["Lidar"]["properties"]["prr_hz"]["exclusiveMinimum"] == 0.0


_KEYS = st.from_regex(r"[a-z_][a-z0-9_]{0,8}", fullmatch=True)
_VALUES = st.recursive(
    st.integers(-(2**62), 2**62) | st.floats(allow_nan=False, allow_infinity=False) | st.booleans() | st.text(),
    lambda inner: st.lists(inner, max_size=4),
    max_leaves=6,
)


@given(st.lists(_KEYS, min_size=1, max_size=4), _VALUES)
def test_any_toml_value_passes_through_an_override(keys: list[str], value: object) -> None:
    """Law: writing a value as TOML and setting it by --set gives the value back, at the place that the key names."""
    text = toml_text({"v": value}).partition(" = ")[2].rstrip("\n")
    data: dict[str, object] = {}
    apply_override(data, ".".join(keys) + "=" + text)
    place: object = data
    for key in keys:
        assert isinstance(place, dict)
        place = place[key]
    assert place == value
    assert type(place) is type(value)


@given(st.text(max_size=60))
def test_any_override_text_either_sets_or_is_one_line(text: str) -> None:
    """Law: no text makes anything but a ConfigError of one line."""
    data: dict[str, object] = {}
    try:
        apply_override(data, text)
    except ConfigError as error:
        assert len(str(error).splitlines()) == 1
    else:
        assert data


@given(st.dictionaries(_KEYS, st.integers() | st.dictionaries(_KEYS, st.integers(), max_size=3), max_size=4))
def test_merge_with_nothing_and_with_itself_is_the_same(data: dict[str, object]) -> None:
    assert merge(data, {}) == data
    assert merge({}, data) == data
    assert merge(data, data) == data


def test_toml_writer_keeps_special_floats_finite() -> None:
    assert tomllib.loads(toml_text({"a": 1e-05, "b": {"c": [1.0, math.pi]}})) == {
        "a": 1e-05,
        "b": {"c": [1.0, math.pi]},
    }
