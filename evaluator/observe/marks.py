"""The centre of a four-sector mark in an image, to hundredths of a pixel (9.3.2 e). Never a centroid.

The appearance of the mark is known up to its place, the two edges' directions, blur, the brightness of white and black in sun
and shade, and some millimetres in the place of the shadow. Pixels at the edge of the funnel or of the disc are left out; the
others decide by least squares.
What the mark should look like comes from `mark_view`; vertices in point clouds live in `frustums`.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.signal

from evaluator.observe.mark_view import FINE, Maps, MarkView, appearance, centre_hidden, mark_radius_px

_EDGE_STD = np.radians(2.0)  # direction of each edge against the predicted one
_LEAST_EDGE_STD = np.radians(0.2)  # the same, as the drawing has it
_SHADE_SHARE, _SHADE_STD = 0.28, 0.12  # light in the shade over light in the sun: sky, and sunlit faces
_LEAST_SHARE_PX = 0.02  # pixels of a region, below which it has no brightness of its own
_LEAST_CORRELATION = 0.6
_LEAST_CONTRAST = 0.35  # of white to black over white
_LEAST_PIXELS = 35
_FLOOR_PX = 0.004  # standard deviation below which no centre is stated
_LARGEST_STD_PX = 0.05  # a centre that is known worse rests on what is known of the shadow, not on the sectors
_WORST_FIT = 0.05  # residuals over contrast
_CORRELATED = (
    1.4  # factor on the deviation: neighbouring residuals have causes in common (penumbra, light from the faces)
)


@dataclass(frozen=True, kw_only=True)
class MarkFit:
    """Centre of a mark."""

    uv_px: np.ndarray  # (2,)
    covariance_px2: np.ndarray  # (2, 2)
    radius_px: float  # of the mark, mean over directions
    correlation: float  # of the search
    contrast: float  # white minus black over white, in the sun
    rms: float  # residuals over white minus black
    pixels: int


def _search(window: np.ndarray, maps: Maps) -> list[tuple[np.ndarray, float]]:
    """Best places of the predicted appearance: (column, row) in the window's pixel coordinates, correlation; best first."""
    half = maps.half_px
    pick = np.arange(int(2 * half)) * FINE + FINE // 2
    at = maps.base[:, pick[:, None], pick]
    usable = (at[4] < 0.3).astype(np.float64)
    if usable.sum() < _LEAST_PIXELS:
        return []
    template = (at[0] + 0.08 * at[1] + 0.3 * at[2] + 0.03 * at[3]) * usable
    template -= usable * template.sum() / usable.sum()
    level = window - window.mean()

    def correlate(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.asarray(scipy.signal.fftconvolve(a, b[::-1, ::-1], mode="valid"))

    mean = correlate(level, usable) / usable.sum()
    spread = correlate(level**2, usable) - usable.sum() * mean**2
    floor = 1e-6 * float(np.var(level)) * usable.sum() + 1e-12
    score = np.abs(correlate(level, template)) / np.sqrt(np.maximum(spread, floor) * np.sum(template**2))
    rows, columns = np.ogrid[: score.shape[0], : score.shape[1]]
    found: list[tuple[np.ndarray, float]] = []
    for _ in range(3):
        row, column = np.unravel_index(int(np.argmax(score)), score.shape)
        best = float(score[row, column])
        if best < max(_LEAST_CORRELATION, 0.85 * found[0][1] if found else 0.0):
            break
        found.append((np.array([column + half, row + half], dtype=np.float64), best))
        score = np.where(np.hypot(rows - row, columns - column) > 0.6 * half, score, 0.0)
    return found


@dataclass(frozen=True, kw_only=True)
class _Samples:
    """Window pixels around a centre."""

    uv: np.ndarray  # (n, 2) pixel centres
    value: np.ndarray  # (n,)


def _look_up(maps: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """Bilinear samples (k, n) of maps (k, s, s) at fine coordinates (n, 2): column, row."""
    size = maps.shape[-1]
    at = np.clip(fine, 0.0, size - 1.001)
    i, f = np.floor(at).astype(np.int64), at - np.floor(at)
    c, r, fc, fr = i[:, 0], i[:, 1], f[:, 0], f[:, 1]
    top = maps[:, r, c] * (1 - fc) + maps[:, r, c + 1] * fc
    low = maps[:, r + 1, c] * (1 - fc) + maps[:, r + 1, c + 1] * fc
    return np.asarray(top * (1 - fr) + low * fr)


@dataclass(frozen=True, kw_only=True)
class _State:
    centre: np.ndarray
    edges: np.ndarray
    covariance: np.ndarray
    coefficients: np.ndarray  # of the four maps
    rms: float
    pixels: int


def _brightness_ties(regions: list[int], white: float, black: float, first: int, columns: int) -> np.ndarray:
    """Weak knowledge of shade, as rows over their standard deviation: white in the shade has 0.28 +- 0.12 of its light in
    the sun, and black has the same share. A sliver of shadow beside an edge could otherwise have any brightness and shift it."""
    rows = []
    for lit, shaded, std in ((0, 2, _SHADE_STD * white), (1, 3, max(_SHADE_STD * black, 0.02 * white))):
        if lit in regions and shaded in regions:
            row = np.zeros(columns)
            row[first + regions.index(lit)], row[first + regions.index(shaded)] = -_SHADE_SHARE, 1.0
            rows.append(row / max(std, 1e-9))
    return np.array(rows).reshape(-1, columns)


def _start(y: np.ndarray, shares: np.ndarray, regions: list[int]) -> np.ndarray:
    """First brightness of the four regions."""
    black, white = np.percentile(y, [5.0, 95.0])
    ties = _brightness_ties(regions, float(white), float(black), 0, len(regions)) * 0.05 * (white - black)
    design = np.concatenate([shares[regions].T, ties])
    out = np.zeros(4)
    out[regions] = np.linalg.lstsq(design, np.concatenate([y, np.zeros(len(ties))]), rcond=None)[0]
    return out


def _refine(
    samples: _Samples, maps: Maps, view: MarkView, start: np.ndarray, edge_std: float = _EDGE_STD, iterations: int = 10
) -> _State | None:
    """Gauss-Newton on centre, edge directions, blur and shadow; brightness and its slopes across the mark are linear.

    `edge_std`: of each edge's direction against the predicted one. [rad]
    """
    state = _State(
        centre=start, edges=np.zeros(2), covariance=np.eye(2), coefficients=np.zeros(4), rms=np.inf, pixels=0
    )
    inverse = np.linalg.inv(view.px_per_m)
    radius = mark_radius_px(view)
    for _ in range(iterations):
        plate = (samples.uv - state.centre) @ inverse.T
        shear = np.array([[1.0, -state.edges[0]], [state.edges[1], 1.0]])
        fine = (plate @ shear.T @ view.px_per_m.T + maps.half_px) * FINE - 0.5
        values = _look_up(maps.base, fine)
        usable = values[4] < 0.02
        if usable.sum() < _LEAST_PIXELS:
            return None
        y, m, at = samples.value[usable], values[:4, usable], fine[usable]
        lit = m[0] + m[1]
        regions = [k for k in range(4) if m[k].sum() > _LEAST_SHARE_PX]
        coefficients = state.coefficients.copy()
        if not coefficients.any():
            coefficients = _start(y, m, regions)
        model = coefficients @ m
        steep = np.stack([coefficients @ _look_up(s, at) for s in maps.by_place], axis=1)
        by_plate = steep @ view.px_per_m
        nonlinear = [
            *(-(steep @ (view.px_per_m @ shear @ inverse))).T,
            -by_plate[:, 0] * plate[usable, 1],
            by_plate[:, 1] * plate[usable, 0],
            coefficients @ _look_up(maps.by_blur, at),
            *(coefficients @ _look_up(s, at) for s in maps.by_shade),
        ]
        offset = (samples.uv[usable] - state.centre) / radius
        slopes = []
        for part in (lit, 1.0 - lit):
            if part.sum() >= 30.0:
                slopes += [model * part * offset[:, 0], model * part * offset[:, 1]]
            if part.sum() >= 120.0:
                slopes += [model * part * offset[:, 0] * offset[:, 1], model * part * np.sum(offset**2, axis=1)]
        design = np.column_stack([*nonlinear, *(m[k] for k in regions), *slopes])
        first, last = len(nonlinear), len(nonlinear) + len(regions)
        prior_std = np.full(design.shape[1], np.inf)
        prior_std[2:4] = edge_std
        prior_std[4:first] = 1.0
        prior_value = np.zeros(design.shape[1])  # of the increments: the edges' prior stands at zero
        prior_value[2:4] = -state.edges
        white, black = np.max(np.abs(coefficients[[0, 2]])), np.max(np.abs(coefficients[[1, 3]]))
        ties = _brightness_ties(regions, float(white), float(black), first, design.shape[1])
        weight = np.ones(len(y))
        scale = 1.0
        solution: np.ndarray = np.zeros(design.shape[1])
        normal_inverse: np.ndarray = np.eye(design.shape[1])
        for _robust in range(4):
            prior = (scale / prior_std) ** 2
            normal = design.T @ (design * weight[:, None]) + np.diag(prior) + scale**2 * (ties.T @ ties)
            right = design.T @ (weight * y) + prior * prior_value
            try:
                normal_inverse = np.linalg.inv(normal)
            except np.linalg.LinAlgError:
                return None
            solution = normal_inverse @ right
            residual = y - design @ solution
            scale = max(1.4826 * float(np.median(np.abs(residual))), 1e-9)
            weight = 1.0 / np.maximum(np.abs(residual) / (2.0 * scale), 1.0) ** 2
        step = solution[:2]
        if not np.all(np.isfinite(solution)) or np.abs(step).max() > 3.0:
            return None
        coefficients = np.zeros(4)
        coefficients[regions] = solution[first:last]
        freedom = max(float(weight.sum()) - design.shape[1], 1.0)
        variance = float(np.sum(weight * residual**2)) / freedom
        state = _State(
            centre=state.centre + step,
            edges=np.clip(state.edges + solution[2:4], -0.15, 0.15),
            covariance=normal_inverse[:2, :2] * variance,
            coefficients=coefficients,
            rms=float(np.sqrt(variance)),
            pixels=int(usable.sum()),
        )
        if np.abs(step).max() < 1e-3:
            break
    return state


def find_mark(
    grey: np.ndarray, view: MarkView, search_radius_px: float, *, clipped_at: float = np.inf
) -> MarkFit | str:
    """Centre of one mark.

    Parameters
    ----------
    grey : (h, w) np.ndarray
        Whole image, linear in radiance: one band or the mean of several, black level removed or not.
    view : MarkView
        Prediction.
    search_radius_px : float
        How far the mark may be from its predicted place. [px]
    clipped_at : float
        Values from here on are saturated and not used.

    Returns
    -------
    MarkFit, or a line that says why there is none. The first pixel's centre is (0.5, 0.5).

    References
    ----------
    GB/T 41450-2022, 9.3.2 e.
    """
    radius_px = mark_radius_px(view)
    if radius_px < 4.0:
        return f"mark of {radius_px:.1f} px radius, 4 px are needed"
    if centre_hidden(view):
        return "the funnel hides the centre"
    maps = appearance(view)
    reach = int(np.ceil(search_radius_px + maps.half_px + 2.0))
    middle = np.floor(view.predicted_px).astype(int)
    low = np.maximum(middle - reach, 0)
    high = np.minimum(middle + reach + 1, [grey.shape[1], grey.shape[0]])
    if np.any(high - low < 2 * maps.half_px + 1):
        return "outside the image"
    window = np.asarray(grey[low[1] : high[1], low[0] : high[0]], dtype=np.float64)
    candidates = _search(window, maps)
    if not candidates:
        return f"no four-sector pattern within {search_radius_px:.0f} px, or too little of it in view"
    fits: list[MarkFit] = []
    reason = ""
    for place, correlation in candidates:
        fit = _fit_at(window, place, correlation, maps, view, radius_px, clipped_at)
        if isinstance(fit, MarkFit):
            fits.append(fit)
        else:
            reason = reason or fit
    if not fits:
        return reason
    fits.sort(key=lambda f: f.rms)
    if len(fits) > 1 and fits[1].rms < 1.5 * fits[0].rms:
        return "two patterns alike"
    return replace(fits[0], uv_px=fits[0].uv_px + low)


def _fit_at(
    window: np.ndarray,
    place: np.ndarray,
    correlation: float,
    maps: Maps,
    view: MarkView,
    radius_px: float,
    clipped_at: float,
) -> MarkFit | str:
    """Fit about one place of the window, and the checks that make it a mark."""
    n = round(maps.half_px) + 1
    first = np.maximum(np.floor(place).astype(int) - n, 0)
    last = np.minimum(np.floor(place).astype(int) + n + 1, [window.shape[1], window.shape[0]])
    v, u = np.mgrid[first[1] : last[1], first[0] : last[0]]
    value = window[first[1] : last[1], first[0] : last[0]].ravel()
    good = value < clipped_at
    samples = _Samples(uv=np.stack([u.ravel(), v.ravel()], axis=-1)[good] + 0.5, value=value[good])
    best = _refine(samples, maps, view, place)
    if best is None:
        return "too few clear pixels around the centre, or the fit does not converge"
    pair = best.coefficients[:2] if np.all(best.coefficients[:2]) else best.coefficients[2:]
    difference = abs(float(pair[0] - pair[1]))
    contrast = difference / max(float(np.max(np.abs(pair))), 1e-12)
    covariance = _CORRELATED**2 * best.covariance + _FLOOR_PX**2 * np.eye(2)
    # what the centre owes to the edges' directions, where a funnel leaves half a mark, and to the shadow's place
    others = [(1.0, _refine(samples, maps, view, best.centre, edge_std=_LEAST_EDGE_STD))]
    if len(maps.by_shade):
        others.append((0.5, _refine(samples, replace(maps, by_shade=maps.by_shade[:0]), view, best.centre)))
    for share, still in others:
        if still is not None:
            covariance += share * np.outer(still.centre - best.centre, still.centre - best.centre)
    std = float(np.sqrt(np.max(np.linalg.eigvalsh(covariance))))
    if contrast < _LEAST_CONTRAST:
        return f"contrast of {contrast:.2f} between the sectors"
    if best.rms > _WORST_FIT * difference:
        return f"the pattern fits badly (residuals {best.rms / difference:.2f} of the contrast)"
    if std > _LARGEST_STD_PX:
        return f"centre not determined (standard deviation {std:.2f} px)"
    if np.linalg.norm(best.centre - place) > 2.5:
        return "the fit left the pattern that was found"
    return MarkFit(
        uv_px=best.centre,
        covariance_px2=covariance,
        radius_px=radius_px,
        correlation=correlation,
        contrast=contrast,
        rms=best.rms / difference,
        pixels=best.pixels,
    )
