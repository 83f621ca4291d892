"""7.1-7.4: the flight plan, the flight's environment, speed and acceleration along strips, heights and formula (1)."""

import numpy as np

from evaluator.conformity.flight import (
    StripFlight,
    flight_times,
    strip_flights,
    sun_elevation,
    wind_two_minute_mean,
)
from evaluator.conformity.model import ConformityInputs, Row, Status, missing, passed, percent, row
from evaluator.model import CampaignData, EvaluationError
from evaluator.observe.panel_images import focal_length_mm

_MAX_SPEED = {"fixed_wing": 30.0, "multirotor": 16.0}
_FORCE_5_M_S = 10.7
_HEIGHT_WARNING, _HEIGHT_LIMIT = 0.05, 0.10
_AGREES = 0.05  # flown height against formula (1): as the flown height against the design height in 7.4 b


def flight_height(focal_mm: float, gsd_m: float, pixel_mm: float) -> float:
    """Flying height H that gives a ground resolution.

    Parameters
    ----------
    focal_mm : float
        Focal length f: the lens's principal distance, see `focal_length_mm`. [mm]
    gsd_m : float
        Ground resolution GSD. [m]
    pixel_mm : float
        Pixel size a. [mm]

    Returns
    -------
    float
        H = f GSD / a, above the ground. [m]

    Raises
    ------
    EvaluationError
        A value that is not finite or not positive.

    References
    ----------
    GB/T 41450-2022, 7.4 a, formula (1).
    """
    for name, value in (("focal_mm", focal_mm), ("gsd_m", gsd_m), ("pixel_mm", pixel_mm)):
        if not (np.isfinite(value) and value > 0.0):
            raise EvaluationError("must be a positive number", where=name, got=value)
    return focal_mm * gsd_m / pixel_mm


def _plan(data: CampaignData) -> list[Row]:
    requirements = {
        "7.1 a": "aircraft",
        "7.1 b": "take-off and landing point",
        "7.1 c": "area in latitude and longitude, map sheet",
        "7.1 d": "flight area and its size",
        "7.1 e": "season and time",
        "7.1 f": "deadline of the task",
        "7.1 g": "other technical requirements",
    }
    plan = data.plan
    if plan is None:
        return [missing(c, f"flight plan: {r}", "stated", "plan.json") for c, r in requirements.items()]
    corners = ", ".join(f"{lat:.4f}° {lon:.4f}°" for lat, lon in plan.area_lat_lon_deg)
    lat, lon = plan.takeoff_lat_lon_deg
    stated = {
        "7.1 a": f"{plan.aircraft} ({plan.aircraft_kind.replace('_', ' ')})" if plan.aircraft else "",
        "7.1 b": f"{lat:.5f}° {lon:.5f}°",
        "7.1 c": f"sheet {plan.map_sheet}; {corners}" if plan.map_sheet and corners else "",
        "7.1 d": f"{plan.area_m2:,.0f} m²" if plan.area_m2 > 0 else "",
        "7.1 e": f"{plan.season}, {plan.start_time}, {plan.duration_s / 60.0:.0f} min" if plan.season else "",
        "7.1 f": plan.deadline,
        "7.1 g": plan.requirements,
    }
    return [
        row(
            c,
            f"flight plan: {r}",
            stated[c] or "not stated in plan.json",
            "stated",
            "pass" if stated[c] else "not_recorded",
        )
        for c, r in requirements.items()
    ]


def _gnss(data: CampaignData) -> list[Row]:
    rows = []
    plan = data.plan
    if plan is None:
        rows += [
            missing("7.2 a", "obstacles seen from the take-off point", "≤ 20°", "plan.json"),
            missing("7.2 a", "GNSS keeps lock", "no loss", "plan.json"),
        ]
    else:
        angle = plan.obstacle_angle_deg
        rows.append(
            row("7.2 a", "obstacles seen from the take-off point", f"{angle:.0f}°", "≤ 20°", passed(angle <= 20.0))
        )
        text = "lock lost during the flight" if plan.lock_lost else "no loss of lock"
        rows.append(row("7.2 a", "GNSS keeps lock", text, "no loss", passed(not plan.lock_lost)))
    satellites = [r.satellites for s in data.sorties for r in s.environment if r.satellites is not None]
    if satellites:
        text = f"{min(satellites)} at least, {len(satellites)} records"
        rows.append(row("7.2 b", "satellites in view", text, "≥ 10", passed(min(satellites) >= 10)))
    else:
        rows.append(missing("7.2 b", "satellites in view", "≥ 10", "satellites in environment.csv"))
    requirement, limit = "position of the platform at rest assessed before take-off", "done"
    if plan is None:
        rows.append(missing("7.2 b", requirement, limit, "plan.json"))
    else:
        text = f"{plan.static_check_s:.0f} s, standard deviation {plan.static_check_std_m * 1000:.0f} mm"
        rows.append(row("7.2 b", requirement, text, limit, passed(plan.static_check_s > 0.0)))
    return rows


def _sun(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    least, change = "elevation of the sun", "change of the sun's elevation during the flight"
    times = flight_times(data, measured)
    if not times.size:
        return [
            missing("7.2 c", least, "> 35°", "times of strips"),
            missing("7.2 c", change, "≤ 20°", "times of strips"),
        ]
    elevation = sun_elevation(data, times)
    low, high = float(elevation.min()), float(elevation.max())
    minutes = (times[-1] - times[0]) / 60.0
    return [
        row("7.2 c", least, f"{low:.1f}° to {high:.1f}°", "> 35°", passed(low > 35.0)),
        row("7.2 c", change, f"{high - low:.1f}° over {minutes:.0f} min", "≤ 20°", passed(high - low <= 20.0)),
    ]


def _wind(data: CampaignData) -> list[Row]:
    requirement, limit = "wind, two-minute mean", f"≤ force 5 (≤ {_FORCE_5_M_S} m/s)"
    means = []
    for sortie in data.sorties:
        record = [(r.gps_time_s, r.wind_speed_m_s) for r in sortie.environment if r.wind_speed_m_s is not None]
        if record:
            means.append(wind_two_minute_mean(*np.array(record, dtype=float).T))
    if not means:
        return [missing("7.2 d", requirement, limit, "wind in environment.csv")]
    return [row("7.2 d", requirement, f"{max(means):.1f} m/s", limit, passed(max(means) <= _FORCE_5_M_S))]


def _speed(data: CampaignData, flights: list[StripFlight]) -> list[Row]:
    kind = data.plan.aircraft_kind if data.plan else data.rig.kind if data.rig else None
    limit_speed = (
        "≤ 16 m/s multirotor, ≤ 30 m/s fixed wing"
        if kind is None
        else f"≤ {_MAX_SPEED[kind]:.0f} m/s ({kind.replace('_', ' ')})"
    )
    requirements = (
        ("7.3 a", "greatest ground speed along strips", limit_speed),
        ("7.3 b", "steady flight at the task's height; speed suited to the wind", "not quantified"),
        ("7.3 c", "greatest acceleration along strips (over 0.5 s)", "≤ 2.5 m/s²"),
    )
    if not flights:
        return [missing(c, r, limit, "trajectory over a strip") for c, r, limit in requirements]
    (a, ra, la), (b, rb, lb), (c, rc, lc) = requirements
    fastest = max(flights, key=lambda f: f.ground_speed_m_s.max())
    speed = float(fastest.ground_speed_m_s.max())
    status: Status = "not_recorded" if kind is None else passed(speed <= _MAX_SPEED[kind])
    rows = [row(a, ra, f"{speed:.2f} m/s ({fastest.name})", la, status)]
    spread = max(float(f.ground_speed_m_s.std()) for f in flights)
    wander = max(float(f.height_m.std()) for f in flights)
    text = f"standard deviation within a strip: speed ≤ {spread:.2f} m/s, height ≤ {wander:.2f} m"
    rows.append(row(b, rb, text, lb, "pass"))
    hardest = [f for f in flights if f.acceleration_m_s2.size]
    if not hardest:
        return [*rows, missing(c, rc, lc, "strip of half a second")]
    worst = max(hardest, key=lambda f: f.acceleration_m_s2.max())
    value = float(worst.acceleration_m_s2.max())
    return [*rows, row(c, rc, f"{value:.2f} m/s² ({worst.name})", lc, passed(value <= 2.5))]


def _resolution(data: CampaignData) -> Row:
    requirement = "height from the ground resolution, H = f·GSD/a (1)"
    limit = f"within {percent(_AGREES, 0)} of the lowest design height"
    if data.plan is None or data.camera is None or not data.plan.strips:
        return missing("7.4 a", requirement, limit, "plan or camera sheet")
    focal, pixel = focal_length_mm(data.camera), data.camera.pixel_size_um / 1000.0
    if not data.plan.gsd_m > 0.0:
        return missing("7.4 a", requirement, limit, "ground resolution in plan.json")
    height = flight_height(focal, data.plan.gsd_m, pixel)
    design = min(s.height_m for s in data.plan.strips)
    text = f"{focal:.2f} mm × {data.plan.gsd_m * 100:.2f} cm / {pixel * 1000:g} µm = {height:.1f} m, planned {design:.1f} m"
    return row("7.4 a", requirement, text, limit, passed(abs(design - height) <= _AGREES * height))


def _heights(flights: list[StripFlight]) -> list[Row]:
    ceiling = ("7.4 a", "ceiling of the platform's flight", "≤ 1000 m")
    within = ("7.4 b", "change of height within a strip", "≤ 5 % (warning), ≤ 10 % of the relative height")
    against = ("7.4 b", "flown against design height", "≤ 5 %")
    step = ("7.4 c", "height between neighbouring exposures of a strip", "≤ 5 m")
    metres = ("7.4 c", "flown against design height", "≤ 5 m")
    if not flights:
        return [
            missing(c, r, limit, "trajectory over a strip") for c, r, limit in (ceiling, within, against, step, metres)
        ]
    rows = []
    highest = max(float(f.height_m.max()) for f in flights)
    rows.append(
        row(ceiling[0], ceiling[1], f"{highest:.1f} m above the site's origin", ceiling[2], passed(highest <= 1000.0))
    )
    worst = max(flights, key=lambda f: np.ptp(f.height_m) / f.height_m.mean())
    change = float(np.ptp(worst.height_m) / worst.height_m.mean())
    status: Status = "fail" if change > _HEIGHT_LIMIT else "warning" if change > _HEIGHT_WARNING else "pass"
    rows.append(row(within[0], within[1], f"{percent(change, 2)} ({worst.name})", within[2], status))

    planned = [(f, f.design_height_m) for f in flights if f.design_height_m is not None]
    if planned:
        off = max(float(np.abs(f.height_m - design).max()) for f, design in planned)
        relative = max(float(np.abs(f.height_m - design).max() / design) for f, design in planned)
        rows.append(
            row(against[0], against[1], f"{percent(relative, 2)} at most", against[2], passed(relative <= 0.05))
        )
    else:
        rows.append(missing(against[0], against[1], against[2], "design heights in plan.json"))

    steps = [
        (float(np.abs(np.diff(f.exposure_height_m)).max()), f.name) for f in flights if f.exposure_height_m.size > 1
    ]
    if steps:
        value, name = max(steps)
        rows.append(row(step[0], step[1], f"{value:.2f} m ({name})", step[2], passed(value <= 5.0)))
    else:
        rows.append(missing(step[0], step[1], step[2], "two exposures in a strip"))
    if planned:
        rows.append(row(metres[0], metres[1], f"{off:.2f} m at most", metres[2], passed(off <= 5.0)))
    else:
        rows.append(missing(metres[0], metres[1], metres[2], "design heights in plan.json"))
    return rows


def clause_7(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    """Rows of clause 7. Speeds, accelerations and heights are taken along strips, not in turns."""
    flights = list(strip_flights(data, measured))
    heights = _heights(flights)
    return [
        *_plan(data),
        *_gnss(data),
        *_sun(data, measured),
        *_wind(data),
        *_speed(data, flights),
        heights[0],
        _resolution(data),
        *heights[1:],
    ]
