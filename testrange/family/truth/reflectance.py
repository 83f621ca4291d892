"""True m_f, r_f and M_f of a flight: each panel's noise-free amplitude and range, the surface f(A, L, R) and the empirical line
written anew, then (2), (7), (8).

The amplitude is that of an extended target: reflectance at the laser's line, cosine of incidence, air, 1/R^2, over a grid on the
panel from where the scan plane sweeps it.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import lstsq

from campaign.config import Config
from scenes.build import build_scene
from scenes.model import Scene, Target
from scenes.spectra import band_reflectance, reflectance_at
from simulator import paperwork
from simulator.faults import with_panel_gains
from simulator.flight import rig
from simulator.flight.motion import Strip
from simulator.flight.plan import Sortie, fly
from simulator.lidar.radar_equation import extinction_per_km
from simulator.randomness import scene_seed

_GRID = 5  # points across a panel
_INSIDE = 0.7  # of its size
_AMPLITUDE_STD = 0.002  # relative: mean of a panel's pulses, and what the model leaves out (waveform, tilt, edges)
_DN_STD = 0.004  # relative: mean of a panel's pixels, and how differently neighbours shade the sky


@dataclass(frozen=True, kw_only=True)
class Reflectances:
    """The three indicators. [%]"""

    m_f: float
    r_f: float
    relative: float  # M_f
    panels: int


class Radiometry:
    """The panels of one configuration; asked many times with other gains at the laser's line."""

    def __init__(self, config: Config) -> None:
        self._config = config
        fixed = config.model_copy(update={"seed": scene_seed(config)})
        self._scene: Scene = build_scene(fixed)
        self._sorties: tuple[Sortie, ...] = fly(fixed, self._scene.layout)
        self.panels: tuple[Target, ...] = tuple(t for t in self._scene.targets if t.spectrum is not None)

    @cached_property
    def _geometry(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Panel, height, range [m] and geometric factor of every panel in every strip."""
        lidar = self._config.lidar
        beta = extinction_per_km(lidar.wavelength_nm * 1e-3, self._config.environment.visibility_km) * 1e-3
        rows: list[tuple[int, float, float, float]] = []
        for sortie in self._sorties:
            for strip in sortie.strips:
                for index, panel in enumerate(self.panels):
                    seen = self._seen(sortie, strip, panel)
                    if seen is not None:
                        range_m, cosine = seen
                        factor = cosine * np.exp(-2.0 * beta * range_m) / range_m**2
                        rows.append((index, strip.height_m, float(range_m.mean()), float(factor.mean())))
        panel, height, range_mean, factor_mean = np.array(rows).T
        return panel.astype(int), height, range_mean, factor_mean

    def _seen(self, sortie: Sortie, strip: Strip, panel: Target) -> tuple[np.ndarray, np.ndarray] | None:
        """Range and cosine of incidence over the panel's grid, at the instants when the scan plane meets its points."""
        mounting = rig.true_lidar(self._config)
        time = np.arange(strip.start_s, strip.end_s, 0.02)
        rotation = sortie.motion.world_from_body(time)
        origin = sortie.motion.position(time) + rotation @ mounting.lever_arm_m
        axes = rotation @ mounting.rotation  # lidar axes in the world
        step = np.linspace(-0.5, 0.5, _GRID) * _INSIDE * panel.size_m
        turn = np.radians(panel.azimuth_deg)
        x, y = (c.ravel() for c in np.meshgrid(step, step))
        offset = np.stack([x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn), 0 * x], axis=-1)
        ranges, cosines = [], []
        low, high = self._config.lidar.scanner.sector_deg
        for point in panel.mark_m + offset:
            sight = point - origin
            ahead = np.einsum("ni,ni->n", sight, axes[:, :, 0])
            at = np.flatnonzero((ahead[:-1] > 0) & (ahead[1:] <= 0))
            if len(at) == 0:
                return None
            k = int(at[0])
            share = ahead[k] / (ahead[k] - ahead[k + 1])
            beam = sight[k] + share * (sight[k + 1] - sight[k])
            across, down = beam @ axes[k, :, 1], beam @ axes[k, :, 2]
            if not low < np.degrees(np.arctan2(across, down)) < high:
                return None
            ranges.append(float(np.linalg.norm(beam)))
            cosines.append(-beam[2] / ranges[-1])
        return np.array(ranges), np.array(cosines)

    @cached_property
    def _read(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """By the spectrometer at the laser's line and over the band, and truly over the band. [%]"""
        config = self._config
        spectra = paperwork.measured_spectra(config, self._scene)
        band = next((b for b in config.camera.bands if b.name == "red"), config.camera.bands[0])
        line, over_band, truly = [], [], []
        for panel in self.panels:
            assert panel.spectrum is not None
            column = spectra.reflectance[:, spectra.panel_ids.index(panel.id)]
            measured = replace(panel.spectrum, wavelength_nm=spectra.wavelength_nm, reflectance=column)
            line.append(reflectance_at(measured, config.lidar.wavelength_nm))
            over_band.append(band_reflectance(measured, band.centre_nm, band.fwhm_nm))
            truly.append(band_reflectance(panel.spectrum, band.centre_nm, band.fwhm_nm))
        a, b, c = 100.0 * np.array([line, over_band, truly])
        return a, b, c

    def _laser(self, gains: dict[str, float]) -> np.ndarray:
        """True reflectance at the laser's line. [%]"""
        faults = self._config.faults.model_copy(update={"panel_laser_gain": tuple(gains.items())})
        scene = with_panel_gains(self._config.model_copy(update={"faults": faults}), self._scene)
        nm = self._config.lidar.wavelength_nm
        spectra = {t.id: t.spectrum for t in scene.targets}
        return 100.0 * np.array([reflectance_at(s, nm) for p in self.panels if (s := spectra[p.id]) is not None])

    def values(self, gains: dict[str, float], rng: np.random.Generator | None = None) -> Reflectances:
        """The indicators by the standard's formulas; with `rng` of one noisy measurement."""
        panel, height, range_m, factor = self._geometry
        by_line, by_band, in_band = self._read
        amplitude = self._laser(gains)[panel] * factor
        if rng is not None:
            amplitude = amplitude * (1.0 + _AMPLITUDE_STD * rng.standard_normal(len(amplitude)))
            in_band = in_band * (1.0 + _DN_STD * rng.standard_normal(len(in_band)))
        fitted = np.empty(len(panel))
        for h in np.unique(height):
            rows = height == h
            a, l = (_standardised(v[rows]) for v in (amplitude, range_m))
            design = np.stack([np.ones_like(a), a, l, a**2, a * l, l**2], axis=-1)
            fitted[rows] = design @ lstsq(design, by_line[panel[rows]])[0]
        seen = np.unique(panel)
        first = np.array([fitted[panel == p].mean() for p in seen])
        straight = np.stack([np.ones_like(in_band), in_band], axis=-1)
        second = (straight @ lstsq(straight, by_band)[0])[seen]
        difference, n = first - by_line[seen], len(seen)
        return Reflectances(
            m_f=float(np.sqrt(np.sum(difference**2) / n)),
            r_f=float(100.0 * np.corrcoef(first, second)[0, 1]),
            relative=float(np.sqrt(np.sum((first - second) ** 2) / (2.0 * (n - 1)))),
            panels=n,
        )

    def spread(self, gains: dict[str, float], replicates: int) -> Reflectances:
        """Standard uncertainty of one measurement of each, by replicates of noise."""
        rng = np.random.default_rng(np.random.SeedSequence([self._config.seed, 8183]))
        truth = self.values(gains)
        drawn = [self.values(gains, rng) for _ in range(replicates)]
        m_f, r_f, relative = (
            float(np.sqrt(np.mean([(getattr(d, key) - getattr(truth, key)) ** 2 for d in drawn])))
            for key in ("m_f", "r_f", "relative")
        )
        return Reflectances(m_f=m_f, r_f=r_f, relative=relative, panels=truth.panels)

    def gains(self, strength: float) -> dict[str, float]:
        """A pattern of gains at the laser's line that grows with `strength`: within a level they cancel, so that the surface and
        the line absorb little; each level takes what its reflectance allows."""
        out: dict[str, float] = {}
        signs = dict.fromkeys((p.nominal_reflectance_percent for p in self.panels), 0)
        for panel in self.panels:
            level = (panel.nominal_reflectance_percent or 0.0) / 100.0
            k = signs[panel.nominal_reflectance_percent]
            signs[panel.nominal_reflectance_percent] += 1
            sign = (1.0, -1.0, -1.0, 1.0)[k % 4]
            nm = self._config.lidar.wavelength_nm
            assert panel.spectrum is not None
            room = reflectance_at(panel.spectrum, nm)
            most = min(0.9 * room, 0.97 - room) if level < 0.9 else 0.0
            out[panel.id] = round(sign * strength * most, 9)
        return {name: gain for name, gain in out.items() if gain}


def _standardised(values: np.ndarray) -> np.ndarray:
    return np.asarray((values - values.mean()) / max(float(values.std()), 1e-12))
