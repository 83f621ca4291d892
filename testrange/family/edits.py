"""Changes of a campaign's records that no setting of the simulator makes: what a careless person wrote down, or left out.

Each takes the folder before its manifest is written. Files are replaced, never written into: other members share them.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from campaign.benches.bench import (
    read_board_log,
    read_room,
    read_sphere_log,
    write_board_log,
    write_room,
    write_sphere_log,
)
from campaign.benches.ranging import read_readings, readings_path, write_readings
from campaign.flight.records import FlightPlan, read_plan, write_plan
from campaign.folder import CampaignFolder
from campaign.manifest import read_manifest, write_manifest
from campaign.survey import SurveyedTarget, read_spectra, read_targets, write_spectra, write_targets

Edit = Callable[[CampaignFolder], None]


def _plan(change: Callable[[FlightPlan], dict[str, Any]]) -> Edit:
    def edit(place: CampaignFolder) -> None:
        plan = read_plan(place.plan)
        write_plan(place.plan, plan.model_copy(update=change(plan)))

    return edit


def _design_height(share: float, metres: float) -> Edit:
    """The second sortie flew off its design height, which the plan states."""

    def change(plan: FlightPlan) -> dict[str, Any]:
        strips = tuple(
            s.model_copy(update={"height_m": s.height_m * (1.0 + share) + metres}) if s.sortie == 2 else s
            for s in plan.strips
        )
        return {"strips": strips}

    return _plan(change)


def _targets(change: Callable[[list[SurveyedTarget]], list[SurveyedTarget]]) -> Edit:
    def edit(place: CampaignFolder) -> None:
        manifest = read_manifest(place.root)
        rows = change(read_targets(place.targets))
        write_targets(place.targets, rows, manifest.projection_epsg, manifest.height_epsg)

    return edit


def _first(kind: str, **values: Any) -> Callable[[list[SurveyedTarget]], list[SurveyedTarget]]:
    """The first target of a kind with other values."""

    def change(rows: list[SurveyedTarget]) -> list[SurveyedTarget]:
        index = next(i for i, row in enumerate(rows) if row.kind == kind)
        return [*rows[:index], replace(rows[index], **values), *rows[index + 1 :]]

    return change


def _without_corner(rows: list[SurveyedTarget]) -> list[SurveyedTarget]:
    """The frustum of the north-east corner was never set up; another keeps their number, in the middle."""
    frustums = [r for r in rows if r.kind == "frustum"]
    corner = max(frustums, key=lambda r: r.easting_m + r.northing_m)
    return [r for r in rows if r.id != corner.id]


def _without_ninth(rows: list[SurveyedTarget]) -> list[SurveyedTarget]:
    """No target in the middle of the field's northern edge."""
    place = np.array([[r.easting_m, r.northing_m] for r in rows])
    low, high = place.min(axis=0), place.max(axis=0)
    cell = np.clip(np.floor(3.0 * (place - low) / (high - low)), 0, 2)
    return [r for r, c in zip(rows, cell, strict=True) if tuple(c) != (1.0, 2.0)]


def _flatness(place: CampaignFolder) -> None:
    """One panel whose spectrum rises by a twelfth within the camera's first band."""
    spectra = read_spectra(place.spectra)
    values = spectra.reflectance.copy()
    values[:, 0] *= 1.0 + 0.08 * np.clip((spectra.wavelength_nm - 590.0) / 60.0, 0.0, 1.0)
    write_spectra(place.spectra, replace(spectra, reflectance=np.round(values, 6)))


def _time_zone(place: CampaignFolder) -> None:
    manifest = read_manifest(place.root)
    stamp = manifest.start_time
    write_manifest(place.root, manifest.model_copy(update={"start_time": f"{stamp[:11]}02{stamp[13:19]}+00:00"}))


def _room(**values: Any) -> Edit:
    def edit(place: CampaignFolder) -> None:
        write_room(place.room, read_room(place.room).model_copy(update=values))

    return edit


def _late_lamp(place: CampaignFolder) -> None:
    """The lamp was switched off after the first series, and on again ten minutes before the second."""
    path = place.sphere_repeatability / "log.csv"
    rows = read_sphere_log(path)
    first = rows[0].since_lamp_on_s or 0.0
    write_sphere_log(path, [replace(r, since_lamp_on_s=(r.since_lamp_on_s or 0.0) - first + 600.0) for r in rows])


def _other_exposure(place: CampaignFolder) -> None:
    path = place.sphere_stability / "log.csv"
    rows = read_sphere_log(path)
    write_sphere_log(path, [*rows[:-1], replace(rows[-1], exposure_time_s=1.1 * (rows[-1].exposure_time_s or 0.01))])


def _refocused(place: CampaignFolder) -> None:
    path = place.chessboard / "log.csv"
    rows = read_board_log(path)
    write_board_log(path, [*rows[:-1], replace(rows[-1], focus_distance_m=1.2 * (rows[-1].focus_distance_m or 1.0))])


def _few_images(place: CampaignFolder) -> None:
    """The last images, turned ones near the middle, were never taken: 19 are left."""
    path = place.chessboard / "log.csv"
    rows = read_board_log(path)
    _keep_images(place, [r.image for r in rows[:19]])


def _uncovered(place: CampaignFolder) -> None:
    """The first image, in a corner of the field at the shortest distance, was never taken."""
    rows = read_board_log(place.chessboard / "log.csv")
    _keep_images(place, [r.image for r in rows[1:]])


def _keep_images(place: CampaignFolder, kept: list[str]) -> None:
    path = place.chessboard / "log.csv"
    rows = read_board_log(path)
    write_board_log(path, [r for r in rows if r.image in kept])
    for row in rows:
        if row.image not in kept:
            (place.chessboard / row.image).unlink()
            (place.chessboard / row.image).with_suffix(".jpg").unlink(missing_ok=True)


def _fewer_readings(station: int) -> Edit:
    """The last reading of one panel by one of the two stations was never taken."""

    def edit(place: CampaignFolder) -> None:
        path = readings_path(place)
        rows = read_readings(path)
        names = list(dict.fromkeys(r.station for r in rows))
        of = [r for r in rows if r.station == names[station]]
        write_readings(path, [r for r in rows if r != of[-1]])

    return edit


def _no_air(place: CampaignFolder) -> None:
    path = readings_path(place)
    rows = read_readings(path)
    # a station with six readings of that panel would not even need it
    spare = replace(rows[0], temperature_c=None, pressure_hpa=None, relative_humidity_percent=None, observation=6)
    write_readings(path, [*rows, spare])


EDITS: dict[str, Edit] = {
    "lock lost": _plan(lambda plan: {"lock_lost": True}),
    "no static check": _plan(lambda plan: {"static_check_s": 0.0}),
    "resolution": _plan(lambda plan: {"gsd_m": 1.2 * plan.gsd_m}),
    "six percent off": _design_height(-0.057, 0.0),
    "six metres off": _design_height(0.0, -6.0),
    "material": _targets(_first("panel", material="")),
    "coating": _targets(_first("frustum", material="")),
    "angles": _targets(_first("frustum", vertex_offset_m=0.03)),
    "no corner": _targets(_without_corner),
    "empty ninth": _targets(_without_ninth),
    "flatness": _flatness,
    "time zone": _time_zone,
    "dust": _room(dust_free=False),
    "stray light": _room(single_light_source=False),
    "warm room": _room(temperature_c=27.0),
    "damp room": _room(relative_humidity_percent=82.0),
    "thin air": _room(pressure_hpa=780.0),
    "fourth class": _room(sphere_traceability="fourth class, certificate of the maker"),
    "late lamp": _late_lamp,
    "other exposure": _other_exposure,
    "refocused": _refocused,
    "19 images": _few_images,
    "uncovered": _uncovered,
    "fewer correction readings": _fewer_readings(0),
    "fewer reference readings": _fewer_readings(1),
    "no air": _no_air,
}


def edit_records(name: str, root: Path) -> None:
    """One of EDITS, on a campaign folder."""
    EDITS[name](CampaignFolder(root))
