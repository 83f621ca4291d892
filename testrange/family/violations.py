"""Members with one clause violated: which setting or record does it, and which rows of conformity must say so."""

from dataclasses import dataclass

from testrange.family.model import Expected, Group, Member

PARTS: dict[Group, tuple[str, ...]] = {
    "sphere": ("sphere",),
    "chessboard": ("chessboard",),
    "ranging": ("ranging",),
    "radiometry": ("camera", "lidar"),
    "geometry": ("camera", "lidar"),
    "records": ("camera",),
}
# 9.1.2 h is no clause of the standard but a test that an evaluator may make of the residuals of (14).
MAY_FAIL: dict[Group, tuple[str, ...]] = {"ranging": ("9.1.2 h",)}


@dataclass(frozen=True, kw_only=True)
class Violation:
    """One clause, and what violates it."""

    name: str
    clause: str
    group: Group
    what: str
    set: tuple[str, ...] = ()
    edit: str | None = None
    same: tuple[str, ...] = ()  # clauses whose row is the same fact once more
    status: str = "fail"
    parts: tuple[str, ...] | None = None


def _v(
    name: str,
    clause: str,
    group: Group,
    what: str,
    *settings: str,
    edit: str | None = None,
    same: tuple[str, ...] = (),
    status: str = "fail",
    parts: tuple[str, ...] | None = None,
) -> Violation:
    return Violation(
        name=name, clause=clause, group=group, what=what, set=settings, edit=edit, same=same, status=status, parts=parts
    )


def _level(missing: int) -> Violation:
    levels = (5, 20, 40, 60, 100)
    others = [str(float(level)) for level in levels if level != missing]
    return _v(
        f"panels_{missing}_percent",
        "8.1.2 a",
        "records",
        f"no panel of {missing} %, four of 30 % in their place",
        f"targets.panels.nominal_reflectance_percent=[{', '.join([*others, '30.0'])}]",
        same=("8.3.2 a",),
    )


def _room(prefix: str, group: Group) -> tuple[Violation, ...]:
    rows = (
        ("dust", "a", "the room is not free of dust", "dust"),
        ("stray_light", "b", "more than one light source", "stray light"),
        ("temperature", "c", "27 °C in the room", "warm room"),
        ("humidity", "d", "82 % relative humidity in the room", "damp room"),
        ("pressure", "e", "78 kPa in the room", "thin air"),
    )
    return tuple(_v(f"{group}_{n}", f"{prefix} {letter}", group, what, edit=edit) for n, letter, what, edit in rows)


VIOLATIONS: tuple[Violation, ...] = (
    _v("instruments_total_station", "9.1.2 c", "ranging", "a total station of 20 mm class for slope distances",
       'ranging.correction_station={name="station_A", class_mm=20.0, std_mm=2.0, std_ppm=2.0, additive_constant_mm=-1.4, '
       "scale_ppm=3.0}", same=("5.3",)),
    _v("reference_station", "9.1.2 k", "ranging", "a total station of 8 mm class for the relative true values",
       'ranging.reference_station={name="station_B", class_mm=8.0, std_mm=1.0, std_ppm=1.5, additive_constant_mm=0.6, '
       "scale_ppm=-1.0}", same=("5.3",)),
    _v("datum_plane", "5.4 a", "records", "coordinates in UTM on WGS 84", "site.projection_epsg=32651", status="warning"),
    _v("datum_time", "5.4 b", "records", "times in UTC", edit="time zone"),
    _v("brightness", "5.5 a", "radiometry", "images exposed for a fifth of full scale",
       "camera.exposure_target=0.12", parts=("camera",)),
    _v("points", "5.5 b", "radiometry", "a pulse rate that leaves fewer than 100 points on a panel",
       "lidar.prr_hz=16000.0", "lidar.scanner.scan_rate_hz=20.0", parts=("lidar",)),
    _v("slope", "6.2.1 b", "records", "a slope of 12°", "site.slope_deg=12.0"),
    _v("illuminance", "6.2.1 c", "records", "noon of a clear June day, above 100 klx",
       'campaign.start_time="2026-06-12T11:30:00+08:00"'),
    _v("panel_material", "6.2.2 a", "records", "a panel of a material that nobody states", edit="material"),
    _v("flatness", "6.2.2 b", "records", "a panel whose spectrum rises within a band", edit="flatness", same=("5.3",)),
    _v("frustum_size", "6.2.2 c", "records", "frustums of 40 cm", "targets.frustums.long_edge_m=0.4",
       "targets.frustums.mark_radius_m=0.08"),
    _v("frustum_angles", "6.2.2 d", "records", "a frustum whose vertex lies 3 cm above its mark", edit="angles"),
    _v("coating", "6.2.2 e", "records", "a frustum of a coating that nobody states", edit="coating", same=("6.2.2 g",)),
    _v("survey_accuracy", "6.2.2 f", "records", "a survey of 1.2 cm an axis", "targets.survey.horizontal_std_m=0.012",
       same=("5.3",)),
    _v("corner", "6.2.3 a", "records", "no target at the north-east corner", edit="no corner"),
    _v("cover", "6.2.3 a", "records", "a ninth of the field without a target", edit="empty ninth",
       same=("8.1.2 a", "8.3.2 a")),  # the panels that stood there are missing
    _v("one_image", "6.2.3 b", "records", "a camera that looks 14° to the side: no image shows all targets",
       "platform.camera.boresight_deg=[14.0, 0.0, 0.0]"),
    _v("obstacles", "7.2 a", "records", "obstacles of 25° at the take-off point", "environment.obstacle_angle_deg=25.0"),
    _v("lock", "7.2 a", "records", "GNSS lost lock", edit="lock lost"),
    _v("satellites", "7.2 b", "records", "8 satellites in view", "environment.satellites=8"),
    _v("static_check", "7.2 b", "records", "position at rest not assessed before take-off", edit="no static check"),
    _v("sun", "7.2 c", "records", "flown at 15:30: the sun below 35°",
       'campaign.start_time="2026-09-25T15:30:00+08:00"'),
    _v("sun_change", "7.2 c", "records", "eleven sorties of a morning: the sun climbs by more than 20°",
       'campaign.start_time="2026-05-05T08:00:00+08:00"', "environment.aerosol_optical_depth_500nm=0.8",
       "flight.heights_m=[30.0, 31.0, 32.0, 33.0, 34.0, 35.0, 36.0, 37.0, 38.0, 39.0, 40.0, 41.0]"),
    _v("wind", "7.2 d", "records", "12 m/s of wind", "environment.wind_speed_m_s=12.0"),
    _v("speed", "7.3 a", "records", "17 m/s with a multirotor", "flight.speed_m_s=17.0"),
    _v("ceiling", "7.4 a", "records", "a second sortie at 1020 m", "flight.heights_m=[30.0, 1020.0]"),
    _v("resolution", "7.4 a", "records", "a plan whose resolution does not belong to its height", edit="resolution"),
    _v("height", "7.4 b", "records", "6 % above the design height", edit="six percent off"),
    _v("height_metres", "7.4 c", "records", "6 m above a design height of 194 m", "flight.heights_m=[30.0, 200.0]",
       edit="six metres off"),
    *(_level(level) for level in (5, 20, 40, 60, 100)),
    _v("frustums", "9.3.2 a", "records", "19 frustums", "targets.frustums.count=19"),
    _v("depth", "9.3.2 b", "records", "all targets at one height, one flight height", "flight.heights_m=[30.0]",
       "targets.frustums.stand_heights_m=[0.2]", "site.slope_deg=0.0", "site.relief_m=0.0"),
    *_room("6.3.1", "sphere"),
    _v("sphere_class", "6.3.1 f", "sphere", "a sphere of the fourth class", edit="fourth class", same=("5.3",)),
    _v("warm_up", "8.2.2.1 c", "sphere", "10 min of warm-up", "bench.sphere.wait_s=600.0"),
    _v("warm_up_again", "8.2.2.2 c", "sphere", "10 min of warm-up before the second series", edit="late lamp"),
    _v("exposure_changed", "8.2.2.1 d", "sphere", "another exposure time for the last image", edit="other exposure"),
    _v("sphere_interval", "8.2.2.1 f", "sphere", "an image every 2.5 min", "bench.sphere.stability_interval_s=150.0"),
    _v("sphere_short_interval", "8.2.2.2 f", "sphere", "an image every 12 s",
       "bench.sphere.repeatability_interval_s=12.0"),
    _v("sphere_images", "8.2.2.1 f", "sphere", "15 images in each series", "bench.sphere.images=15",
       same=("8.2.2.2 f",)),
    *_room("6.3.2", "chessboard"),
    _v("board_size", "6.3.2 g", "chessboard", "a chessboard of 24 cm × 18 cm", "bench.chessboard.square_m=0.0127",
       "bench.chessboard.margin_m=0.0065", "bench.chessboard.distances_m=[0.35, 0.44, 0.54, 0.65]",
       "bench.chessboard.focus_distance_m=0.48", "bench.chessboard.f_number=22.0"),
    _v("board_images", "9.2.2", "chessboard", "19 images of the chessboard", edit="19 images", same=("6.3.2 h",)),
    _v("board_distances", "9.2.2 d", "chessboard", "three distances", "bench.chessboard.distances_m=[1.6, 2.1, 2.7]"),
    _v("board_cover", "9.2.2 d", "chessboard", "a corner of the field without the board", edit="uncovered"),
    _v("board_angles", "9.2.2 c", "chessboard", "boards turned by 3° at most", "bench.chessboard.tilt_deg=3.0"),
    _v("board_focus", "9.2.2 b", "chessboard", "the lens refocused for the last image", edit="refocused"),
    _v("ranging_panels", "9.1.2 a", "ranging", "four panels", "ranging.distances_m=[4.0, 6.8, 9.6, 12.4]"),
    _v("ranging_scans", "9.1.2 f", "ranging", "four scans", "ranging.scans=4"),
    _v("correction_readings", "9.1.2 c", "ranging", "four slope distances of one panel",
       edit="fewer correction readings"),
    _v("reference_readings", "9.1.2 k", "ranging", "four relative true values of one panel",
       edit="fewer reference readings"),
    _v("ranging_air", "9.1.2 e", "ranging", "a reading without temperature and pressure", edit="no air"),
)  # fmt: skip


def violation_members(names: tuple[str, ...] | None) -> list[Member]:
    """Members of the violations of these names, all where None."""
    chosen = [v for v in VIOLATIONS if names is None or v.name in names]
    return [
        Member(
            name=f"violated.{v.name}",
            group=v.group,
            parts=v.parts or PARTS[v.group],
            purpose=f"{v.clause} violated: {v.what}",
            settings=v.set,
            edit=v.edit,
            expected=Expected(
                member=f"violated.{v.name}",
                clauses={v.clause: (v.status,)},
                may_fail=(*v.same, *MAY_FAIL.get(v.group, ())),
            ),
        )
        for v in chosen
    ]
