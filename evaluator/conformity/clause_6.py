"""6.2: the range itself, what the targets are made of, and where they stand."""

import math

import numpy as np

from campaign.survey import SurveyedTarget
from evaluator.conformity.model import ConformityInputs, Row, missing, passed, percent, row
from evaluator.frames import WorldFrame
from evaluator.model import CampaignData
from evaluator.observe.panel_images import camera_lens

_MATERIALS = {"barium_sulfate": "BaSO4", "ptfe": "PTFE", "water_based_paint": "water-based paint"}
_FLATNESS = 0.05
_LASER_HALF_WIDTH_NM = 5.0  # a receiver's interference filter
_VERTEX_TOLERANCE_M = 0.005
_SHORT_S = 60.0  # stands in for "short" where the rig states no correlation time of its navigation


def band_flatness(wavelength_nm: np.ndarray, reflectance: np.ndarray, low_nm: float, high_nm: float) -> float:
    """Spectral flatness of one panel over one response band: (max - min) / mean.

    Parameters
    ----------
    wavelength_nm, reflectance : (w,) np.ndarray
        The panel's spectrum. [nm], [1]
    low_nm, high_nm : float
        The band's edges at half its response; the spectrum is interpolated there. [nm]

    Returns
    -------
    float
        [1]

    References
    ----------
    GB/T 41450-2022, 3.17 (which names no formula), 6.2.2 b.
    """
    inside = (wavelength_nm > low_nm) & (wavelength_nm < high_nm)
    x = np.concatenate([[low_nm], wavelength_nm[inside], [high_nm]])
    y = np.interp(x, wavelength_nm, reflectance)
    mean = np.trapezoid(y, x) / (high_nm - low_nm)
    return float((y.max() - y.min()) / mean) if mean > 0.0 else math.inf


def worst_flatness(data: CampaignData) -> tuple[str, float] | None:
    """The panel and band of the greatest `band_flatness`, over the camera's bands and the laser's line."""
    bands: list[tuple[str, float, float]] = []
    if data.camera:
        bands += [(b.name, b.centre_nm - b.fwhm_nm / 2, b.centre_nm + b.fwhm_nm / 2) for b in data.camera.bands]
    if data.lidar:
        line = data.lidar.wavelength_nm
        bands.append((f"{line:g} nm", line - _LASER_HALF_WIDTH_NM, line + _LASER_HALF_WIDTH_NM))
    spectra = data.spectra
    if spectra is None or not spectra.panel_ids or not bands:
        return None
    found = [
        (f"{panel}, {name}", band_flatness(spectra.wavelength_nm, spectra.reflectance[:, k], low, high))
        for k, panel in enumerate(spectra.panel_ids)
        for name, low, high in bands
    ]
    return max(found, key=lambda pair: pair[1])


def survey_accuracy(data: CampaignData) -> tuple[float, float] | None:
    """Greatest stated standard deviation of the frustum targets: horizontal (both axes in quadrature) and height. [m]"""
    frustums = [t for t in data.targets if t.kind == "frustum"]
    if not frustums:
        return None
    return max(float(np.hypot(t.easting_std_m, t.northing_std_m)) for t in frustums), max(
        t.height_std_m for t in frustums
    )


def _range(data: CampaignData) -> list[Row]:
    n = len(data.targets)
    requirement = "targets can be surveyed in the field"
    surveyed = (
        row("6.2.1 a", requirement, f"{n} targets surveyed", "required", "pass")
        if n
        else missing("6.2.1 a", requirement, "required", "survey/targets.csv")
    )
    requirement, limit = "slope of the terrain", "< 10°"
    if data.plan is None:
        slope = missing("6.2.1 b", requirement, limit, "plan.json")
    else:
        angle = data.plan.ground_slope_deg
        slope = row("6.2.1 b", requirement, f"{angle:.1f}° (reconnaissance)", limit, passed(angle < 10.0))
    requirement, limit = "illuminance", "10 000 lx to 100 000 lx"
    lux = [r.illuminance_lx for s in data.sorties for r in s.environment if r.illuminance_lx is not None]
    if not lux:
        return [surveyed, slope, missing("6.2.1 c", requirement, limit, "illuminance in environment.csv")]
    text = f"{min(lux):.0f} lx to {max(lux):.0f} lx, {len(lux)} records"
    if max(lux) > 1e5:
        text += "; a clear sky passes 100 klx above about 58° of sun elevation"
    return [surveyed, slope, row("6.2.1 c", requirement, text, limit, passed(min(lux) >= 1e4 and max(lux) <= 1e5))]


def _material(clause: str, requirement: str, targets: list[SurveyedTarget]) -> Row:
    limit = "BaSO4, PTFE or water-based paint"
    if not targets:
        return missing(clause, requirement, limit, "such target in survey/targets.csv")
    found = sorted({t.material for t in targets})
    if found == [""]:
        return missing(clause, requirement, limit, "material in survey/targets.csv")
    text = ", ".join(_MATERIALS.get(m, m or "not stated") for m in found)
    return row(clause, requirement, text, limit, passed(set(found) <= set(_MATERIALS)))


def body_height_m(target: SurveyedTarget) -> float:
    """Height of a frustum target above its base plate: 0.7071 b held inverted over the plate, 0.3536 b standing on it.

    References
    ----------
    GB/T 41450-2022, 6.2.2 c-d; with legs b/2 and angles of 60 and 120 degrees no other body is left. [m]
    """
    return target.size_m / (math.sqrt(2.0) if target.style == "inverted" else math.sqrt(8.0))


def vertex_offset_m(target: SurveyedTarget) -> float:
    """Height of the faces' common vertex above the mark that the standard's angles ask for. [m]"""
    return 0.0 if target.style == "inverted" else target.size_m / math.sqrt(2.0)


def _frustum_size(frustums: list[SurveyedTarget]) -> list[Row]:
    requirement, limit = "size of the geometric targets", "at least 50 × 50 × 30 cm"
    if not frustums:
        return [
            missing("6.2.2 c", requirement, limit, "frustum target in survey/targets.csv"),
            missing("6.2.2 d", "angles of the faces", "60° and 120°, short edge half the long edge", "frustum target"),
        ]
    edge, height = min(t.size_m for t in frustums), min(body_height_m(t) for t in frustums)
    text = f"smallest {edge * 100:.0f} × {edge * 100:.0f} × {height * 100:.1f} cm ({frustums[0].style})"
    size = row("6.2.2 c", requirement, text, limit, passed(edge >= 0.5 and height >= 0.3))
    requirement = "faces are trapezoids of 60° and 120°, short edge half the long edge"
    limit = f"vertex where these angles put it, within {_VERTEX_TOLERANCE_M * 1000:.0f} mm"
    stated = [(t, t.vertex_offset_m) for t in frustums if t.vertex_offset_m is not None]
    if not stated:
        return [size, missing("6.2.2 d", requirement, limit, "vertex offset in survey/targets.csv")]
    worst, offset = max(stated, key=lambda pair: abs(pair[1] - vertex_offset_m(pair[0])))
    # Sheet metal: the vertex of the other side of the faces lies t / cos(54.74 deg) = 1.73 t away.
    allowed = _VERTEX_TOLERANCE_M + np.sqrt(3.0) * (worst.thickness_m or 0.0)
    difference = abs(offset - vertex_offset_m(worst))
    text = f"stated vertex differs by {difference * 1000:.1f} mm at most ({worst.id}), {len(stated)} targets"
    return [size, row("6.2.2 d", requirement, text, limit, passed(difference <= allowed))]


def _targets(data: CampaignData) -> list[Row]:
    panels = [t for t in data.targets if t.kind == "panel"]
    frustums = [t for t in data.targets if t.kind == "frustum"]
    rows = [_material("6.2.2 a", "material of the reference panels", panels)]
    requirement, limit = "spectral flatness of the reference panels over each band", "better than 5 %"
    flatness = worst_flatness(data)
    if flatness is None:
        rows.append(missing("6.2.2 b", requirement, limit, "spectra of the panels"))
    else:
        rows.append(
            row(
                "6.2.2 b",
                requirement,
                f"{percent(flatness[1], 1)} at worst ({flatness[0]})",
                limit,
                passed(flatness[1] < _FLATNESS),
            )
        )
    rows += _frustum_size(frustums)
    rows.append(_material("6.2.2 e", "coating of the frustums", frustums))
    requirement = "position of the geometric targets"
    limit = "better than 1 cm horizontally, 2 cm in height"
    accuracy = survey_accuracy(data)
    if accuracy is not None:
        text = f"standard deviation {accuracy[0] * 1000:.1f} mm horizontally, {accuracy[1] * 1000:.1f} mm in height, at worst"
        rows.append(row("6.2.2 f", requirement, text, limit, passed(accuracy[0] < 0.01 and accuracy[1] < 0.02)))
    else:
        rows.append(missing("6.2.2 f", requirement, limit, "surveyed frustum target"))
    rows.append(_material("6.2.2 g", "material at the centre of the base plates", frustums))
    return rows


def common_field_half_m(data: CampaignData) -> tuple[float, float] | None:
    """Half extents, east and north, of the field that camera, LiDAR and the 45° cone all cover at the lowest design height.

    Along each axis the smallest reach over the planned headings; the LiDAR limits the reach across its track only, because
    the strip itself goes on along it. None without plan, camera and LiDAR sheet.
    """
    if data.plan is None or not data.plan.strips or data.camera is None or data.lidar is None:
        return None
    height = min(s.height_m for s in data.plan.strips)
    lens = camera_lens(data.camera)
    across = data.camera.width_px / lens.fx_px / 2.0 * height
    along = data.camera.height_px / lens.fy_px / 2.0 * height
    low, high = data.lidar.sector_deg
    across = min(across, height * np.tan(np.radians(min(abs(low), abs(high), 45.0))), height)
    along = min(along, height)
    reach = np.array([np.inf, np.inf])
    for strip in data.plan.strips:
        heading = np.radians(strip.heading_deg)
        for axis, (forward, right) in enumerate(
            ((np.sin(heading), np.cos(heading)), (np.cos(heading), np.sin(heading)))
        ):
            limits = [d / abs(c) for d, c in ((along, forward), (across, right)) if abs(c) > 1e-9]
            reach[axis] = min(reach[axis], *limits)
    return float(reach[0]), float(reach[1])


def _layout(data: CampaignData) -> list[Row]:
    corners, limit_corners = "targets at the centre and the four corners of the common field", "one at each"
    cover, limit_cover = "targets cover evenly what both sensors see within 45° of nadir", "every ninth of the field"
    field = common_field_half_m(data)
    if field is None or not data.targets:
        what = "plan, sensor sheets or survey to compute the common field"
        return [missing("6.2.3 a", corners, limit_corners, what), missing("6.2.3 a", cover, limit_cover, what)]
    world = WorldFrame(data.manifest).world_from_map(
        np.array([[t.easting_m, t.northing_m, t.height_m] for t in data.targets])
    )[:, :2]
    frustum = np.array([t.kind == "frustum" for t in data.targets])
    # Targets stand inside the field with a margin: the place of each is judged against the targets' own extent, and that
    # extent against the field.
    centre = (world.max(axis=0) + world.min(axis=0)) / 2.0
    half = np.maximum((world.max(axis=0) - world.min(axis=0)) / 2.0, 1e-6)
    share = half / np.array(field)
    place = (world - centre) / half
    tested = place[frustum] if frustum.any() else place
    distances = {
        name: float(np.abs(tested - np.array(at)).max(axis=1).min())
        for name, at in {"centre": (0, 0), "NW": (-1, 1), "NE": (1, 1), "SW": (-1, -1), "SE": (1, -1)}.items()
    }
    size = f"targets span {2 * half[0]:.0f} m × {2 * half[1]:.0f} m of {2 * field[0]:.0f} m × {2 * field[1]:.0f} m"
    bare = [name for name, d in distances.items() if d > 0.35]
    wide = bool((share >= 0.6).all())
    text = f"{size}; " + (f"none at {', '.join(bare)}" if bare else "one at each of the five places")
    first = row("6.2.3 a", corners, text, f"{limit_corners}, over 60 % of the field", passed(not bare and wide))
    cells = np.clip(np.floor((place + 1.0) * 1.5), 0, 2).astype(int)
    counts = np.bincount(cells[:, 0] * 3 + cells[:, 1], minlength=9)
    text = f"{counts.min()} to {counts.max()} targets in each ninth, {(counts == 0).sum()} empty"
    return [first, row("6.2.3 a", cover, text, limit_cover, passed(bool((counts > 0).all())))]


def _seen_together(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    total = len(data.targets)
    requirement, limit = "one image shows every target", "one image a sortie"
    if not measured.targets_in_image or not total:
        rows = [missing("6.2.3 b", requirement, limit, "targets found in images")]
    else:
        best: dict[int, tuple[int, str]] = {}
        for (sortie, image), count in measured.targets_in_image.items():
            best[sortie] = max(best.get(sortie, (-1, "")), (count, image))
        text = "; ".join(f"sortie {s}: {n} of {total} ({image})" for s, (n, image) in sorted(best.items()))
        whole = [n >= total for n, _ in best.values()]
        rows = [row("6.2.3 b", requirement, text, limit, "pass" if all(whole) else "warning" if any(whole) else "fail")]
    requirement = "the LiDAR scans all targets within a short interval"
    short = data.rig.navigation.position_correlation_s if data.rig else _SHORT_S
    limit = f"“short”; here {short:.0f} s, over which navigation errors stay correlated"
    if not measured.scan_interval_s:
        return [*rows, missing("6.2.3 b", requirement, limit, "targets found in point clouds")]
    values = measured.scan_interval_s
    worst = max(values, key=values.__getitem__)
    text = f"{min(values.values()):.1f} s to {values[worst]:.1f} s a strip, {len(values)} strips"
    return [*rows, row("6.2.3 b", requirement, text, limit, "pass" if values[worst] <= short else "warning")]


def clause_6(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    """Rows of clause 6.2; the indoor conditions of 6.3 belong to the benches."""
    return [*_range(data), *_targets(data), *_layout(data), *_seen_together(data, measured)]
