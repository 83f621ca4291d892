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
        formula="RSD = SD / mean(DN)", words="21 images of an integrating sphere over one hour, every three minutes."
    ),
    "camera_repeatability": Explanation(
        formula="s(x) = √( Σ (xᵢ − x̄)² / (n − 1) ) / x̄",
        words="21 images of an integrating sphere over five minutes, every 15 seconds; relative to the mean, since its bounds are "
        "in percent.",
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
        formula="m_z = √( Σ (Lᵢ − L̂ᵢ)² / n ) / mean(L̂)",
        words="Ranges to at least five panels against a total station, after the additive and the multiplicative constant "
        "are fitted.",
    ),
    "camera_reprojection_error": Explanation(
        formula="M_z = Σ ‖wᵢ − K[R|t]Pᵢ / sᵢ‖ / n",
        words="Chessboard corners after a full calibration of interior orientation and distortion.",
    ),
    "calibration_error": Explanation(
        formula="P_m = Σ Pᵢ / n",
        words="Pᵢ: mean, over the images of target i, of the distance in pixels between the mark's centre and the vertex of the "
        "LiDAR's face planes, projected with the adjusted mounting. In flight scanner and camera see a target at different "
        "times, so both mountings are adjusted together. The figure on held-out targets stands beside it.",
    ),
}
