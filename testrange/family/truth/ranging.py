"""True m_z, K2 and R2 of a ranging line: true distances, the LiDAR's range errors, (13)-(15) and (9)-(11) written anew."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import lstsq

from campaign.config import Config
from simulator.lidar.ranging import prepare_line
from simulator.lidar.strip import measured_range_m

Table = tuple[tuple[float, float], ...]
_FLAT_M = 0.15  # half length of the table's step about a panel
_LIDAR_STD_M = 1e-3  # a panel's range, all scans together
_WEIGHTS = 0.05  # relative spread of panels' weights: an evaluator may weigh them by what it finds of their scatter


@dataclass(frozen=True, kw_only=True)
class TrueRanging:
    """Of a line, and the standard uncertainty of one measurement."""

    m_z_percent: float
    m_z_std_percent: float
    additive_constant_m: float
    additive_constant_std_m: float
    multiplication_constant: float
    multiplication_constant_std: float
    mistakes: dict[str, float]  # of m_z


def table(distances_m: Sequence[float], error_m: float) -> Table:
    """A range error of +error, -error, -error, +error ... at the panels: free of what K2 and R2 absorb for equal steps.

    Eight panels (or four): signs whose sum, and sum times number, vanish.
    """
    distances = sorted(distances_m)
    signs = [1.0, -1.0, -1.0, 1.0] * (len(distances) // 4 + 1)
    rows = []
    for distance, sign in zip(distances, signs, strict=False):
        rows += [(round(distance - _FLAT_M, 6), sign * error_m), (round(distance + _FLAT_M, 6), sign * error_m)]
    return tuple(rows) if error_m else ()


def _constants(measured: np.ndarray, reference: np.ndarray, weight: np.ndarray) -> np.ndarray:
    design = np.stack([np.ones_like(measured), measured], axis=-1)
    return np.asarray(lstsq(design * weight[:, None], (reference - measured) * weight)[0])


def _relative(corrected: np.ndarray, reference: np.ndarray) -> float:
    return 100.0 * float(np.sqrt(np.mean((corrected - reference) ** 2)) / np.mean(reference))


class Ranging:
    """One line; asked many times with other tables of range errors."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._true = np.array([np.linalg.norm(panel.centre_m) for panel in prepare_line(config).setting.panels])

    def _measured(self, rows: Table) -> np.ndarray:
        return measured_range_m(self._true, self._config.faults.model_copy(update={"range_table": rows}))

    @cached_property
    def _noise_percent(self) -> float:
        """Root mean square of m_z of a LiDAR without any range error."""
        return float(np.sqrt(np.mean(self._replicates((), 400)[:, 0] ** 2)))

    def m_z_percent(self, rows: Table) -> float:
        """By unweighted least squares of (14), as the standard has it, with the noise of ranges and readings."""
        measured = self._measured(rows)
        k2, r2 = _constants(measured, self._true, np.ones_like(measured))
        return float(np.hypot(_relative(measured + k2 + r2 * measured, self._true), self._noise_percent))

    def _replicates(self, rows: Table, count: int) -> np.ndarray:
        """(count, 3) of m_z, K2, R2 with noise, and with panels weighed a little otherwise."""
        ranging, true, measured = self._config.ranging, self._true, self._measured(rows)
        rng = np.random.default_rng(np.random.SeedSequence([self._config.seed, 9151]))
        found = []
        for _ in range(count):
            shown = measured + _LIDAR_STD_M * rng.standard_normal(len(true))
            shown = shown + ranging.eccentricity_std_m * rng.standard_normal()
            readings = []
            for station in (ranging.correction_station, ranging.reference_station):
                std = (station.std_mm * 1e-3 + station.std_ppm * 1e-6 * true) / np.sqrt(ranging.observations)
                own_m = station.additive_constant_std_mm * 1e-3 * rng.standard_normal()
                scale = station.scale_std_ppm * 1e-6 * rng.standard_normal()
                readings.append(true + std * rng.standard_normal(len(true)) + own_m + scale * true)
            weight = np.exp(_WEIGHTS * rng.standard_normal(len(true)))
            k2, r2 = _constants(shown, readings[0], weight)
            found.append((_relative(shown + k2 + r2 * shown, readings[1]), k2, r2))
        return np.array(found)

    def truth(self, rows: Table, replicates: int) -> TrueRanging:
        """Everything, with its spread by replicates of noise."""
        measured, true = self._measured(rows), self._true
        k2, r2 = _constants(measured, true, np.ones_like(true))
        std = np.std(self._replicates(rows, replicates), axis=0, ddof=1)
        return TrueRanging(
            m_z_percent=self.m_z_percent(rows),
            m_z_std_percent=float(std[0]),
            additive_constant_m=float(k2),
            additive_constant_std_m=float(std[1]),
            multiplication_constant=float(r2),
            multiplication_constant_std=float(std[2]),
            mistakes={
                "not corrected by (15)": _relative(measured, true),
                "sign of K2 and R2 reversed": _relative(measured - k2 - r2 * measured, true),
            },
        )
