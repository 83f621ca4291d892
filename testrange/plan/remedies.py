"""The way out of each failing clause, in the words of the configuration."""

from campaign.config import Config

_REMEDIES = {
    "5.4 b": "write campaign.start_time with +08:00",
    "5.5 a": "set camera.exposure_target or the panels' levels",
    "5.5 b": "fly lower or slower, add strips, or enlarge targets.panels.size_m",
    "6.2.1 b": "choose a flatter site",
    "6.2.1 c": "begin earlier or later: illuminance follows the sun's elevation",
    "6.2.2 b": "choose targets.panels.material with a flat spectrum",
    "6.2.2 c": "targets.frustums.long_edge_m at least 0.5 inverted, 0.849 upright",
    "6.2.2 f": "survey more accurately: targets.survey.horizontal_std_m, height_std_m",
    "6.2.3 a": "change the layout: targets, flight.heights_m, targets.layout_margin",
    "6.2.3 b": "fly higher, or add images (flight.images_per_strip)",
    "6.3.1": "set the room of the bench: bench.room, bench.sphere.traceability",
    "6.3.2": "set the room of the bench and its board: bench.room, bench.chessboard",
    "7.2 a": "choose another take-off point",
    "7.2 b": "choose a time with more satellites",
    "7.2 d": "wait for less wind",
    "7.3 a": "lower flight.speed_m_s",
    "7.3 c": "lower flight.speed_m_s or the platform's sway",
    "7.4 a": "lower flight.heights_m, or set flight.gsd_m to what they give",
    "7.4 b": "hold the height better: platform.track_std_m",
    "7.4 c": "hold the height better: platform.track_std_m",
    "8.1.2 a": "targets.panels.count_of_each = 4 of 5, 20, 40, 60 and 100 %",
    "8.3.2 a": "targets.panels.count_of_each = 4 of 5, 20, 40, 60 and 100 %",
    "8.2.2": "set bench.sphere.wait_s, images, stability_interval_s, repeatability_interval_s",
    "9.1.2": "set ranging.distances_m, ranging.observations and the total stations",
    "9.2.2": "set bench.chessboard.distances_m",
    "9.3.2 b": "fly two heights or use stands of different heights",
}

# The same in Chinese, by the English text; those with figures stand in `words`.
REMEDIES_ZH = {
    "write campaign.start_time with +08:00": "campaign.start_time 用 +08:00 书写",
    "set camera.exposure_target or the panels' levels": "调整 camera.exposure_target 或标准反射靶标反射率",
    "fly lower or slower, add strips, or enlarge targets.panels.size_m": (
        "降低航高或航速、增加航线，或加大 targets.panels.size_m"
    ),
    "choose a flatter site": "另选平坦场地",
    "begin earlier or later: illuminance follows the sun's elevation": "提前或推后开始：光照度随太阳高度角变化",
    "choose targets.panels.material with a flat spectrum": "选光谱平坦的 targets.panels.material",
    "targets.frustums.long_edge_m at least 0.5 inverted, 0.849 upright": (
        "targets.frustums.long_edge_m 倒置不小于 0.5，正置不小于 0.849"
    ),
    "survey more accurately: targets.survey.horizontal_std_m, height_std_m": (
        "提高控制测量精度：targets.survey.horizontal_std_m、height_std_m"
    ),
    "change the layout: targets, flight.heights_m, targets.layout_margin": (
        "调整布设：targets、flight.heights_m、targets.layout_margin"
    ),
    "fly higher, or add images (flight.images_per_strip)": "提高航高，或增加影像（flight.images_per_strip）",
    "set the room of the bench: bench.room, bench.sphere.traceability": (
        "调整室内条件：bench.room、bench.sphere.traceability"
    ),
    "set the room of the bench and its board: bench.room, bench.chessboard": (
        "调整室内条件与标定板：bench.room、bench.chessboard"
    ),
    "choose another take-off point": "另选起降点",
    "choose a time with more satellites": "选卫星更多的时段",
    "wait for less wind": "待风力减弱",
    "lower flight.speed_m_s": "降低 flight.speed_m_s",
    "lower flight.speed_m_s or the platform's sway": "降低 flight.speed_m_s 或平台晃动",
    "lower flight.heights_m, or set flight.gsd_m to what they give": (
        "降低 flight.heights_m，或使 flight.gsd_m 与之相符"
    ),
    "hold the height better: platform.track_std_m": "更好地保持航高：platform.track_std_m",
    "targets.panels.count_of_each = 4 of 5, 20, 40, 60 and 100 %": (
        "targets.panels.count_of_each 取 4，反射率 5、20、40、60、100 %"
    ),
    "set bench.sphere.wait_s, images, stability_interval_s, repeatability_interval_s": (
        "调整 bench.sphere.wait_s、images、stability_interval_s、repeatability_interval_s"
    ),
    "set ranging.distances_m, ranging.observations and the total stations": (
        "调整 ranging.distances_m、ranging.observations 与全站仪"
    ),
    "set bench.chessboard.distances_m": "调整 bench.chessboard.distances_m",
    "fly two heights or use stands of different heights": "飞两个航高，或用不同高度的支架",
    "shorten the flight, or split it over two days": "缩短飞行，或分两天进行",
    "choose another date: the sun never stands high enough for the whole flight": (
        "另选日期：当日太阳高度角不能满足整个飞行"
    ),
    "raise targets.frustums.count to 20 or more": "targets.frustums.count 增至 20 或以上",
    "raise flight.heights_m": "提高 flight.heights_m",
    "widen lidar.scanner.sector_deg, raise flight.heights_m or lidar.pulse_energy_uj": (
        "加大 lidar.scanner.sector_deg，提高 flight.heights_m 或 lidar.pulse_energy_uj"
    ),
    "raise lidar.pulse_energy_uj or lower flight.heights_m": "提高 lidar.pulse_energy_uj 或降低 flight.heights_m",
    "shorten ranging.distances_m or lower lidar.prr_hz": "缩短 ranging.distances_m 或降低 lidar.prr_hz",
    "shorten ranging.distances_m, enlarge ranging.panel_size_m, or leave ranging out of campaign.parts": (
        "缩短 ranging.distances_m、加大 ranging.panel_size_m，或从 campaign.parts 去掉 ranging"
    ),
}


def remedy(config: Config, clause: str, requirement: str, window: tuple[tuple[str, str], ...]) -> str:
    """What the user can do about a row that fails; empty where the row says it all."""
    if clause == "7.2 c":
        if requirement.startswith("change"):
            return "shorten the flight, or split it over two days"
        if not window:
            return "choose another date: the sun never stands high enough for the whole flight"
        spans = " or ".join(f"between {first} and {last}" for first, last in window)
        return f"begin {spans} Beijing time"
    if clause in ("9.3.2 a", "9.3.2 d"):
        b = config.targets.frustums.long_edge_m
        few = config.targets.frustums.count < 20
        if clause == "9.3.2 a" and few:
            return "raise targets.frustums.count to 20 or more"
        return (
            f"enlarge targets.frustums.long_edge_m ({b:g} m), fly lower or slower, or use a LiDAR with a narrower beam and "
            "a higher rate"
        )
    found = [text for key, text in _REMEDIES.items() if clause.startswith(key)]
    return found[0] if found else ""
