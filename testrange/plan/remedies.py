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
