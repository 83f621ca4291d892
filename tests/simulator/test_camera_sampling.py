"""The renderer's numbers: stratification, pixel filter, sky table, texture."""

import numpy as np
import pytest

from scenes.sunsky import sky_normalisation, sky_radiance_relative
from simulator.render.sampling import FILTER_KNOTS, PixelSampler, filter_quantiles, mix
from simulator.render.scene import dr, mi
from simulator.render.sky import cells, relative_radiance, sample, upload
from simulator.render.spread import fold, halo_px, weights
from simulator.render.texture import texture_factor, unit_noise

TO_SUN = np.array([np.cos(0.9) * np.sin(2.0), np.cos(0.9) * np.cos(2.0), np.sin(0.9)])


def sky(direction: np.ndarray) -> np.ndarray:
    return sky_radiance_relative(direction, TO_SUN)


@pytest.mark.parametrize("count", [4, 16, 64])
@pytest.mark.parametrize("pair", [0, 3])
def test_every_elementary_interval_holds_one_sample(count: int, pair: int) -> None:
    """Rationale: stratification is what makes few samples enough, and tells a (0, 2) sequence from plain hashes.

    Expected: for n = 2^m samples, every box of 2^-k x 2^-(m-k) holds exactly one, in any pixel and pair of dimensions.
    Tolerance: none.
    """
    pixels = 50
    lane = dr.arange(mi.UInt32, pixels * count)
    sampler = PixelSampler(lane // count, (mi.UInt32(11), mi.UInt32(12)), 4)
    u, v = (np.asarray(x).reshape(pixels, count) for x in sampler.pair(lane % count, pair))
    power = int(np.log2(count))
    for k in range(power + 1):
        box = np.floor(u * 2**k).astype(int) * 2 ** (power - k) + np.floor(v * 2 ** (power - k)).astype(int)
        assert (np.sort(box, axis=1) == np.arange(count)).all(), k


def test_pairs_and_pixels_are_unrelated() -> None:
    """Rationale: one sequence used for the place in the pixel and for the sky would shade edges.

    Expected: no correlation between pairs of dimensions, between neighbouring pixels, or between seeds.
    Tolerance: 16 384 pairs: standard error 0.0078, 4 of them.
    """
    lane = dr.arange(mi.UInt32, 1 << 14)

    def draw(pixel_shift: int, pair: int, seed: int) -> np.ndarray:
        sampler = PixelSampler(lane // 4 + pixel_shift, (mi.UInt32(seed), mi.UInt32(12)), 4)
        return np.asarray(sampler.pair(lane % 4, pair)[0])

    base = draw(0, 0, 11)
    assert base.mean() == pytest.approx(0.5, abs=0.01)
    for other in (draw(0, 1, 11), draw(0, 2, 11), draw(1, 0, 11), draw(0, 0, 13)):
        assert abs(np.corrcoef(base, other)[0, 1]) < 0.031
    assert len(np.unique(np.asarray(mix(lane)))) == 1 << 14  # a bijection


@pytest.mark.parametrize("sigma", [0.0, 0.3, 0.45, 1.0])
def test_pixel_filter_has_the_stated_spread(sigma: float) -> None:
    """Rationale: the point spread is drawn, not convolved: its variance must be box + Gaussian.

    Expected: variance 1/12 + sigma^2, mean 0, and the box alone for sigma = 0.
    Tolerance: 0.3 % for 2048 linear pieces and the cut tails.
    """
    q = filter_quantiles(sigma)
    left, right = q[:-1], q[1:]
    assert ((left**2 + left * right + right**2) / 3).sum() / FILTER_KNOTS == pytest.approx(1 / 12 + sigma**2, rel=3e-3)
    assert q + q[::-1] == pytest.approx(0.0, abs=1e-12)
    assert (np.diff(q) > 0).all()


def test_sky_cells_carry_the_sky() -> None:
    """Rationale: the kernel's sky is the table; it must be the CIE sky that scenes states.

    Expected: irradiance of a level surface equal in all cells; of surfaces tilted by 30, 60 and 90 degrees in four
    directions the integral of the CIE sky, both relative to the level one.
    Tolerance: 0.5 % of the level irradiance (0.31 % at worst, upright): cells of some 5 degrees, constant inside.
    """
    row, column, relative = cells(sky)
    share = np.diff(row)[:, None] * np.diff(column, axis=1) * relative
    assert share * relative.size == pytest.approx(1.0)
    table = upload(sky)
    node, weight = np.polynomial.legendre.leggauss(200)
    z, weight = 0.5 * (node + 1), 0.5 * weight
    turn = 2 * np.pi * (np.arange(720) + 0.5) / 720
    grid = np.stack(
        np.broadcast_arrays(
            np.sqrt(1 - z**2)[:, None] * np.cos(turn), np.sqrt(1 - z**2)[:, None] * np.sin(turn), z[:, None]
        ),
        axis=-1,
    )
    level = sky_normalisation(TO_SUN)
    direction = mi.Vector3f(*(mi.Float(np.ascontiguousarray(c.ravel(), np.float32)) for c in np.moveaxis(grid, -1, 0)))
    stored = np.asarray(relative_radiance(table, direction)).reshape(grid.shape[:2]) / np.pi
    for tilt in np.radians([30.0, 60.0, 90.0]):
        for azimuth in np.radians([10.0, 100.0, 190.0, 280.0]):
            n = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
            exact = (weight[:, None] * sky(grid) * np.maximum(grid @ n, 0)).sum() * 2 * np.pi / 720 / level
            found = (weight[:, None] * stored * np.maximum(grid @ n, 0)).sum() * 2 * np.pi / 720
            assert found == pytest.approx(exact, abs=5e-3), (tilt, azimuth)


def test_sky_lookup_finds_the_cell_that_was_drawn() -> None:
    """Rationale: the density of a direction is looked up when another strategy drew it; a wrong cell biases the sky.

    Expected: the radiance looked up is that of the cell the direction was drawn from.
    Tolerance: a direction on a border may fall into the next cell by rounding: one in a thousand.
    """
    table = upload(sky)
    lane = dr.arange(mi.UInt32, 1 << 14)
    sampler = PixelSampler(lane, (mi.UInt32(1), mi.UInt32(2)), 4)
    direction, relative = sample(table, *sampler.pair(mi.UInt32(0), 0))
    again = np.asarray(relative_radiance(table, direction))
    assert np.mean(again != np.asarray(relative)) < 1e-3
    assert np.asarray(dr.norm(direction)) == pytest.approx(1.0, abs=1e-5)


def test_texture_has_the_stated_contrast() -> None:
    """Rationale: contrast decides whether feature matching works and how the ground's reflectance scatters.

    Expected: mean 1, relative standard deviation as set, neighbours alike and places metres apart unlike.
    Tolerance: noise of 65 536 places over 600 m with metre-wide octaves: 2 %.
    """
    rng = np.random.default_rng(3)
    x, y = (mi.Float(c.astype(np.float32)) for c in rng.uniform(-300, 300, (2, 1 << 16)))
    factor = np.asarray(texture_factor(x, y, mi.Float(0.2), mi.Float(1 / 0.04)))
    assert factor.mean() == pytest.approx(1.0, abs=0.004)
    assert factor.std() == pytest.approx(0.2, rel=0.02)
    noise = np.asarray(unit_noise(x, y, mi.Float(1 / 0.04)))
    near = np.asarray(unit_noise(x + 0.004, y, mi.Float(1 / 0.04)))
    far = np.asarray(unit_noise(x + 7.7, y, mi.Float(1 / 0.04)))
    assert np.corrcoef(noise, near)[0, 1] > 0.95
    assert abs(np.corrcoef(noise, far)[0, 1]) < 0.05
    assert (np.asarray(texture_factor(x, y, mi.Float(0.0), mi.Float(25.0))) == 1).all()


@pytest.mark.parametrize("split", [2, 4])
@pytest.mark.parametrize("sigma", [0.0, 0.45, 0.8])
def test_folding_has_the_stated_spread(split: int, sigma: float) -> None:
    """Rationale: inside the boxes the point spread is these weights; it must be the one that is drawn outside them.

    Expected: sum 1, symmetric, variance (with the sub-pixel's own box) 1/12 + sigma^2; a ramp stays the same ramp.
    Tolerance: 0.5 % for the cut at 3.5 sigma; rounding of single precision for the ramp.
    """
    w = weights(sigma, split)
    at = (np.arange(len(w)) + 0.5) / split - (halo_px(sigma) + 0.5)
    assert w.sum() == pytest.approx(1.0)
    assert w == pytest.approx(w[::-1], abs=1e-12)
    assert (w * at**2).sum() + 1 / (12 * split**2) == pytest.approx(1 / 12 + sigma**2, rel=5e-3)
    halo = halo_px(sigma)
    y, x = np.mgrid[: (6 + 2 * halo) * split, : (9 + 2 * halo) * split].astype(np.float32)
    ramp = ((x + 0.5) / split - halo)[..., None] + 10 * ((y + 0.5) / split - halo)[..., None]
    folded = fold(ramp, sigma, split)
    row, column = np.mgrid[:6, :9] + 0.5
    assert folded[..., 0] == pytest.approx(column + 10 * row, rel=1e-5)
