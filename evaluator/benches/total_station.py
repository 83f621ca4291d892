"""Total station of 9.1.2 c-e: formula (12), and from readings to distances between the LiDAR's centre and the panels.

The LiDAR's side is in `evaluator.observe.ranging_panels`, formulas (9)-(11) and (13)-(15) in `evaluator.c9_1_lidar_ranging`.
"""

from dataclasses import dataclass

import numpy as np

from campaign.benches.ranging import PRESSURE_HPA, TEMPERATURE_C, RangingLine, StationReading, TotalStation
from evaluator.model import EvaluationError

MIN_READINGS = 5  # of each panel, 9.1.2 c
OUTLIER_CLASSES = 10.0  # from the median of the panel's readings: another panel's name, a wrong unit, a wrong figure
CLASS_MM = {"correction": 10.0, "reference": 5.0}  # 9.1.2 c, k
HUMIDITY_PERCENT = 50.0  # where it is not recorded; all of it is worth less than 1 ppm below 30 degrees
PRESSURE_SHARE = 0.15  # of the standard atmosphere at the site's height: weather is 5 %
HPA_OF_MMHG = 1.333224
LEAST_STD_M = 1e-4  # of a reading: the display's last digit, where readings repeat one figure


def saturation_pressure_hpa(temperature_c: float) -> float:
    """Saturation vapour pressure over water by the Magnus formula; 0.3 % from -20 to 40 degrees. [hPa]

    References
    ----------
    WMO-No. 8, Guide to Instruments and Methods of Observation, annex 4.B.
    """
    return float(6.112 * np.exp(17.62 * temperature_c / (243.12 + temperature_c)))


def group_refractive_index(
    wavelength_um: float, temperature_c: float, pressure_hpa: float, relative_humidity_percent: float
) -> float:
    r"""Group refractive index of air n_g for a carrier wavelength.

    .. math:: N_{gr} = 287.6155 + 4.88660/\lambda^2 + 0.06800/\lambda^4, \quad
              N = \frac{273.15}{1013.25} N_{gr} \frac{p}{T} - 11.27 \frac{e}{T}, \quad n = 1 + N \cdot 10^{-6}

    Parameters
    ----------
    wavelength_um : float
        Carrier wavelength of the distance meter, 0.3 to 2. [um]
    temperature_c : float
        -40 to 60. [deg C]
    pressure_hpa : float
        500 to 1100. [hPa]
    relative_humidity_percent : float
        [%]

    Returns
    -------
    float
        Dimensionless; the standard's "in percent" cannot be meant.

    Raises
    ------
    EvaluationError
        A value outside its range.

    References
    ----------
    IUGG, Resolution 3 of the XXII General Assembly, Birmingham 1999. GB/T 41450-2022, 9.1.2 e.
    """
    for name, value, low, high in (
        ("wavelength_um", wavelength_um, 0.3, 2.0),
        ("temperature_c", temperature_c, *TEMPERATURE_C),
        ("pressure_hpa", pressure_hpa, *PRESSURE_HPA),
        ("relative_humidity_percent", relative_humidity_percent, 0.0, 100.0),
    ):
        if not low <= value <= high:
            raise EvaluationError(f"{name} is out of range", got=value, expected=f"{low:g} to {high:g}")
    standard = 287.6155 + 4.88660 / wavelength_um**2 + 0.06800 / wavelength_um**4
    kelvin = 273.15 + temperature_c
    vapour = saturation_pressure_hpa(temperature_c) * relative_humidity_percent / 100.0
    refractivity = 273.15 / 1013.25 * standard * pressure_hpa / kelvin - 11.27 * vapour / kelvin
    return 1.0 + refractivity * 1e-6


def meteorological_correction(distance_m: float, reference_index: float, group_index: float) -> float:
    """Correction of a slope distance for the air it was measured in, formula (12): S (n_0 - n_g) / n_g.

    Parameters
    ----------
    distance_m : float
        Slope distance as read, S. [m]
    reference_index : float
        n_0 of the instrument's design; dimensionless, near 1.0003.
    group_index : float
        n_g of the air at work; dimensionless.

    Returns
    -------
    float
        Delta D, to be added to S. [m]

    Raises
    ------
    EvaluationError
        An index that is none of air, or a distance that is not positive.

    References
    ----------
    GB/T 41450-2022, 9.1.2 e, formula (12).
    """
    if not (np.isfinite(distance_m) and distance_m > 0.0):
        raise EvaluationError("formula (12): the distance is not a positive number", got=distance_m)
    for name, value in (("n_0", reference_index), ("n_g", group_index)):
        if not 1.0 <= value <= 1.001:
            raise EvaluationError(
                f"formula (12): {name} is no refractive index of air", got=value, expected="1 to 1.001"
            )
    return distance_m * (reference_index - group_index) / group_index


def corrected_slope_distance(
    reading_m: float, additive_constant_m: float, scale: float, meteorological_correction_m: float
) -> float:
    """D = S + K_1 + R_1 S + Delta D: a slope distance as the certificate and the air correct it.

    Parameters
    ----------
    reading_m : float
        S, as the instrument shows it. [m]
    additive_constant_m, scale : float
        K_1 [m] and R_1, dimensionless, of the certificate.
    meteorological_correction_m : float
        Formula (12). [m]

    Returns
    -------
    float
        [m]

    References
    ----------
    GB/T 41450-2022, 9.1.2 d, e.
    """
    return reading_m + additive_constant_m + scale * reading_m + meteorological_correction_m


@dataclass(frozen=True, kw_only=True)
class StationPanel:
    """What one station says of one panel; the frame is the stations'."""

    panel: str
    readings: int
    distance_m: float  # from the LiDAR's centre, mean of the readings
    std_m: float | None  # of one reading, from their scatter; None: a single one
    place_m: np.ndarray  # (3,) mean, from the LiDAR's centre
    sight_m: float  # from the station
    class_m: float  # the instrument's class at this distance


@dataclass(frozen=True, kw_only=True)
class StationResult:
    """One use of 9.1.2: "correction" (step c) or "reference" (step k)."""

    station: TotalStation
    panels: tuple[StationPanel, ...]
    scatter: float  # standard deviation of one reading over the class, pooled over all panels
    freedom: int  # behind `scatter`; 0: the class itself stands in

    def of(self, panel: str) -> StationPanel | None:
        return next((p for p in self.panels if p.panel == panel), None)


def stations_of(line: RangingLine, readings: tuple[StationReading, ...]) -> dict[str, TotalStation]:
    """The station of each use, "correction" and "reference"; a use that no station serves is absent.

    A station without a reading is taken only where no other serves. Then come the classes that the standard asks for, then
    different stations for the two uses, then the best class for "reference" and the next for "correction".
    """
    read = {r.station for r in readings}
    serving = {use: [s for s in line.stations if use in s.serves] for use in CLASS_MM}
    serving = {use: [s for s in found if s.name in read] or found for use, found in serving.items()}
    pairs = [(c, r) for c in serving["correction"] for r in serving["reference"]]
    if not pairs:
        return {use: min(found, key=lambda s: (s.class_mm, s.name)) for use, found in serving.items() if found}
    correction, reference = min(
        pairs,
        key=lambda pair: (
            pair[1].class_mm > CLASS_MM["reference"],
            pair[0].class_mm > CLASS_MM["correction"],
            pair[0].name == pair[1].name,
            pair[1].class_mm,
            pair[0].class_mm,
            pair[1].name,
            pair[0].name,
        ),
    )
    return {"correction": correction, "reference": reference}


def unused_stations(line: RangingLine, readings: tuple[StationReading, ...]) -> list[str]:
    """One line for each station of line.json that serves neither use."""
    used = {use: s.name for use, s in stations_of(line, readings).items()}
    taken = ", ".join(f"{name} for {use}" for use, name in used.items())
    return [f"station {s.name}: not used; taken are {taken}" for s in line.stations if s.name not in used.values()]


def air_notes(line: RangingLine, readings: tuple[StationReading, ...], height_m: float) -> list[str]:
    """What of the recorded air is missing, or far from the standard atmosphere at a height above the sea. [m]"""
    stations = {s.name for s in line.stations}
    rows = [r for r in readings if r.station in stations and r.slope_distance_m is not None]
    out = []
    dry = sum(1 for r in rows if r.relative_humidity_percent is None)
    if dry:
        taken = f"{HUMIDITY_PERCENT:.0f} % is taken, worth less than 1 ppm below 30 degrees"
        out.append(f"no humidity in {dry} of {len(rows)} readings: {taken}")
    expected = standard_pressure_hpa(height_m)
    strange = [r.pressure_hpa for r in rows if r.pressure_hpa and abs(r.pressure_hpa / expected - 1.0) > PRESSURE_SHARE]
    if strange:
        middle = float(np.median(strange))
        in_mmhg = abs(middle * HPA_OF_MMHG / expected - 1.0) < PRESSURE_SHARE
        out.append(
            f"pressure of {len(strange)} of {len(rows)} readings ({middle:.0f} hPa) lies more than "
            f"{100.0 * PRESSURE_SHARE:.0f} % from the standard atmosphere's {expected:.0f} hPa at {height_m:.0f} m: "
            + (
                f"is it in mmHg ({middle * HPA_OF_MMHG:.0f} hPa)?"
                if in_mmhg
                else "is it in hPa and not reduced to sea level?"
            )
        )
    return out


def standard_pressure_hpa(height_m: float) -> float:
    """Of the standard atmosphere below 11 km (ISO 2533). [hPa]"""
    return float(1013.25 * (1.0 - 2.25577e-5 * height_m) ** 5.25588)


def readings_of(
    line: RangingLine, readings: tuple[StationReading, ...], station: TotalStation
) -> tuple[StationResult, list[str]]:
    """Means over one station's readings, and one line for each reading that is left out."""
    known = {panel.id for panel in line.panels}
    left_out: list[str] = []
    places: dict[str, list[np.ndarray]] = {panel.id: [] for panel in line.panels}
    sights: dict[str, list[float]] = {panel.id: [] for panel in line.panels}
    for reading in readings:
        if reading.station != station.name:
            continue
        name = f"{reading.station} {reading.panel} observation {reading.observation}"
        if reading.panel not in known:
            left_out.append(f"{name}: the panel stands in no line.json")
            continue
        try:
            place = _place(station, reading)
        except EvaluationError as error:
            left_out.append(f"{name}: {error}")
            continue
        places[reading.panel].append(place - np.asarray(line.eccentricity_m))
        sights[reading.panel].append(float(np.linalg.norm(place)))
    panels = []
    squares, freedom = 0.0, 0
    for panel, rows in places.items():
        if not rows:
            continue
        place = np.stack(rows)
        distance = np.linalg.norm(place, axis=1)
        class_m = 1e-3 * station.class_mm + 1e-6 * station.class_ppm * float(np.median(distance))
        good = np.abs(distance - np.median(distance)) <= OUTLIER_CLASSES * class_m
        left_out += [
            f"{station.name} {panel}: {value:.3f} m lies more than {OUTLIER_CLASSES * class_m:.3f} m from the median"
            for value in distance[~good]
        ]
        place, distance = place[good], distance[good]
        if len(distance) == 0:  # two readings that disagree
            continue
        squares += float(np.sum((distance - distance.mean()) ** 2)) / class_m**2
        freedom += len(distance) - 1
        panels.append(
            StationPanel(
                panel=panel,
                readings=len(distance),
                distance_m=float(distance.mean()),
                std_m=float(distance.std(ddof=1)) if len(distance) > 1 else None,
                place_m=place.mean(axis=0),
                sight_m=float(np.mean(np.asarray(sights[panel])[good])),
                class_m=class_m,
            )
        )
    scatter = float(np.sqrt(squares / freedom)) if freedom else 1.0
    return StationResult(station=station, panels=tuple(panels), scatter=scatter, freedom=freedom), left_out


def unknown_stations(line: RangingLine, readings: tuple[StationReading, ...]) -> list[str]:
    """One line for each station that is read but stands in no line.json."""
    known = {s.name for s in line.stations}
    names = [r.station for r in readings if r.station not in known]
    return [
        f"station {name}: stands in no line.json ({names.count(name)} readings left out)" for name in sorted(set(names))
    ]


def covariance_m2(result: StationResult, panels: list[str]) -> np.ndarray:
    """(n, n) of the mean distances: scatter of the readings, and what the certificate leaves open, which is common to all.

    The class says how the scatter grows with distance, the readings of all panels together how large it is. The eccentricity
    is not in it: both stations share it (`eccentricity_covariance_m2`). [m2]
    """
    found = [p for name in panels if (p := result.of(name)) is not None]
    reading_m = np.maximum(result.scatter * np.array([p.class_m for p in found]), LEAST_STD_M)
    sight = np.array([p.sight_m for p in found])
    station = result.station
    return (
        np.diag(reading_m**2 / np.array([p.readings for p in found], float))
        + station.additive_constant_std_m**2
        + station.scale_std**2 * np.outer(sight, sight)
    )


def eccentricity_covariance_m2(line: RangingLine, result: StationResult, panels: list[str]) -> np.ndarray:
    """(n, n) of the distances for the stated eccentricity's standard deviation, the same draw for every panel. [m2]"""
    direction = np.stack([p.place_m / np.linalg.norm(p.place_m) for n in panels if (p := result.of(n)) is not None])
    return line.eccentricity_std_m**2 * direction @ direction.T


def _place(station: TotalStation, reading: StationReading) -> np.ndarray:
    """(3,) the panel's centre in the stations' frame, from their common centre. [m]"""
    named = {
        "slope_distance_m": reading.slope_distance_m,
        "horizontal_angle_deg": reading.horizontal_angle_deg,
        "zenith_angle_deg": reading.zenith_angle_deg,
        "temperature_c": reading.temperature_c,
        "pressure_hpa": reading.pressure_hpa,
        "relative_humidity_percent": HUMIDITY_PERCENT
        if reading.relative_humidity_percent is None
        else reading.relative_humidity_percent,
    }
    missing = [name for name, value in named.items() if value is None or not np.isfinite(value)]
    if missing:
        raise EvaluationError(f"no {missing[0]}")
    slope, horizontal, zenith, temperature, pressure, humidity = (float(v) for v in named.values() if v is not None)
    index = group_refractive_index(station.wavelength_um, temperature, pressure, min(humidity, 100.0))
    correction = meteorological_correction(slope, station.reference_index, index)
    distance = corrected_slope_distance(slope, station.additive_constant_m, station.scale, correction)
    h, z = np.radians(horizontal), np.radians(zenith)
    return distance * np.array([np.sin(z) * np.sin(h), np.sin(z) * np.cos(h), np.cos(z)])
