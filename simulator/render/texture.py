"""Procedural albedo texture of the ground: a factor on the reflectance, a function of the place alone.

Sum of octaves of value noise from the material's finest wavelength to some fifty times of it (centimetres to metres). No
image, no seed: the same place looks the same in every frame and to every sensor.
"""

from typing import Any

from simulator.render import start
from simulator.render.sampling import mix

start()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

OCTAVES = 6
LACUNARITY = 2.23  # not 2: lattices of different octaves shall not coincide
TURN = 0.61  # radians from octave to octave, so that no direction stands out
CELL_SHARE = 0.5  # lattice spacing over wavelength
# Value noise: corner values uniform in -1..1 (variance 1/3), weights by the smoothstep of the place within the cell; the mean
# over the cell of w^2 + (1 - w)^2 is 26/35 an axis.
OCTAVE_STD = (26 / 35) * (1 / 3) ** 0.5
DARKEST = 0.1  # lower limit of the factor


def _corner(x: Any, y: Any, octave: int) -> Any:
    """Value in -1..1 of a lattice point (Int32, Int32)."""
    h = mix(mi.UInt32(x) * 0x8DA6B343 + mi.UInt32(y) * 0xD8163841 + ((octave * 0xCB1AB31F) & 0xFFFFFFFF))
    return mi.Float(h >> 8) * 2.0**-23 - 1.0


def unit_noise(x_m: Any, y_m: Any, inverse_scale: Any) -> Any:
    """Noise of zero mean and unit variance at places of the world, `inverse_scale` = 1 / finest wavelength. [1/m]"""
    total = mi.Float(0)
    frequency = inverse_scale / CELL_SHARE
    for octave in range(OCTAVES):
        c, s = dr.cos(mi.Float(octave * TURN)), dr.sin(mi.Float(octave * TURN))
        u = (c * x_m - s * y_m) * frequency + 17.31 * octave
        v = (s * x_m + c * y_m) * frequency + 5.77 * octave
        fu, fv = dr.floor(u), dr.floor(v)
        iu, iv = mi.Int32(fu), mi.Int32(fv)
        wu, wv = u - fu, v - fv
        wu, wv = wu * wu * (3 - 2 * wu), wv * wv * (3 - 2 * wv)
        low = dr.lerp(_corner(iu, iv, octave), _corner(iu + 1, iv, octave), wu)
        high = dr.lerp(_corner(iu, iv + 1, octave), _corner(iu + 1, iv + 1, octave), wu)
        total += dr.lerp(low, high, wv)
        frequency = frequency / LACUNARITY
    return total * (1 / (OCTAVE_STD * OCTAVES**0.5))


def texture_factor(x_m: Any, y_m: Any, contrast: Any, inverse_scale: Any) -> Any:
    """Factor on the reflectance: mean 1, relative standard deviation `contrast` (0: exactly 1)."""
    return dr.maximum(1 + contrast * unit_noise(x_m, y_m, inverse_scale), DARKEST)
