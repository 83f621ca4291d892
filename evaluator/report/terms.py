"""Names of parameters and figures for people: code names in words, Chinese or English. Sentences stand in `texts`."""

import re

from evaluator.documents.model import Language

_SENSORS = {
    "camera_from_lidar": "激光雷达→相机",
    "boards_camera": "相机（标定板）",
    "camera": "相机",
    "lidar": "激光雷达",
}
_AXES = {"roll": "横滚", "pitch": "俯仰", "yaw": "偏航", "x": "x", "y": "y", "z": "z"}
_KINDS = {"boresight": "安置角误差", "lever_arm": "偏心分量"}
_MOUNTING = re.compile(
    r"(camera_from_lidar|boards_camera|camera|lidar)_(?:(boresight|lever_arm)_)?(roll|pitch|yaw|x|y|z)"
)
_WORDS = {
    "camera_clock": "相机时钟偏差",
    "lidar_clock": "激光雷达时钟偏差",
    "camera_gain": "相机增益（与记录之比）",
    "ranging_additive_constant": "测距加常数 K₂",
    "ranging_multiplication_constant": "测距乘常数 R₂",
    "lamp_drift": "光源漂移",
    "distortion_map_rms_px": "畸变图均方根差",
    "distortion_map_rms_turned_px": "畸变图均方根差（最佳旋转后）",
    # companions of the indicators
    "leave_one_panel_out": "逐板留出",
    "with_cos_incidence": "加入入射角余弦",
    "with_cos_incidence_leave_one_panel_out": "加入入射角余弦，逐板留出",
    "mean_difference": "平均差值",
    "wavelength_nm": "波长 [nm]",
    "design_heights_m": "设计航高 [m]",
    "observations": "观测数",
    "returns_used": "采用的回波数",
    "panels": "各参考板",
    "surfaces": "各航高的曲面",
    "value_on_what_is_there": "按现有数据的数值",
    "worst_channel": "最大的波段",
    "sd_dn": "SD [DN]",
    "mean_dn": "均值 [DN]",
    "channels": "各波段",
    "value": "数值",
    "trend_percent_per_h": "趋势 [%/h]",
    "trend_std_percent_per_h": "趋势标准差 [%/h]",
    "trend_p_value": "趋势 p 值",
    "trend_significant": "趋势显著",
    "photon_noise_percent": "光子噪声 [%]",
    "photon_noise_share": "光子噪声占比",
    "first_third_percent": "前三分之一偏差 [%]",
    "first_third_std_percent": "前三分之一偏差的标准差 [%]",
    "settled": "已稳定",
    "since_lamp_on_s": "开灯后时间 [s]",
    "warm_up_complete": "预热完成",
    "camera_temperature_c": "相机温度 [°C]",
    "one_setting": "同一设置",
    "images_used": "采用影像数",
    "linear_pixels": "线性像素",
    "left_out": "未采用",
    "duration_s": "时长 [s]",
    "saturated_share": "饱和像素占比",
    "black_level_dn": "黑电平 [DN]",
    "black_level_source": "黑电平来源",
    "band": "波段",
    "bands": "各波段",
    "red": "红",
    "green": "绿",
    "blue": "蓝",
    "reflectance_correlation": "反射率相关性",
    "reflectance_rmse_relative": "反射率相对中误差",
    "camera_rmse": "相机反射率中误差",
    "camera_leave_one_panel_out": "相机，逐板留出",
    "lidar_leave_one_panel_out": "激光雷达，逐板留出",
    "images": "影像数",
    "uneven_panels": "光谱不平坦的参考板",
    "per_sortie_px": "各架次 [px]",
    "all_strips_px": "跨航线（全部航线）[px]",
    "held_out_px": "留出靶标（k 折）[px]",
    "held_out_folds": "折数",
    "held_out_per_target_px": "各靶标，留出 [px]",
    "per_target_px": "各靶标 [px]",
    "marks": "标识观测数",
    "vertices": "顶点观测数",
    "rms_u_px": "u 方向均方根 [px]",
    "rms_v_px": "v 方向均方根 [px]",
    "rejected": "剔除",
    "single_instant": "单一时刻解",
    "p_m_px": "P_m [px]",
    "roll_pitch_yaw_deg": "横滚、俯仰、偏航 [°]",
    "translation_m": "平移 [m]",
    "interior_orientation": "内方位元素来源",
    "ranges": "测距",
    "scans": "扫描次数",
    "rmse_m": "测距中误差 m_j [m]",
    "additive_constant_m": "K₂ [m]",
    "additive_constant_std_m": "K₂ 标准差 [m]",
    "multiplication_constant": "R₂",
    "multiplication_constant_std": "R₂ 标准差",
    "estimates": "估值",
    "parameters": "参数",
    "names": "名称",
    "units": "单位",
    "std": "标准差",
    "stations": "全站仪",
    "correction": "改正用",
    "reference": "相对真值用",
    "image_size_px": "影像尺寸 [px]",
    "coverage_counts": "视场覆盖计数",
    "rms_px": "均方根 [px]",
    "distances_m": "距离 [m]",
    "before_correction_percent": "改正前 [%]",
    "mean_reference_m": "相对真值均值 [m]",
    "chi_square": "χ²",
    "chi_square_freedom": "自由度",
    "chi_square_p": "p 值",
    "focus_distance_m": "对焦距离 [m]",
    "sigma0": "单位权中误差",
    "redundancy": "多余观测",
}
_STRIPS = (
    (re.compile(r"^opposite heading$"), "对向航线"),
    (re.compile(r"^perpendicular heading$"), "垂直航向的航线"),
    (re.compile(r"^another height \((.+) m\)$"), r"另一航高（\1 m）"),
    (re.compile(r"^another speed \((.+) m/s\)$"), r"另一速度（\1 m/s）"),
)
_METHODS = (
    (re.compile(r"^bootstrap over images, (\d+) fixed draws.*$"), r"对影像自助法重采样 \1 次（标定结果固定）"),
    (
        re.compile(r"^propagation of the covariance of the corrected ranges.*$"),
        "由改正后测距与相对真值的协方差（扫描与读数离散、证书、归心元素、K₂ 和 R₂）传播至 m_j，正态分布",
    ),
    (re.compile(r"^bootstrap over (\d+) panels, (\d+) resamples$"), r"对 \1 块参考板自助法重采样 \2 次"),
    (re.compile(r"^bootstrap over targets and strips, (\d+) draws$"), r"对靶标与航线自助法重采样 \1 次"),
    (
        re.compile(r"^chi-square with n - 1 degrees of freedom for the worst channel.*$"),
        "最大波段的 χ² 分布（自由度 n − 1，各影像偏差视为独立正态）；标准差 = 数值 / √(2(n − 1))",
    ),
)


def parameter(name: str, language: Language) -> str:
    """A parameter's or figure's code name in words."""
    if language == "zh":
        found = _MOUNTING.fullmatch(name)
        if found:
            sensor, kind, axis = found.groups()
            if kind is None and sensor != "camera_from_lidar":
                return name.replace("_", " ")
            return " ".join(p for p in (_SENSORS[sensor], _KINDS.get(kind or "", ""), _AXES[axis]) if p)
        if name in _WORDS:
            return _WORDS[name]
        if name.startswith("camera_"):
            return f"相机 {name.removeprefix('camera_').removesuffix('_px')}"
    return name.replace("_", " ")


def strip(name: str, language: Language) -> str:
    """A strip that would help, as `helping_strip` names it."""
    return _translated(name, _STRIPS) if language == "zh" else name


def method(text: str, language: Language) -> str:
    """How an interval was computed; an unknown way stays English."""
    return _translated(text, _METHODS) if language == "zh" else text


def short(name: str, language: Language) -> str:
    """A mounting parameter for the axes of a matrix: sensor and axis, which say enough there."""
    found = _MOUNTING.fullmatch(name)
    if not found:
        return parameter(name, language)
    sensor, _, axis = found.groups()
    if sensor in ("camera_from_lidar", "boards_camera"):
        return _AXES[axis] if language == "zh" else axis
    return f"{_SENSORS[sensor]} {_AXES[axis]}" if language == "zh" else f"{sensor} {axis}"


def _translated(text: str, table: tuple[tuple[re.Pattern[str], str], ...]) -> str:
    for pattern, words in table:
        found = pattern.match(text)
        if found:
            return found.expand(words)
    return text
