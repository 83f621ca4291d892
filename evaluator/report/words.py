"""How each indicator is calculated, as the report says it: formula in plain symbols, words, and from which data.

Both languages, (Chinese, English).
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """One indicator: formula, one or two sentences, the files it comes from; (Chinese, English)."""

    formula: str
    words: tuple[str, str]
    data: tuple[str, str]


_PANELS = (
    "survey/targets.csv、spectra.csv 的标准反射靶标（5 级各不少于 4 个），",
    "reference panels of survey/targets.csv and spectra.csv (at least four of each of five classes), ",
)

HOW: dict[str, Explanation] = {
    "lidar_reflectance_rmse": Explanation(
        formula="m_f = √( Σ (Rᵢ − R̂ᵢ)² / n )",
        words=(
            "Rᵢ：标准反射靶标 i 的反射率，由对振幅 A（波形分解）和距离 L 拟合的二次曲面 f(A, L, R) 得到；R̂ᵢ："
            "光谱仪在激光波长处的反射率。"
            "按标准原文，曲面在同一批标准反射靶标上拟合与检验；逐靶标留出的数值列于其旁。",
            "Rᵢ: reflectance of panel i from the surface f(A, L, R) of second degree, fitted to amplitude A and range L of the "
            "decomposed waveforms. R̂ᵢ: spectrometer reflectance at the laser line. The value is in-sample, as the "
            "standard writes it; "
            "the leave-one-panel-out figure stands beside it.",
        ),
        data=(
            _PANELS[0] + "sorties/NN/lidar/strip_NN.las 及 .wdp 波形，sensors/lidar.json",
            _PANELS[1] + "waveforms of sorties/NN/lidar/strip_NN.las and .wdp, sensors/lidar.json",
        ),
    ),
    "camera_stability": Explanation(
        formula="SD = √( Σ (DNᵢ − D̄N)² / (n − 1) ),   RSD = 100 · SD / D̄N",
        words=(
            "光源预热 20 min 后，1 h 内每 3 min 拍摄积分球一张，含首尾共 21 张。DNᵢ：各波段中央九像素均值，已减黑电平；"
            "取最大的波段。"
            "光源漂移计入该值，趋势列于其旁。",
            "Images of an integrating sphere every three minutes over one hour, 21 with both ends, after 20 minutes of warm-up. "
            "DNᵢ: mean of the nine central pixels, black level subtracted, for each band; the greatest figure counts. "
            "A drift of the "
            "lamp enters the figure and stands beside it as trend.",
        ),
        data=("bench/sphere_stability 的影像与 log.csv", "images and log.csv of bench/sphere_stability"),
    ),
    "camera_repeatability": Explanation(
        formula="s(x) = 100 · √( Σ (xᵢ − x̄)² / (n − 1) ) / x̄",
        words=(
            "5 min 内每 15 s 拍摄积分球一张，共 21 张。xᵢ：各波段中央九像素均值，已减黑电平。式 (6) 得 DN 而限值为百分比，"
            "故取相对均值"
            "之比；DN 值列于其旁。",
            "21 images of an integrating sphere every 15 seconds over five minutes. xᵢ: mean of the nine central pixels, black "
            "level subtracted, for each band. Formula (6) gives DN and its bounds are in percent, so the figure is "
            "relative to the "
            "mean; the one in DN stands beside it.",
        ),
        data=("bench/sphere_repeatability 的影像与 log.csv", "images and log.csv of bench/sphere_repeatability"),
    ),
    "reflectance_correlation": Explanation(
        formula="r_f = Σ (R₁ᵢ − R̄₁)(R₂ᵢ − R̄₂) / √( Σ (R₁ᵢ − R̄₁)² · Σ (R₂ᵢ − R̄₂)² )",
        words=(
            "R₁：激光雷达反射率；R₂：相机反射率（经验线性法）；同一批标准反射靶标。",
            "R₁: LiDAR, R₂: camera by the empirical line, both for the same panels.",
        ),
        data=(
            _PANELS[0] + "各架次波形与影像",
            _PANELS[1] + "waveforms and images of all sorties",
        ),
    ),
    "reflectance_rmse_relative": Explanation(
        formula="M_f = √( Σ (R₁ᵢ − R₂ᵢ)² / (2 (n − 1)) )",
        words=(
            "R₁：激光雷达反射率；R₂：相机反射率（经验线性法）；同一批标准反射靶标。",
            "R₁: LiDAR, R₂: camera by the empirical line, both for the same panels.",
        ),
        data=(
            _PANELS[0] + "各架次波形与影像",
            _PANELS[1] + "waveforms and images of all sorties",
        ),
    ),
    "lidar_ranging_rmse_relative": Explanation(
        formula="L_Q = L + K₂ + R₂ L,   m_j = √( Σ (L_Q,ᵢ − L̂ᵢ)² / n ),   m_z = 100 · m_j / mean(L̂)",
        words=(
            "L：激光雷达对一个标准反射靶标的平均测距。K₂、R₂ 由式 (13)-(14) 最小二乘求得，以 10 mm 级或更好的全站仪斜距为准，"
            "斜距已加自身常数 "
            "K₁、R₁ 和气象改正 (12)（群折射率按 IUGG 1999）。L̂：5 mm 级全站仪的相对真值。两者均归算至激光雷达中心。"
            "改正前的数值列于其旁。",
            "L: mean LiDAR range of a panel. K₂ and R₂ by least squares, (13)-(14), against a total station of the 10 mm class "
            "or better, whose slope distances carry its own constants K₁, R₁ and the atmospheric correction (12) with "
            "the group index "
            "of IUGG 1999. L̂: relative true value by a total station of the 5 mm class. Both refer to the LiDAR's "
            "centre. The figure "
            "before the correction stands beside it.",
        ),
        data=(
            "ranging/line.json、total_station.csv 与 scans/（标准反射靶标不少于 5 个，每个不少于 5 次）",
            "ranging/line.json, total_station.csv and scans/ (at least five panels, five observations each)",
        ),
    ),
    "camera_reprojection_error": Explanation(
        formula="M_z = Σ ‖ wᵢ − K [R|t] Pᵢ / sᵢ ‖ / n",
        words=(
            "wᵢ：影像中检测到的棋盘格角点（已去畸变）；K [R|t] Pᵢ / sᵢ：同一角点的投影。内方位元素、径向（k1 k2 k3）和切向（p1 "
            "p2）畸变"
            "与各影像位姿一并最小二乘求得；对全部采用影像的全部角点取平均。",
            "wᵢ: corner of the chessboard as found in an image, distortion removed; K [R|t] Pᵢ / sᵢ: the same corner "
            "projected. Interior orientation, radial (k1 k2 k3) and tangential (p1 p2) distortion and the pose of "
            "every image by one "
            "least-squares adjustment; the mean is over every corner of every accepted image.",
        ),
        data=(
            "bench/chessboard 的影像、board.json 与 log.csv（不少于 20 张、4 个距离）",
            "images, board.json and log.csv of bench/chessboard (at least 20 images, four distances)",
        ),
    ),
    "calibration_error": Explanation(
        formula="P_m = Σ Pᵢ / n",
        words=(
            "Pᵢ：靶标 i 在其各影像中，标识中心与激光雷达棱面公共顶点（按平差后的安置参数投影）之间像素距离的平均。"
            "飞行中扫描仪与相机在不同"
            "时刻看到靶标，故两个传感器的安置一并平差。留出靶标的数值列于其旁。",
            "Pᵢ: mean, over the images of target i, of the distance in pixels between the mark's centre and the vertex of the "
            "LiDAR's face planes, projected with the adjusted mounting. In flight scanner and camera see a target at different "
            "times, so both mountings are adjusted together. The figure on held-out targets stands beside it.",
        ),
        data=(
            "survey/targets.csv 的梯形棱台靶标（不少于 20 个），各架次影像、点云与航迹，sensors/rig.json、camera.json",
            "frustum targets of survey/targets.csv (at least 20), images, point clouds and trajectories of all sorties, "
            "sensors/rig.json and camera.json",
        ),
    ),
}
