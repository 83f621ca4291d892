"""How each indicator is calculated, as the report says it: the formula in plain symbols and one or two sentences."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """Formula and words for one indicator."""

    formula: str
    words: str


HOW: dict[str, Explanation] = {
    "lidar_reflectance_rmse": Explanation(
        formula="m_f = √( Σ (Rᵢ − R̂ᵢ)² / n )",
        words="Rᵢ: reflectance of panel i from the surface f(A, L, R) of second degree, fitted to amplitude A and range L of the "
        "decomposed waveforms. R̂ᵢ: spectrometer reflectance at the laser line. The value is in-sample, as the standard writes it; "
        "the leave-one-panel-out figure stands beside it.",
    ),
    "camera_stability": Explanation(
        formula="DNᵢ = mean of 9 pixels,   SD = √( Σ (DNᵢ − mean)² / (n − 1) ),   RSD = 100 · SD / mean",
        words="Images of an integrating sphere every three minutes over one hour, 21 with both ends, after 20 minutes of warm-up. "
        "DNᵢ: mean of the nine central pixels, black level subtracted, for each band; the greatest figure counts. A drift of the "
        "lamp enters the figure and stands beside it as trend.",
    ),
    "camera_repeatability": Explanation(
        formula="s(x) = 100 · √( Σ (xᵢ − x̄)² / (n − 1) ) / x̄",
        words="21 images of an integrating sphere every 15 seconds over five minutes. xᵢ: mean of the nine central pixels, black "
        "level subtracted, for each band. Formula (6) gives DN and its bounds are in percent, so the figure is relative to the "
        "mean; the one in DN stands beside it.",
    ),
    "reflectance_correlation": Explanation(
        formula="r_f = Σ (R₁ᵢ − R̄₁)(R₂ᵢ − R̄₂) / √( Σ (R₁ᵢ − R̄₁)² · Σ (R₂ᵢ − R̄₂)² )",
        words="R₁: LiDAR, R₂: camera by the empirical line, both for the same panels.",
    ),
    "reflectance_rmse_relative": Explanation(
        formula="M_f = √( Σ (R₁ᵢ − R₂ᵢ)² / (2 (n − 1)) )",
        words="R₁: LiDAR, R₂: camera by the empirical line, both for the same panels.",
    ),
    "lidar_ranging_rmse_relative": Explanation(
        formula="L_Q = L + K₂ + R₂ L,   m_j = √( Σ (L_Q,ᵢ − L̂ᵢ)² / n ),   m_z = 100 · m_j / mean(L̂)",
        words="L: mean LiDAR range of a panel. K₂ and R₂ by least squares, (13)-(14), against a total station of the 10 mm class "
        "or better, whose slope distances carry its own constants K₁, R₁ and the atmospheric correction (12) with the group index "
        "of IUGG 1999. L̂: relative true value by a total station of the 5 mm class. Both refer to the LiDAR's centre. The figure "
        "before the correction stands beside it.",
    ),
    "camera_reprojection_error": Explanation(
        formula="M_z = Σ ‖ wᵢ − K [R|t] Pᵢ / sᵢ ‖ / n",
        words="wᵢ: corner of the chessboard as found in an image, distortion removed; K [R|t] Pᵢ / sᵢ: the same corner "
        "projected. Interior orientation, radial (k1 k2 k3) and tangential (p1 p2) distortion and the pose of every image by one "
        "least-squares adjustment; the mean is over every corner of every accepted image.",
    ),
    "calibration_error": Explanation(
        formula="P_m = Σ Pᵢ / n",
        words="Pᵢ: mean, over the images of target i, of the distance in pixels between the mark's centre and the vertex of the "
        "LiDAR's face planes, projected with the adjusted mounting. In flight scanner and camera see a target at different "
        "times, so both mountings are adjusted together. The figure on held-out targets stands beside it.",
    ),
}
