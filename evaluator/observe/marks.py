"""The centre of a four-sector mark in an image, to hundredths of a pixel (9.3.2 e). Never a centroid.

The appearance of the mark is known up to its place, the two edges' directions, blur, the brightness of white and black in sun
and shade, and some millimetres in the place of the shadow. Pixels at the edge of the funnel or of the disc are left out; the
others decide by least squares.
What hides and shades the mark comes from `target_view`; vertices in point clouds live in `frustums`.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy.signal

from evaluator.observe.target_view import on_plate

_FINE = 6  # samples a pixel and axis in the maps
_BLUR_PX, _BLUR_STEP_PX = (
    0.5,
    0.3,
)  # standard deviation before the pixel's own box; its spread is fitted between +- the step
_SUN_RADIUS = np.radians(0.2666)
_SUN_POINTS = 6
_TILT_STD = np.radians(
    0.3
)  # of the sun against the sheets: sheet-metal work, level of the plate; 1-2 mm of the shadow's place
_EDGE_STD = np.radians(2.0)  # direction of each edge against the predicted one
_SHADE_SHARE, _SHADE_STD = 0.28, 0.12  # light in the shade over light in the sun: sky, and sunlit faces
_LEAST_SHARE_PX = 0.02  # pixels of a region, below which it has no brightness of its own
_LEAST_CORRELATION = 0.6
_LEAST_CONTRAST = 0.35  # of white to black over white
_LEAST_PIXELS = 35
_FLOOR_PX = 0.004  # standard deviation below which no centre is stated
_LARGEST_STD_PX = 0.05  # a centre that is known worse rests on what is known of the shadow, not on the sectors
_WORST_FIT = 0.05  # residuals over contrast
_CORRELATED = (
    1.4  # neighbouring residuals have causes in common (penumbra, light from the faces): factor on the deviation
)


@dataclass(frozen=True, kw_only=True)
class MarkView:
    """One mark as one image should show it."""

    predicted_px: np.ndarray  # (2,)
    px_per_m: np.ndarray  # (2, 2) pixel step by target x and y
    radius_m: float
    sheets_m: (
        np.ndarray
    )  # (q, 4, 3) quadrilaterals of the funnel, target frame about the mark: `target_view.sheet_quads`
    eye_m: np.ndarray  # (3,) projection centre, target frame about the mark
    to_sun: np.ndarray | None  # (3,) unit, target frame; None: no sun


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


def _outlines(points_m: np.ndarray, view: MarkView, size: int, half: float) -> list[np.ndarray]:
    """Outlines (k, 2) of slabs (q, 8, 2) on the plate, at fine coordinates, of those that may meet the mark."""
    fine = (points_m @ view.px_per_m.T + half) * _FINE - 0.5
    meets = np.all((fine.min(axis=1) < size) & (fine.max(axis=1) > -1.0), axis=-1)
    return [cv2.convexHull(corners.astype(np.float32))[:, 0] for corners in fine[meets]]


def _cover(outlines: list[np.ndarray], size: int) -> np.ndarray:
    """Share of every fine sample's square inside any of the outlines; true to area for slivers thinner than a square."""
    left = np.ones((size, size), np.float32)
    at = np.arange(size, dtype=np.float32)
    for outline in outlines:
        edge = np.roll(outline, -1, axis=0) - outline
        length = np.hypot(edge[:, 0], edge[:, 1])
        normal = np.stack([-edge[:, 1], edge[:, 0]], axis=1)[length > 1e-3] / length[length > 1e-3, None]
        corner = outline[length > 1e-3]
        if np.sum(normal * (outline.mean(axis=0) - corner)) < 0.0:
            normal = -normal
        # distance beyond an edge is linear over the map: its extremes are at the corners
        middle = np.sum(normal * (corner - 0.5 * (size - 1)), axis=1) + 0.5
        reach = 0.5 * (size - 1) * np.abs(normal).sum(axis=1)
        if np.any(middle - reach >= 1.0):
            continue
        outside = np.zeros((size, size), np.float32)
        for k in np.flatnonzero(middle + reach > 0.0):
            (nx, ny), (cx, cy) = normal[k], corner[k]
            beyond = np.add.outer(ny * (cy - at) + np.float32(0.5), nx * (cx - at))
            outside += np.clip(beyond, 0.0, 1.0, out=beyond)
        left *= np.minimum(outside, 1.0, out=outside)
    return 1.0 - left


def _centre_hidden(view: MarkView) -> bool:
    """Whether a sheet stands before the centre and half a pixel around it. Inverted funnels never do; upright ones do from
    35.26 degrees off the zenith along a side."""
    outlines = _outlines(on_plate(view.sheets_m, view.eye_m, finite=True), view, 1, 0.5)
    return any(cv2.pointPolygonTest(o, (_FINE / 2 - 0.5, _FINE / 2 - 0.5), True) > 0.5 * _FINE for o in outlines)


def _grown(mask: np.ndarray, by_px: float) -> np.ndarray:
    """Mask grown by a disc."""
    r = max(round(by_px * _FINE), 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * r + 1, 2 * r + 1))
    return np.asarray(cv2.dilate(mask, disc))


@dataclass(frozen=True, kw_only=True)
class _Maps:
    """Finely sampled shares of a pixel, blurred: 0-3 lit white, lit black, shaded white, shaded black, 4 not to be used."""

    base: np.ndarray  # (5, s, s)
    by_place: np.ndarray  # (2, 4, s, s) slope by column and row [1/px]
    by_blur: np.ndarray  # (4, s, s) change with the blur's step
    by_shade: np.ndarray  # (0 or 2, 4, s, s) change when the sun moves by _TILT_STD against the target
    half_px: float


def _shade(view: MarkView, size: int, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Share of the sun's disc that the sheets hide (size, size), and its slope (2, size, size) by the sun's place over _TILT_STD.

    A ring of R / sqrt 2 has the disc's second moments. Near the faces' own angle the sheets' shadow is a line thinner than the
    penumbra: with a point for a sun it would be a black line through the centre.
    """
    if view.to_sun is None:
        return np.zeros((size, size), np.float32), np.zeros((2, size, size), np.float32)
    turn = 2.0 * np.pi * (np.arange(_SUN_POINTS) + 0.5) / _SUN_POINTS
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    across = np.linalg.svd(view.to_sun[None])[2][1:]
    radius = _SUN_RADIUS / np.sqrt(2.0)
    hidden = np.stack(
        [
            _cover(_outlines(on_plate(view.sheets_m, sun, finite=False), view, size, half), size)
            for sun in view.to_sun / np.linalg.norm(view.to_sun) + radius * ring @ across
        ]
    )
    slope = np.tensordot(ring.T * (2.0 / _SUN_POINTS * _TILT_STD / radius), hidden, axes=1)
    return hidden.mean(axis=0), np.asarray(slope, dtype=np.float32)


def _maps(view: MarkView) -> _Maps:
    reach = view.radius_m * float(np.linalg.norm(view.px_per_m, ord=2))
    half = float(np.ceil(reach + 3.0))
    size = int(2 * half) * _FINE
    axis = (np.arange(size) + 0.5) / _FINE - half
    u, v = np.meshgrid(axis, axis)
    inverse = np.linalg.inv(view.px_per_m)
    x, y = inverse[0, 0] * u + inverse[0, 1] * v, inverse[1, 0] * u + inverse[1, 1] * v
    scale = float(np.sqrt(abs(np.linalg.det(view.px_per_m))))
    behind = _cover(_outlines(on_plate(view.sheets_m, view.eye_m, finite=True), view, size, half), size)
    hidden = _grown((behind > 0.02).astype(np.uint8), 0.2 + 0.003 * scale).astype(bool)
    out = hidden | (np.hypot(x, y) > view.radius_m)
    white = (x * y > 0.0).astype(np.float32)
    black = 1.0 - white
    shade, slope = _shade(view, size, half)
    raw = np.stack([white * (1.0 - shade), black * (1.0 - shade), white * shade, black * shade, out.astype(np.float32)])
    base = _blurred(raw)
    by_shade = np.zeros((0, 4, size, size), np.float32)
    if np.any(slope[:, ~out]):
        moved = _blurred(np.stack([white * slope[0], black * slope[0], white * slope[1], black * slope[1]]))
        by_shade = np.stack([-moved[0], -moved[1], moved[0], moved[1], -moved[2], -moved[3], moved[2], moved[3]])
        by_shade = by_shade.reshape(2, 4, size, size)
    kernel = np.array([-0.5, 0.0, 0.5], np.float32) * _FINE
    one = np.ones(1, np.float32)
    return _Maps(
        base=base,
        by_place=np.stack(
            [
                [cv2.sepFilter2D(m, -1, kernel, one) for m in base[:4]],
                [cv2.sepFilter2D(m, -1, one, kernel) for m in base[:4]],
            ]
        ),
        by_blur=np.stack([cv2.Laplacian(m, -1) for m in base[:4]]) * (_BLUR_PX * _BLUR_STEP_PX * _FINE**2),
        by_shade=by_shade,
        half_px=half,
    )


def _blurred(maps: np.ndarray) -> np.ndarray:
    """As pixels see them: Gaussian of the optics, then the pixel's square."""
    reach = round(3.5 * _BLUR_PX * _FINE)
    gauss = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (_BLUR_PX * _FINE)) ** 2)
    box = np.array([0.5, *np.ones(_FINE - 1), 0.5])
    kernel = np.convolve(gauss, box)
    kernel /= kernel.sum()
    return np.stack([cv2.sepFilter2D(m, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE) for m in maps])


def _search(window: np.ndarray, maps: _Maps) -> list[tuple[np.ndarray, float]]:
    """Best places of the predicted appearance: (column, row) in the window's pixel coordinates, correlation; best first."""
    half = maps.half_px
    pick = np.arange(int(2 * half)) * _FINE + _FINE // 2
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


def _refine(samples: _Samples, maps: _Maps, view: MarkView, start: np.ndarray, iterations: int = 10) -> _State | None:
    """Gauss-Newton on centre, edge directions, blur and shadow; brightness and its slopes across the mark are linear."""
    state = _State(
        centre=start, edges=np.zeros(2), covariance=np.eye(2), coefficients=np.zeros(4), rms=np.inf, pixels=0
    )
    inverse = np.linalg.inv(view.px_per_m)
    radius = view.radius_m * float(np.sqrt(abs(np.linalg.det(view.px_per_m))))
    for _ in range(iterations):
        plate = (samples.uv - state.centre) @ inverse.T
        shear = np.array([[1.0, -state.edges[0]], [state.edges[1], 1.0]])
        fine = (plate @ shear.T @ view.px_per_m.T + maps.half_px) * _FINE - 0.5
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
        prior_std[2:4] = _EDGE_STD
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
    radius_px = view.radius_m * float(np.sqrt(abs(np.linalg.det(view.px_per_m))))
    if radius_px < 4.0:
        return f"mark of {radius_px:.1f} px radius, 4 px are needed"
    if _centre_hidden(view):
        return "the funnel hides the centre"
    maps = _maps(view)
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
    maps: _Maps,
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
