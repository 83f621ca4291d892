"""Rows that no clause asks for and without which a flight fails: ranges told apart, echoes and pixels in their scale."""

import numpy as np

from campaign.config import Config
from campaign.errors import ConfigError
from simulator.flight.plan import speeds_m_s
from simulator.lidar.radar_equation import unambiguous_range_m
from simulator.lidar.scanner import scanner_from
from testrange.plan.beams import Passes, amplitude_limits_dn
from testrange.plan.light import blur_px
from testrange.plan.model import AMBIGUITY, PHYSICS, PanelLight, PlanRow, PlanStatus
from testrange.plan.rehearsal import Rehearsal, flies

MOST_BLUR_PX = 1.0
WALL_M = 10.0  # behind the farthest panel of the ranging line, at most


def ground_slant_m(config: Config) -> float | None:
    """Longest way to the ground where no flight can be rehearsed: sector's edge, three standard deviations of roll, lowest place of
    the site; as far as 60 degrees off nadir. [m]"""
    if not flies(config) or "lidar" not in config.campaign.parts:
        return None
    edge = min(max(map(abs, config.lidar.scanner.sector_deg)) + 3.0 * config.platform.roll_std_deg, 60.0)
    return float((max(config.flight.heights_m) + _below_m(config)) / np.cos(np.radians(edge)))


def _below_m(config: Config) -> float:
    """Lowest ground under the site's origin, as `beams.longest_slant_m` takes it. [m]"""
    site = config.site
    return float(0.5 * site.extent_m * np.sqrt(2.0) * np.tan(np.radians(site.slope_deg)) + 3.0 * site.relief_m)


def physics_rows(
    config: Config, rehearsal: Rehearsal | None, passes: Passes | None, light: tuple[PanelLight, ...]
) -> tuple[PlanRow, ...]:
    """The rows; without a rehearsal (the configuration cannot be built) those that heights and rates decide."""
    rows = []
    if flies(config) and "lidar" in config.campaign.parts:
        rows += _ranges(config, passes)
    if passes is not None and rehearsal is not None:
        rows += _seen(rehearsal, passes)
        rows += _echoes(rehearsal, passes)
    if rehearsal is not None and rehearsal.exposing is not None:
        rows += _pictures(config, rehearsal, light)
    if "ranging" in config.campaign.parts:
        rows += _ranging(config)
    return tuple(rows)


def _row(clause: str, requirement: str, planned: str, limit: str, status: PlanStatus, remedy: str = "") -> PlanRow:
    return PlanRow(
        clause=clause,
        requirement=requirement,
        planned=planned,
        limit=limit,
        status=status,
        remedy=remedy if status == "fail" else "",
    )


def _ranges(config: Config, passes: Passes | None) -> list[PlanRow]:
    try:
        scanner = scanner_from(config.lidar)
    except ConfigError:
        return []  # the row of the configuration says it
    limit = unambiguous_range_m(scanner.pulse_interval_s)
    longest = passes.longest_range_m if passes is not None else ground_slant_m(config)
    assert longest is not None
    beams = max(len(config.lidar.scanner.channel_elevations_deg), 1)
    rate = 0.99 * config.lidar.prr_hz * limit / longest
    below = _below_m(config)
    height = (max(config.flight.heights_m) + below) * 0.99 * limit / longest - below
    rows = [
        _row(
            PHYSICS,
            AMBIGUITY,
            f"{longest:.1f} m",
            f"≤ {limit:.1f} m, c/(2·PRR)" + (f" with {beams} channels in turn" if beams > 1 else ""),
            "pass" if longest <= limit else "fail",
            f"fly at {height:.0f} m or lower, or lower lidar.prr_hz to {rate:.0f}",
        )
    ]
    lowest = min(config.flight.heights_m)
    rows.append(
        _row(
            PHYSICS,
            "lowest height within the LiDAR's range",
            f"{lowest:g} m",
            f"> {config.lidar.min_range_m:g} m, its shortest range",
            "pass" if lowest > config.lidar.min_range_m else "fail",
            "raise flight.heights_m",
        )
    )
    return rows


def _seen(rehearsal: Rehearsal, passes: Passes) -> list[PlanRow]:
    """Every target under the scanner's sector in every sortie."""
    targets = [t.id for t in rehearsal.data.targets if t.kind != "board"]
    if not targets:
        return []
    texts, whole = [], True
    for sortie in rehearsal.sorties:
        seen = {name for number, _, name in passes.returns if number == sortie.number}
        missed = [name for name in targets if name not in seen]
        whole &= not missed
        texts.append(f"sortie {sortie.number}: {len(targets) - len(missed)} of {len(targets)}")
        if missed:
            texts[-1] += f" (not {', '.join(missed[:3])}{' …' if len(missed) > 3 else ''})"
    low, high = rehearsal.config.lidar.scanner.sector_deg
    return [
        _row(
            "6.2.3 a",
            f"LiDAR's sector ({low:g}° to {high:g}°) passes over every target and echoes return",
            "; ".join(texts),
            "every target in every sortie",
            "pass" if whole else "fail",
            "widen lidar.scanner.sector_deg, raise flight.heights_m or lidar.pulse_energy_uj",
        )
    ]


def _echoes(rehearsal: Rehearsal, passes: Passes) -> list[PlanRow]:
    if not passes.amplitude_dn:
        return []
    threshold, last = amplitude_limits_dn(rehearsal)
    weak = min(passes.amplitude_dn, key=lambda p: passes.amplitude_dn[p][0])
    strong = max(passes.amplitude_dn, key=lambda p: passes.amplitude_dn[p][1])
    low, high = passes.amplitude_dn[weak][0], passes.amplitude_dn[strong][1]
    status: PlanStatus = "fail" if low <= threshold else "warning" if high >= 0.95 * last else "pass"
    return [
        _row(
            PHYSICS,
            "echoes of the panels between detection threshold and saturation",
            f"{low:.0f} DN ({weak}) to {high:.0f} DN ({strong})",
            f"{threshold:.0f} to {last:.0f} DN",
            status,
            "raise lidar.pulse_energy_uj or lower flight.heights_m",
        )
    ]


def _pictures(config: Config, rehearsal: Rehearsal, light: tuple[PanelLight, ...]) -> list[PlanRow]:
    assert rehearsal.exposing is not None
    seconds = rehearsal.exposing.exposure_time_s
    blurs = [
        (blur_px(config, height, speed, seconds), height)
        for height, speed in zip(config.flight.heights_m, speeds_m_s(config), strict=True)
    ]
    worst, height = max(blurs)
    rows = [
        _row(
            PHYSICS,
            "motion blur of the images",
            f"{worst:.2f} px at {height:g} m, exposure 1/{1.0 / seconds:.0f} s",
            f"≤ {MOST_BLUR_PX:g} px",
            "pass" if worst <= MOST_BLUR_PX else "warning",
        )
    ]
    if light:
        brightest = max(light, key=lambda p: max(p.dn))
        share = max(brightest.dn) / brightest.full_scale_dn
        rows.append(
            _row(
                PHYSICS,
                "no panel saturates the camera",
                f"{100.0 * share:.0f} % of full scale ({brightest.panel})",
                "< 100 %",
                "pass" if share < 1.0 else "warning",
            )
        )
    return rows


def _ranging(config: Config) -> list[PlanRow]:
    """What the ranging line is refused for when it is simulated."""
    try:
        limit = unambiguous_range_m(scanner_from(config.lidar).pulse_interval_s)
    except ConfigError:
        return []
    far = max(config.ranging.distances_m)
    spot, size = config.lidar.divergence_rad * far, config.ranging.panel_size_m
    return [
        _row(
            PHYSICS,
            "farthest panel of the ranging line (9.1.2 a) within the unambiguous range",
            f"{far:g} m",
            f"≤ {limit:.1f} m, c/(2·PRR)",
            "pass" if far + WALL_M <= limit else "fail",
            "shorten ranging.distances_m or lower lidar.prr_hz",
        ),
        _row(
            PHYSICS,
            "footprint on the farthest panel of the ranging line (9.1.2 a)",
            f"{spot:.2f} m at {far:g} m",
            f"≤ {0.5 * size:.2f} m, half the panel",
            "pass" if spot <= 0.5 * size else "fail",
            "shorten ranging.distances_m, enlarge ranging.panel_size_m, or leave ranging out of campaign.parts",
        ),
    ]
