"""Tables of what was measured with and what was tested: table C.2 and the sensors' own sheets, as the campaign states them."""

from evaluator.documents.model import Cell, Language, Table, say
from evaluator.documents.phrases import not_stated, translated
from evaluator.model import CampaignData
from evaluator.results import Evaluation

_NAMES = {  # keys of plan.json's instruments that are no row of table 2
    "field_spectrometer": ("地物光谱仪", "Field spectrometer"),
    "lux_meter": ("照度计", "Lux meter"),
    "anemometer": ("风速仪", "Anemometer"),
}
_MATERIALS = (("ptfe", "PTFE"), ("barium_sulfate", "barium sulfate"), ("water_based_paint", "water-based paint"))


def _stated(data: CampaignData | None, language: Language) -> dict[str, str]:
    """What the campaign says of the instruments of table 2, by their key in plan.json."""
    if data is None:
        return {}
    stated = {k: translated(_named(v), language) for k, v in data.plan.instruments.items()} if data.plan else {}
    if data.bench.room is not None and data.bench.room.sphere_traceability:
        stated["integrating_sphere"] = translated(data.bench.room.sphere_traceability, language)
    if data.ranging.line is not None:
        stations = []
        for s in data.ranging.line.stations:
            name = f"{s.name} {s.model}".strip()
            stations.append(
                say(
                    language,
                    f"{name}：{s.class_mm:g} mm 级，K₁ = {1000 * s.additive_constant_m:.2f} mm，R₁ = {1e6 * s.scale:.2f} ppm",
                    f"{name}: {s.class_mm:g} mm class, K₁ = {1000 * s.additive_constant_m:.2f} mm, R₁ = {1e6 * s.scale:.2f} ppm",
                ).replace("-", "−" if "-" not in name else "-")
            )
        stated["total_station"] = "\n".join(stations)
    return stated


def _named(text: str) -> str:
    """A text in which a material stands by its name, not by the word of a configuration."""
    for code, name in _MATERIALS:
        text = text.replace(code, name)
    return text


def instrument_table(evaluation: Evaluation, language: Language) -> Table:
    """Table C.2: what table 2 asks for, and what this campaign used."""
    stated = _stated(evaluation.data, language)
    asked = (
        ("integrating_sphere", "积分球", "不低于三级溯源", "Integrating sphere", "traceable, third class or better"),
        (
            "reference_panels",
            "漫反射参考标准板",
            "光谱平坦性优于 5 %；制作材料为硫酸钡、聚四氟乙烯或水基乙烷",
            "Diffuse reference panels",
            "spectral flatness better than 5 %; barium sulfate, PTFE or water-based paint",
        ),
        (
            "geometric_targets",
            "几何一致性检测靶标",
            "控制测量水平精度优于 1 cm，高程精度优于 2 cm",
            "Targets of geometric consistency",
            "control survey better than 1 cm horizontally, 2 cm in height",
        ),
        ("total_station", "全站仪", "10 mm 级仪器、5 mm 级仪器", "Total station", "10 mm class, 5 mm class"),
    )
    rows: list[tuple[Cell, ...]] = [
        (say(language, zh, en), say(language, limit_zh, limit_en), stated.pop(key, "") or not_stated(language))
        for key, zh, limit_zh, en, limit_en in asked
    ]
    for key, text in sorted(stated.items()):
        names = _NAMES.get(key, (key.replace("_", " ").capitalize(), key.replace("_", " ").capitalize()))
        rows.append((names[0 if language == "zh" else 1], "–", text))
    return Table(
        caption=say(language, "表 C.2　主要检测仪器及性能参数", "Table C.2  Instruments and their performance"),
        head=say(
            language, "检测仪器名称|技术要求（表 2）|本次检测所用", "Instrument|Asked for (table 2)|In this test"
        ).split("|"),
        rows=rows,
        widths=(1.7, 2.7, 3.6),
    )


def system_table(evaluation: Evaluation, language: Language) -> Table:
    """The system under test, as its sheets state it."""
    data = evaluation.data
    rows: list[tuple[str, str]] = []
    if data is not None and data.rig is not None:
        kind = {"multirotor": ("多旋翼", "multirotor"), "fixed_wing": ("固定翼", "fixed wing")}[data.rig.kind]
        rows.append(
            (
                say(language, "平台", "Platform"),
                say(language, f"{data.rig.platform}（{kind[0]}）", f"{data.rig.platform} ({kind[1]})"),
            )
        )
        rows.append((say(language, "定位定姿系统", "Navigation"), data.rig.navigation.grade))
    if data is not None and data.lidar is not None:
        s = data.lidar
        rows.append((say(language, "激光雷达", "LiDAR"), f"{s.name} {_maker(s.manufacturer, language)}".strip()))
        rows.append(
            (
                say(language, "激光雷达参数", "LiDAR's figures"),
                say(
                    language,
                    f"波长 {s.wavelength_nm:g} nm，脉冲重复频率 {s.prr_hz / 1000:g} kHz，"
                    f"光束发散角 {1000 * s.divergence_rad:g} mrad，"
                    f"精度 {1000 * s.precision_m:g} mm，准确度 {1000 * s.accuracy_m:g} mm",
                    f"wavelength {s.wavelength_nm:g} nm, pulse repetition rate {s.prr_hz / 1000:g} kHz, divergence "
                    f"{1000 * s.divergence_rad:g} mrad, precision {1000 * s.precision_m:g} mm, accuracy {1000 * s.accuracy_m:g} mm",
                ),
            )
        )
    if data is not None and data.camera is not None:
        c = data.camera
        rows.append((say(language, "光学遥感传感器", "Camera"), f"{c.name} {_maker(c.manufacturer, language)}".strip()))
        bands = say(language, "、", ", ").join(f"{b.name} {b.centre_nm:g} nm" for b in c.bands)
        rows.append(
            (
                say(language, "传感器参数", "Camera's figures"),
                say(
                    language,
                    f"{c.width_px} × {c.height_px} px，像元尺寸 {c.pixel_size_um:g} μm，"
                    f"标称焦距 {c.nominal_focal_length_mm:g} mm，波段 {bands}",
                    f"{c.width_px} × {c.height_px} pixels of {c.pixel_size_um:g} μm, "
                    f"nominal focal length {c.nominal_focal_length_mm:g} mm, bands {bands}",
                ),
            )
        )
        calibration = c.calibration
        rows.append(
            (
                say(language, "内方位元素来源", "Interior orientation by"),
                f"{translated(calibration.certificate, language)}  {calibration.date}"
                if calibration
                else not_stated(language),
            )
        )
    if not rows:
        rows.append((say(language, "被检系统", "System under test"), not_stated(language)))
    return Table(
        caption=say(language, "附表 #　被检系统", "Table #  System under test"),
        rows=rows,
        widths=(1.9, 6.1),
        fields=True,
    )


def _maker(name: str, language: Language) -> str:
    return say(language, f"（{name}）", f"({name})") if name else ""
