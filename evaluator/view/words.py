"""Every text of the page in both languages. No data of a campaign."""

from typing import Literal

Language = Literal["zh", "en"]

_WORDS: dict[str, tuple[str, str]] = {
    "title": ("三维视图", "3D view"),
    "synthetic": (
        "虚拟检测场仿真数据，未检测任何实物仪器。",
        "Synthetic data of a virtual range; no instrument was tested.",
    ),
    "no_webgl": (
        "此浏览器不支持 WebGL2，无法显示三维场景；请更换较新的浏览器或启用硬件加速。左侧列表仍可查阅。",
        "This browser has no WebGL2, so the scene cannot be drawn. Use a recent browser or turn on hardware acceleration. "
        "The list can still be read.",
    ),
    "no_script": ("本页需要 JavaScript。", "This page needs JavaScript."),
    "empty": (
        "本次检测没有可显示的三维数据（无靶标、航迹或点云）。",
        "This campaign holds nothing to show in 3D: no targets, no trajectory, no point cloud.",
    ),
    "menu": ("目录与图层", "List and layers"),
    "close": ("关闭", "Close"),
    "display": ("显示", "Display"),
    "colour": ("点云着色", "Colour points by"),
    "reflectance": ("反射率", "Reflectance"),
    "reflectance_device": ("反射率（仪器标度）", "Reflectance (device's scale)"),
    "reflectance_panels": ("反射率（按标准反射靶标标称值）", "Reflectance (scaled by the panels)"),
    "height": ("高程", "Height"),
    "sortie": ("架次", "Sortie"),
    "strip": ("航线", "Strip"),
    "error": ("与真值之差", "Error against truth"),
    "unknown": ("无值", "no value"),
    "cloud": ("点云坐标", "Point coordinates"),
    "adjusted": ("检校后", "Calibrated"),
    "delivered": ("交付时（标称安置）", "As delivered"),
    "size": ("点大小", "Point size"),
    "layers": ("图层", "Layers"),
    "terrain": ("地形", "Terrain"),
    "targets": ("靶标", "Targets"),
    "points": ("点云", "Point cloud"),
    "trajectory": ("航迹", "Trajectory"),
    "cameras": ("相机位姿", "Camera poses"),
    "labels": ("编号", "Labels"),
    "search": ("搜索靶标或影像", "Search targets and images"),
    "nothing_found": ("没有匹配项", "Nothing found"),
    "images": ("影像", "Images"),
    "home": ("靶标区", "Range"),
    "whole": ("含航线", "With flight"),
    "top": ("俯视", "From above"),
    "help": (
        "左键或单指旋转，右键或双指平移，滚轮或捏合缩放；点击靶标、点或相机查看数据。"
        "键盘：方向键旋转，Shift+方向键平移，+ − 缩放，0 靶标区。",
        "Drag or one finger: turn. Right button or two fingers: move. Wheel or pinch: zoom. Click a target, a point or a "
        "camera for its data. Keys: arrows turn, Shift+arrows move, + − zoom, 0 the range.",
    ),
    "notes": ("说明", "Notes"),
    "canvas": ("三维场景", "3D scene"),
    "point": ("激光点", "LiDAR point"),
    "panel": ("标准反射靶标", "Reflectance panel"),
    "frustum": ("梯形棱台靶标", "Frustum target"),
    "board": ("2×2 标定板", "2×2 board"),
    "image": ("影像", "Image"),
    "easting": ("东坐标 Y", "Easting"),
    "northing": ("北坐标 X", "Northing"),
    "normal_height": ("正常高 H", "Normal height"),
    "azimuth": ("坐标方位角", "Grid azimuth"),
    "edge": ("边长", "Edge"),
    "style": ("样式", "Style"),
    "inverted": ("倒置", "inverted"),
    "upright": ("正置", "upright"),
    "nominal": ("标称反射率", "Nominal reflectance"),
    "lidar_reflectance": ("激光雷达反射率", "Reflectance by LiDAR"),
    "camera_reflectance": ("相机反射率", "Reflectance by camera"),
    "reference": ("光谱仪", "spectrometer"),
    "p_i": ("标定误差 Pᵢ", "Calibration error Pᵢ"),
    "images_used": ("参与影像数", "Images used"),
    "board_residual": ("残差中误差", "RMS residual"),
    "not_found": ("未测", "Not measured"),
    "doubt": ("测量坐标存疑", "Surveyed place in doubt"),
    "time": ("曝光时刻（北京时间）", "Exposure (Beijing time)"),
    "centre_height": ("摄影中心高程", "Height of the projection centre"),
    "pose_by": ("位姿", "Pose"),
    "by_adjustment": ("平差后安置参数", "adjusted mounting"),
    "by_drawing": ("标称安置参数", "nominal mounting"),
    "surveyed": ("测量值", "surveyed"),
    "shown_of": ("显示 {shown} 点，共 {total} 点", "{shown} of {total} points shown"),
    "scale_note": (
        "靶标按测量坐标绘制；点云按所选坐标显示，靶标处保留较密的点，其余均匀抽稀。坐标为投影坐标与 1985 国家高程基准的正常高。",
        "Targets stand at their surveyed places. Points are denser on targets and evenly thinned elsewhere. Coordinates are those "
        "of the projection, heights are normal heights.",
    ),
    "error_note": (
        "误差指各点与仿真真值的空间距离。",
        "An error is the distance of a point from where its pulse truly met a surface.",
    ),
}


def words(language: Language) -> dict[str, str]:
    """Every text of the page in one language."""
    return {key: pair[0 if language == "zh" else 1] for key, pair in _WORDS.items()}
