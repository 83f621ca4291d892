"""Clause 9.1 on a ranging line written by hand: no simulator, no shared mathematics. Formulas: test_c9_1_formulas."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from campaign.benches.ranging import (
    RangingLine,
    RangingPanel,
    StationReading,
    TotalStation,
    scan_path,
    scan_paths,
)
from campaign.benches.scans import ScanPoints, write_scan
from campaign.folder import CampaignFolder
from evaluator.benches.bench_model import RangingResult
from evaluator.benches.ranging_fit import adjusted_constants
from evaluator.benches.total_station import (
    standard_pressure_hpa,
    stations_of,
    unused_stations,
)
from evaluator.c9_1_lidar_ranging import (
    evaluate_ranging,
)
from evaluator.model import CampaignData, RangingData

MM = 1e-3

# ---- a line written by hand ------------------------------------------------------------------------------------------------

SIZE_M = 1.2
OFF_M = 0.31  # measured minus true, of the whole line
ECCENTRICITY_M = np.array([0.4, -0.3, 0.1])
AIR = (0.0, 1013.25, 0.0)  # at 1 um: n = 1.0002925701, worked out above
INDEX = 1.0 + 292.5701e-6
STATIONS = (
    TotalStation(
        name="A", class_mm=10.0, additive_constant_m=-1.4 * MM, scale=3e-6, reference_index=1.0003, wavelength_um=1.0,
        serves=("correction",),
    ),
    TotalStation(
        name="B", class_mm=5.0, additive_constant_m=0.6 * MM, scale=-1e-6, reference_index=1.0003, wavelength_um=1.0,
        serves=("reference",),
    ),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Plate:
    """A panel, or anything else flat, that faces the LiDAR."""

    distance_m: float
    azimuth_deg: float
    elevation_deg: float = 0.0
    width_m: float = SIZE_M
    height_m: float = SIZE_M
    turned_deg: float = 1.0  # its normal against the line of sight, about the vertical


PLATES = tuple(
    Plate(distance_m=d, azimuth_deg=a, elevation_deg=e)
    for d, a, e in zip((12.0, 40.0, 70.0, 100.0, 130.0, 160.0), (5.0, -4.0, 1.0, -1.5, 9.0, -6.0), (0.0, 0.3, -0.2, 0.1, 0.2, 0))
)  # fmt: skip


def direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    return np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)])


def returns_from(plate: Plate, rng: np.random.Generator, noise_m: float) -> np.ndarray:
    """(n, 3) points about the LiDAR's centre, true axes: beams on a grid of 8 cm, or of 2 cm on what is near."""
    sight = direction(plate.azimuth_deg, plate.elevation_deg)
    right = np.array([sight[1], -sight[0], 0.0]) / np.hypot(sight[0], sight[1])
    up = np.cross(right, sight)
    t = np.radians(plate.turned_deg)
    across = np.cos(t) * right + np.sin(t) * sight
    step = 0.08 if plate.distance_m > 20.0 else 0.02
    u, v = np.meshgrid(
        np.arange(-0.5 * plate.width_m, 0.5 * plate.width_m, step) + 0.5 * step,
        np.arange(-0.5 * plate.height_m, 0.5 * plate.height_m, step) + 0.5 * step,
    )
    point = plate.distance_m * sight + u.reshape(-1, 1) * across + v.reshape(-1, 1) * up
    true = np.linalg.norm(point, axis=1)
    measured = true + OFF_M + noise_m * rng.standard_normal(len(true))
    return point * (measured / true)[:, None]


def some_rotation() -> np.ndarray:
    """Of an instrument that lies on its side: no axis near level."""
    q, _ = np.linalg.qr(np.array([[0.2, -0.9, 0.4], [0.7, 0.1, -0.6], [-0.5, -0.3, -0.9]]))
    return q * np.sign(np.linalg.det(q))


def points(xyz_m: np.ndarray, amplitude: float = 200.0) -> ScanPoints:
    n = len(xyz_m)
    return ScanPoints(
        xyz_m=xyz_m,
        gps_time_s=np.linspace(100.0, 108.0, n),
        intensity=np.full(n, 3200, np.uint16),
        amplitude=np.full(n, amplitude, np.float32),
        pulse_width_ns=np.full(n, 4.3, np.float32),
        reflectance_db=np.zeros(n, np.float32),
        return_number=np.ones(n, np.uint8),
        number_of_returns=np.ones(n, np.uint8),
    )


def readings_by_hand(plates: tuple[Plate, ...], rng: np.random.Generator, count: int = 5) -> list[StationReading]:
    """Inverted by hand: S = (D - K_1) / (R_1 + n_0 / n_g). Noise: 1 mm."""
    out = []
    for station in STATIONS:
        for number, plate in enumerate(plates, start=1):
            sight = plate.distance_m * direction(plate.azimuth_deg, plate.elevation_deg) + ECCENTRICITY_M
            for observation in range(1, count + 1):
                distance = float(np.linalg.norm(sight)) + MM * rng.standard_normal()
                slope = (distance - station.additive_constant_m) / (station.scale + 1.0003 / INDEX)
                out.append(
                    StationReading(
                        station=station.name,
                        panel=f"R{number:02d}",
                        observation=observation,
                        slope_distance_m=slope,
                        horizontal_angle_deg=float(np.degrees(np.arctan2(sight[0], sight[1]))),
                        zenith_angle_deg=float(np.degrees(np.arccos(sight[2] / np.linalg.norm(sight)))),
                        temperature_c=AIR[0],
                        pressure_hpa=AIR[1],
                        relative_humidity_percent=AIR[2],
                    )
                )
    return out


class Line:
    """A ranging line in a folder, any part of which a test replaces."""

    def __init__(self, data: CampaignData, plates: tuple[Plate, ...] = PLATES, clutter: tuple[Plate, ...] = ()) -> None:
        rng = np.random.default_rng(3)
        self.data = data
        self.scans = [
            np.concatenate([returns_from(p, rng, 3 * MM) for p in (*plates, *clutter)]) @ some_rotation().T
            for _ in range(5)
        ]
        self.readings = readings_by_hand(plates, rng)
        self.line = RangingLine(
            stations=STATIONS,
            panels=tuple(RangingPanel(id=f"R{k + 1:02d}", size_m=SIZE_M) for k in range(len(plates))),
            eccentricity_m=(0.4, -0.3, 0.1),
            eccentricity_std_m=0.0005,
        )

    def evaluate(self, line: RangingLine | None = None) -> RangingResult:
        for number, xyz in enumerate(self.scans, start=1):
            write_scan(
                scan_path(self.data.folder, number),
                points(xyz),
                number=number,
                creation_date="2026-06-11",
                system_identifier="by hand",
            )
        return self.as_it_stands(line)

    def as_it_stands(self, line: RangingLine | None = None) -> RangingResult:
        ranging = RangingData(
            line=line or self.line,
            readings=tuple(self.readings),
            scans=tuple(scan_paths(self.data.folder).items()),
        )
        return evaluate_ranging(replace(self.data, ranging=ranging), lambda *_: None)


@pytest.fixture
def line(bare_data: CampaignData, tmp_path: Path) -> Line:
    return Line(replace(bare_data, folder=CampaignFolder(tmp_path)))


def test_constants_from_a_line_by_hand(line: Line) -> None:
    """Rationale: measured = true + 0.31 m, the instrument on its side, its beams an inch apart: the evaluator must find the
    panels by the total station's distances alone.

    Expected: K_2 = -0.31 m, R_2 = 0, both within 3.5 of their standard deviations, which the noise (1 mm of 5 readings, 3 mm
    of hundreds of points) holds below 1.2 mm and 1e-5; m_z before is 0.31 m over 85.333 m = 0.3633 %, after the noise.
    Tolerance: 3.5 sigma is 1 in 2000, for one seed; before: 1 mm of 0.31 m.
    """
    result = line.evaluate()
    value = result.indicator
    assert result.covariance is not None and value.value is not None, value.reason
    k2_std, r2_std = np.sqrt(np.diag(result.covariance))
    assert result.additive_constant_m == pytest.approx(-OFF_M, abs=3.5 * k2_std)
    assert result.multiplication_constant == pytest.approx(0.0, abs=3.5 * r2_std)
    assert 0.3 * MM < k2_std < 1.2 * MM and r2_std < 1e-5
    assert value.companions["relative_rmse_before_percent"] == pytest.approx(100 * OFF_M / 85.3333, rel=4e-3)
    assert value.value < 100 * 1.5 * MM / 85.3
    assert value.std is not None and 0 < value.std < value.value * 3
    assert value.sample_size == 6
    assert [p.scans for p in result.panels] == [5] * 6
    assert value.companions["scan_duration_s"] == pytest.approx(8.0, abs=0.1)


def test_walls_at_the_same_distances_are_no_panels(bare_data: CampaignData, tmp_path: Path) -> None:
    """Rationale: in a field there are walls and fences at the panels' distances.

    Expected: two walls, and a board of the panel's size at a wrong angle, change nothing but the search.
    Tolerance: as above.
    """
    clutter = (
        Plate(distance_m=70.0, azimuth_deg=30.0, width_m=6.0, height_m=4.0, turned_deg=0.0),
        Plate(distance_m=130.0, azimuth_deg=-40.0, width_m=9.0, height_m=3.0),
        Plate(distance_m=100.1, azimuth_deg=55.0),
        Plate(distance_m=40.05, azimuth_deg=-60.0),
    )
    result = Line(replace(bare_data, folder=CampaignFolder(tmp_path)), clutter=clutter).evaluate()
    assert result.covariance is not None, result.indicator.reason
    assert len(result.panels) == 6 and not result.not_used
    assert result.additive_constant_m == pytest.approx(-OFF_M, abs=3.5 * np.sqrt(result.covariance[0, 0]))


def test_a_reading_without_a_value_is_left_out_and_named(line: Line) -> None:
    """Expected: no air pressure in one row, no distance in another: both named, four readings counted, the rest goes on."""
    line.readings[2] = replace(line.readings[2], pressure_hpa=None)
    line.readings[31] = replace(line.readings[31], slope_distance_m=None)
    result = line.evaluate()
    assert result.indicator.value is not None, result.indicator.reason
    left_out, notes = (result.indicator.companions[k] for k in ("left_out", "notes"))
    assert left_out == ["A R01 observation 3: no pressure_hpa", "B R01 observation 2: no slope_distance_m"]
    assert isinstance(notes, list) and "R01: 4 readings of A, 9.1.2 asks for 5" in notes
    assert (result.panels[0].correction_readings, result.panels[0].reference_readings) == (4, 4)


def turned(readings: list[StationReading], horizontal: float, zenith: float) -> list[StationReading]:
    return [
        replace(
            r,
            horizontal_angle_deg=(r.horizontal_angle_deg or 0.0) * horizontal,
            zenith_angle_deg=(r.zenith_angle_deg or 0.0) * zenith,
        )
        for r in readings
    ]


def test_a_line_recorded_otherwise_is_refused_by_name(line: Line) -> None:
    """Rationale: angles counted the other way, in gon, or an eccentricity from the LiDAR to the stations still give plausible
    distances and wrong constants.

    Expected: no value, and the reason names what is wrong; as written by hand it is measured (other tests).
    """
    plain = list(line.readings)
    line.readings = turned(plain, -1.0, 1.0)
    mirrored = line.evaluate().indicator
    assert mirrored.value is None and "counter-clockwise (mirrored)" in str(mirrored.reason)
    assert mirrored.companions["misread"] == mirrored.reason
    line.readings = turned(plain, 1 / 0.9, 1 / 0.9)
    assert "in gon" in str(line.as_it_stands().indicator.reason)
    line.readings = plain
    opposite = line.line.model_copy(update={"eccentricity_m": (-0.4, 0.3, -0.1)})
    assert "wrong sign" in str(line.as_it_stands(opposite).indicator.reason)


def off(readings: list[StationReading], panel: str, by_m: float) -> list[StationReading]:
    return [replace(r, slope_distance_m=(r.slope_distance_m or 0) + by_m * (r.panel == panel)) for r in readings]


def test_one_panel_that_does_not_fit_is_left_out_and_named(line: Line) -> None:
    """Rationale: both stations' readings of R02 are 5 cm long (a prism's constant, a panel that was moved).

    Expected: the test of (14) fails and says so; R02 takes no part in K_2 and R_2, which stay within 3.5 of their standard
    deviations; m_z still counts it: 50 mm / sqrt(6) over 85.3 m. Tolerance of m_z: noise of 2 mm in 50.
    """
    line.readings = off(line.readings, "R02", 0.05)
    result = line.evaluate()
    companions = result.indicator.companions
    assert result.covariance is not None and result.indicator.value is not None
    assert result.additive_constant_m == pytest.approx(-OFF_M, abs=3.5 * np.sqrt(result.covariance[0, 0]))
    assert np.sqrt(result.covariance[0, 0]) < 1.5 * MM
    assert isinstance(companions["chi_square_p"], float) and companions["chi_square_p"] < 1e-6
    assert "R02 is left out of K2 and R2" in result.not_used["R02"]
    assert "R02 is left out of K2 and R2" in str(companions["notes"])
    assert result.indicator.value == pytest.approx(100 * 0.05 / np.sqrt(6.0) / 85.342, rel=0.05)


def test_of_five_panels_none_is_left_out(bare_data: CampaignData, tmp_path: Path) -> None:
    """Rationale: 9.1.2 a wants five. Expected: R02 is named, but stays; the covariance carries what it does not explain."""
    five = Line(replace(bare_data, folder=CampaignFolder(tmp_path)), plates=PLATES[:5])
    plain = five.evaluate()
    five.readings = off(five.readings, "R02", 0.05)
    result = five.as_it_stands()
    assert "without R02 they agree" in str(result.indicator.companions["notes"]) and not result.not_used
    assert result.covariance is not None and plain.covariance is not None
    factor = float(result.indicator.companions["chi_square"]) / 3.0  # type: ignore[arg-type]
    assert factor > 50
    assert result.covariance[1, 1] / plain.covariance[1, 1] == pytest.approx(factor, rel=1e-2)


def test_residuals_that_no_panel_explains_scale_the_covariance() -> None:
    """Differences +-10 mm in turn, of 1 mm each: six residuals of about 10 mm. Expected: all panels stay; the covariance is that
    of the stated accuracy times chi-square over four; nothing is done to residuals of 1 mm. Tolerance: rounding.
    """
    measured = np.array([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    names = [f"R{k}" for k in range(6)]
    sign = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    stated = np.eye(6) * MM**2
    rough = adjusted_constants(names, measured, measured + 10 * MM * sign, stated)
    assert rough.without is None and rough.factor == pytest.approx(rough.chi_square / 4.0) and rough.p < 1e-10
    assert rough.chi_square == pytest.approx(
        600.0 - 100.0 * 9.0 / 17.5, rel=1e-6
    )  # slope: sum of x * sign = -3, of x^2 17.5
    fine = adjusted_constants(names, measured, measured + MM * sign, stated)
    assert (fine.factor, fine.remark) == (1.0, None)
    assert rough.covariance == pytest.approx(rough.factor * fine.covariance)


def test_copies_of_a_scan_are_no_observations(line: Line) -> None:
    """Rationale: one scan saved five times has no scatter. Expected: one observation of each panel, named copies, and K_2's
    standard deviation not below that of five scans.
    """
    five = line.evaluate()
    line.scans = line.scans[:1] * 5
    one = line.evaluate()
    assert [p.scans for p in one.panels] == [1] * 6
    same = one.indicator.companions["same_scans"]
    assert isinstance(same, list) and len(same) == 4
    assert same[0] == "scan_02.laz holds the same points as scan_01.laz: no independent observation, left out"
    assert one.covariance is not None and five.covariance is not None
    assert one.covariance[0, 0] >= five.covariance[0, 0]


def test_missing_humidity_and_strange_pressure(line: Line) -> None:
    """Expected: without humidity 50 % is taken and said (0.3 ppm of 160 m at 0 degrees: 0.02 mm); 760 mmHg entered as hPa is
    noted.
    """
    plain = line.evaluate()
    line.readings = [replace(r, relative_humidity_percent=None) for r in line.readings]
    dry = line.as_it_stands()
    assert dry.additive_constant_m == pytest.approx(plain.additive_constant_m, abs=0.05 * MM)
    notes = dry.indicator.companions["notes"]
    assert isinstance(notes, list) and notes[0].startswith("no humidity in 60 of 60 readings: 50 % is taken")
    line.readings = [replace(r, pressure_hpa=760.0) for r in line.readings]
    assert "is it in mmHg (1013 hPa)?" in str(line.as_it_stands().indicator.companions["notes"])
    assert standard_pressure_hpa(0.0) == 1013.25
    assert standard_pressure_hpa(3000.0) == pytest.approx(701.1, abs=0.1)  # ISO 2533


def test_two_uses_take_two_stations(line: Line) -> None:
    """Rationale: without `serves` a station serves both, and true values from the readings that gave K_2 prove nothing.

    Expected: the best class for the true values, the other for K_2; a third is named as not used; a second one too poor for its
    use leaves both to the first.
    """
    both = ("correction", "reference")
    poor, good = (s.model_copy(update={"serves": both}) for s in STATIONS)
    third = poor.model_copy(update={"name": "C", "class_mm": 20.0})
    three = line.line.model_copy(update={"stations": (poor, third, good)})
    line.readings += [replace(r, station="C") for r in line.readings if r.station == "A"]
    readings = tuple(line.readings)
    assert {use: s.name for use, s in stations_of(three, readings).items()} == {"correction": "A", "reference": "B"}
    assert unused_stations(three, readings) == ["station C: not used; taken are A for correction, B for reference"]
    two = line.line.model_copy(update={"stations": (third, good)})
    assert {use: s.name for use, s in stations_of(two, readings).items()} == {"correction": "B", "reference": "B"}
    companions = line.evaluate(three).indicator.companions
    assert companions["stations"] == {"correction": "A", "reference": "B"}
    assert "station C: not used" in str(companions["left_out"])


def test_a_wrong_reading_is_left_out_and_named(line: Line) -> None:
    """A reading 1 m off its four sisters moves nothing: ten times the 10 mm class is the most that is believed."""
    slope = line.readings[5].slope_distance_m
    assert slope is not None
    line.readings[5] = replace(line.readings[5], slope_distance_m=slope + 1.0)
    result = line.evaluate()
    assert result.panels[1].correction_readings == 4
    assert "from the median" in str(result.indicator.companions["left_out"])
    assert result.additive_constant_m == pytest.approx(-OFF_M, abs=4 * MM)


def test_four_panels_are_too_few(bare_data: CampaignData, tmp_path: Path) -> None:
    """Expected: not measured, with the count; what was found stands among the companions."""
    result = Line(replace(bare_data, folder=CampaignFolder(tmp_path)), plates=PLATES[:4]).evaluate()
    assert result.indicator.value is None
    assert result.indicator.reason == "too few panels of the ranging line are measured; got 4; expected at least 5"
    rows = result.indicator.companions["panels"]
    assert isinstance(rows, list)
    assert [r["lidar_m"] for r in rows] == pytest.approx([p.distance_m + OFF_M for p in PLATES[:4]], abs=3 * MM)
    assert result.additive_constant_m is None


def test_a_panel_that_no_scan_shows_is_named(line: Line) -> None:
    """R04 at 100 m is taken away: five panels are left, and a reason stands beside the sixth."""
    line.scans = [xyz[np.abs(np.linalg.norm(xyz, axis=1) - 100.3) > 2.0] for xyz in line.scans]
    result = line.evaluate()
    assert result.indicator.sample_size == 5
    assert list(result.not_used) == ["R04"] and "scan_01.laz" in result.not_used["R04"]


def test_a_scan_in_millimetres_is_recognised(line: Line) -> None:
    """Expected: a reason that says so."""
    line.scans = [xyz * 1000.0 for xyz in line.scans]
    result = line.evaluate()
    assert result.indicator.value is None
    assert "looks like millimetres" in str(result.indicator.reason)


def test_a_broken_scan_is_named_and_the_others_serve(line: Line, tmp_path: Path) -> None:
    """Expected: four scans, a note at each panel, the broken file named without the folder's path."""
    line.evaluate()
    path = scan_path(line.data.folder, 2)
    path.write_bytes(path.read_bytes()[:700])
    result = line.as_it_stands()
    assert result.indicator.value is not None
    assert [p.scans for p in result.panels] == [4] * 6
    text = json.dumps(result.indicator.companions, allow_nan=False)
    assert "ranging/scans/scan_02.laz" in text and str(tmp_path) not in text
    assert "R01: 4 scans, 9.1.2 asks for 5" in text


def test_stations(line: Line) -> None:
    """Expected: nobody for 9.1.2 k: a reason; a station that no line.json knows: left out; classes too poor: noted."""
    line.readings.append(replace(line.readings[0], station="C"))
    poor = line.line.model_copy(update={"stations": (STATIONS[0], STATIONS[1].model_copy(update={"class_mm": 6.0}))})
    companions = line.evaluate(poor).indicator.companions
    assert companions["left_out"] == ["station C: stands in no line.json (1 readings left out)"]
    assert companions["notes"] == ["B is of the 6 mm class, 9.1.2 k asks for 5 mm"]
    lonely = line.line.model_copy(update={"stations": STATIONS[:1]})
    assert "serves 'reference' (9.1.2 k)" in str(line.as_it_stands(lonely).indicator.reason)


@pytest.mark.parametrize("what", ["line", "readings", "scans"])
def test_a_missing_part_is_a_reason(line: Line, what: str) -> None:
    line.evaluate()
    ranging = RangingData(
        line=None if what == "line" else line.line,
        readings=() if what == "readings" else tuple(line.readings),
        scans=() if what == "scans" else tuple(scan_paths(line.data.folder).items()),
    )
    result = evaluate_ranging(replace(line.data, ranging=ranging), lambda *_: None)
    expected = {"line": "no ranging/line.json", "readings": "no reading", "scans": "no scan of the ranging line"}[what]
    assert result.indicator.value is None and str(result.indicator.reason).startswith(expected)


def test_a_record_that_cannot_be_read_is_the_reason(line: Line) -> None:
    """The reader's own words, which name the row, stand at the indicator."""
    why = "ranging/total_station.csv row 3 column temperature_c: is no number; got x"
    data = replace(line.data, ranging=RangingData(line=line.line), problems=("other", why))
    assert evaluate_ranging(data, lambda *_: None).indicator.reason == why


def test_one_station_may_serve_both(line: Line) -> None:
    """Rationale: one instrument of the 5 mm class serves both steps: then m_z is the scatter of its own fit, with n - 2
    degrees of freedom, and K_2's error cancels. Expected: the standard error foreseen is smaller than the readings' alone.
    """
    both = line.line.model_copy(
        update={"stations": (STATIONS[1].model_copy(update={"serves": ("correction", "reference")}),)}
    )
    line.readings = [r for r in line.readings if r.station == "B"]
    result = line.evaluate(both)
    companions = result.indicator.companions
    reading = companions["reading_std_m"]
    assert isinstance(reading, dict)
    expected = companions["expected_rmse_m"]
    assert isinstance(expected, float)
    assert 0.3 < expected / (reading["reference"] / np.sqrt(5.0)) < 1.1
