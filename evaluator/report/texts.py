"""Every word of the report in Chinese and English: one table, looked up by key. Names of parameters: `terms`; conformity rows
and reasons: `documents.phrases`.

No markup and no number stands in here; `{name}` is filled in by the caller.
"""

from dataclasses import dataclass

from evaluator.documents.model import Language
from evaluator.report.plot_texts import PLOT_TABLE

TABLE: dict[str, tuple[str, str]] = PLOT_TABLE | {
    # head
    "title": ("多传感器一致性检测报告", "Multi-sensor consistency test"),
    "campaign": ("检测", "campaign"),
    "height": ("高程", "height"),
    "begun": ("记录始于", "records begin"),
    "synthetic": (
        "虚拟检测场仿真数据。影像、点云和波形均由计算得到，未检测任何实物仪器。",
        "Synthetic data of a virtual range. Images, point clouds and waveforms were computed; no instrument was tested.",
    ),
    "foreign": (
        "本次计算使用了替换算法，下列步骤不是由本评价程序自己的算法完成的：",
        "Replaced algorithms: these steps were not done by the evaluator's own:",
    ),
    "synthetic_short": ("虚拟检测场仿真数据", "synthetic data of a virtual range"),
    "level_flight": ("，含首条航线前的飞行", ", some seconds before the first strip"),
    "footer": (
        "评价依据 GB/T 41450-2022 第 10.1 条表 3；边界值归入较高等级，按未修约值评级。全部数值见 results.json。",
        "Grades: GB/T 41450-2022, 10.1, table 3; boundaries belong to the better grade, values are graded unrounded. All "
        "figures stand in results.json.",
    ),
    "stop": ("。", ". "),
    "comma": ("、", ", "),
    "colon": ("：", ": "),
    "enlarge": ("点击放大，再次点击还原", "click to enlarge, click again to go back"),
    # navigation and headings
    "nav": ("目录", "Contents"),
    "h_summary": ("检测结果", "Indicators and grades"),
    "h_groups": ("一致性程度评价", "Grades of the groups"),
    "h_data": ("检测数据", "What the campaign holds"),
    "h_not_measured": ("未测内容", "What was not measured"),
    "h_flight": ("布设与飞行", "Layout and flight"),
    "h_indicators": ("各指标的计算", "How each indicator was calculated"),
    "h_images": ("影像与靶标", "Images and targets"),
    "h_mounting": ("安置参数", "Mounting"),
    "h_diagnosis": ("偏差诊断", "Deviations from what was stated"),
    "h_truth": ("真值与估计值", "Truth against estimate"),
    "h_conformity": ("符合性（第 5～9 章）", "Conformity, clauses 5 to 9"),
    "h_problems": ("未能读取的内容", "Parts that could not be read"),
    # summary
    "level_excellent": ("优", "excellent"),
    "level_good": ("良", "good"),
    "level_fair": ("一般", "fair"),
    "level_ungraded": ("超出评价范围", "ungraded"),
    "level_not_measured": ("未测", "not measured"),
    "clause": ("条款", "clause"),
    "interval_95": ("95 % 区间", "95 %"),
    "to": ("～", "to"),
    "group": ("一致性类型", "group"),
    "grade": ("等级", "grade"),
    "indicators_of": ("指标", "indicators"),
    "starred": (
        "* 取该类各指标中的较低等级（表 3）；有一项未测则不评级。",
        "* graded by the lower of its indicators (table 3); not graded while one of them is not measured.",
    ),
    "measured_count": ("8 项指标中已测 {n} 项。", "{n} of 8 indicators were measured."),
    "reason": ("原因", "reason"),
    "needs": ("所需数据", "needs"),
    # data
    "part": ("内容", "part"),
    "holds": ("本次检测", "in this campaign"),
    "absent": ("无", "none"),
    "d_instruments": ("仪器", "instruments"),
    "d_sorties": ("飞行架次", "sorties"),
    "d_sorties_v": ("{sorties} 架次，{strips} 条航线", "{sorties} sorties, {strips} strips"),
    "d_images": ("影像", "images"),
    "d_images_v": ("{n} 张", "{n}"),
    "d_targets": ("地面靶标", "targets"),
    "d_targets_v": (
        "梯形棱台 {frustum} 个，标准反射靶标 {panel} 个，2×2 标定板 {board} 块",
        "{frustum} frustums, {panel} reference panels, {board} 2×2 boards",
    ),
    "d_sphere": ("积分球影像", "integrating sphere images"),
    "d_sphere_v": ("稳定性 {a} 张，重复性 {b} 张", "{a} for stability, {b} for repeatability"),
    "d_board": ("棋盘格影像", "chessboard images"),
    "d_ranging": ("测距基线", "ranging line"),
    "d_ranging_v": ("扫描 {scans} 次，全站仪读数 {readings} 个", "{scans} scans, {readings} total station readings"),
    "d_plan": ("飞行计划", "flight plan"),
    "d_plan_v": ("有，{n} 条航线", "{n} strips"),
    # indicator sections
    "formula": ("公式", "formula"),
    "value_unrounded": ("未修约值", "value, unrounded"),
    "sample_size": ("样本数", "sample size"),
    "std": ("标准差", "standard deviation"),
    "by": ("不确定度算法", "uncertainty by"),
    "from_data": ("所用数据", "from"),
    "bounds": ("等级限值", "bounds of the grades"),
    "companions": ("相关数值", "figures beside it"),
    "entries": ("{n} 项，见 results.json", "{n} entries, in results.json"),
    "not_measured": ("未测", "not measured"),
    "found_nevertheless": ("已有数值", "what was found nevertheless"),
    "yes": ("是", "yes"),
    "no": ("否", "no"),
    "no_picture": ("无图", "No picture"),
    "nothing_observed": ("没有相应的观测值", "nothing was observed for it"),
    # tables
    "parameter": ("参数", "parameter"),
    "unit": ("单位", "unit"),
    "estimate": ("估计值", "estimate"),
    "std_short": ("标准差", "std"),
    "prior_std": ("先验标准差", "prior std"),
    "determined": ("能否确定", "determined?"),
    "determined_yes": ("可确定", "yes"),
    "not_determined": ("不能确定", "not determined"),
    "correlated_with": ("与{other}的相关系数 ρ = {rho}", "ρ = {rho} with {other}"),
    "weak_prior": ("标准差大于先验的一半", "std above half its prior"),
    "weak_datum": (
        "所飞航向不能将其与全部标定板的整体平移分开",
        "not parted from a shift of all boards by the headings flown",
    ),
    "helping_strip": ("可加飞：{strip}，标准差将为 {std}", "a strip that would help: {strip}, std then {std}"),
    "status": ("结论", "status"),
    "status_pass": ("符合", "pass"),
    "status_fail": ("不符合", "fail"),
    "status_warning": ("注意", "warning"),
    "status_not_recorded": ("未记录", "not recorded"),
    "status_not_applicable": ("不适用", "not applicable"),
    "requirement": ("要求", "requirement"),
    "measured": ("实测", "measured"),
    "beside_limit": ("（限值：{limit}）", " (limit: {limit})"),
    "limit": ("限值", "limit"),
    "no_conformity": ("没有符合性记录。", "No conformity rows were made."),
    # images
    "images_intro": (
        "每张影像一图。黄色：检测到的标识中心（圆）及编号；红色十字：激光雷达棱面公共顶点按平差后的安置参数投影；蓝色："
        "标准反射靶标取样区；"
        "绿色：2×2 标定板中心（圆为检测值，十字为投影值）。其下为各靶标的放大图。",
        "One picture for every image. Yellow circle: centre of a mark as found. Red cross: vertex of the LiDAR's face planes, "
        "projected with the adjusted mounting. Blue: region of a reference panel. Green: centre of a 2×2 board (circle: "
        "as found, "
        "cross: projected). Below each its targets, enlarged.",
    ),
    "images_from_raw": (
        "缺预览图的影像由原始影像拉伸显示。",
        "Images without a preview are shown from their raw pixels, stretched.",
    ),
    "image_caption": (
        "架次 {sortie}，航线 {strip}：标识 {marks} 个，标准反射靶标 {panels} 个",
        "sortie {sortie}, strip {strip}: {marks} marks, {panels} panels",
    ),
    "image_boards": ("，标定板 {n} 块", ", {n} boards"),
    "image_error": ("，平均标定误差 {px} px", ", mean error {px} px"),
    "zooms": ("靶标放大图", "targets enlarged"),
    "image_empty": ("；其中没有用到的靶标", "; no target in it was used"),
    # mounting
    "mounting_intro": (
        "相对设计安置的改正数，相机与激光雷达联合平差。单位权中误差 {sigma0}，多余观测 {redundancy}，剔除观测 {rejected} 个。",
        "Against the nominal mounting; both sensors adjusted together. Standard deviation of unit weight {sigma0}, redundancy "
        "{redundancy}, {rejected} observations left out.",
    ),
    "rejected": ("剔除的观测值（{n}）", "Observations left out ({n})"),
    "h_stated_rows": ("平差所依据的给定值", "What the adjustment took as stated"),
    "stated_rows_note": (
        "镜头证书、测距常数和未估计的时钟由飞行观测值检验：偏离为真值减给定值；“可发现”为以 95 % 概率发现的最小偏离，"
        "“影响”为恰未发现时安置参数的移动（以其标准差计）。标出的给定值与观测值矛盾，上表的安置参数不可信。",
        "Lens certificate, range constants and clocks that are not estimated, tested by the flight's own observations. Shift: true "
        "minus stated; detectable: least shift found with 95 %; moves: what one that just escapes does to the mounting, in its "
        "standard deviations. Where a row is marked the observations contradict what is stated, and the mountings above "
        "are not to be trusted.",
    ),
    "stated_shift": ("偏离", "shift"),
    "stated_detectable": ("可发现", "detectable"),
    "stated_moves": ("影响", "moves"),
    "unit_weight_doubt": (
        "单位权中误差超出偶然误差所允许的范围：多个观测值共有的误差（首先是导航）大于给定值，上述标准差偏小。",
        "The standard deviation of unit weight is beyond what chance allows: what many observations share, the navigation "
        "before all, is worse than stated, and the standard deviations above are too small.",
    ),
    "stated_doubted": ("与观测值矛盾", "contradicted"),
    "h_three_ways": ("不同途径的结果", "By each way"),
    "three_ways_note": (
        "联合平差、单传感器平差（仅用该传感器的观测值）与 2×2 标定板法的估计值，括号内为标准差。",
        "The joint adjustment, each sensor alone (its own observations only) and the 2×2 boards; standard deviations "
        "in brackets.",
    ),
    "way_joint": ("联合平差", "joint"),
    "way_alone": ("单传感器", "alone"),
    "way_boards": ("2×2 标定板", "2×2 boards"),
    "h_closure": ("闭合差", "Closure"),
    "closure_intro": (
        "相机对机体、激光雷达对机体各自求得，合成后与联合求得的相机对激光雷达转换关系比较：",
        "Camera-body and LiDAR-body, each alone and composed, against the joint camera-LiDAR transform: they ",
    ),
    "closes": ("闭合", "agree"),
    "closes_not": ("不闭合", "do not agree"),
    "chi_square": (
        "χ² = {chi}，95 % 限值 {limit}（自由度 {freedom}）。",
        "χ² {chi}, 95 % limit {limit} ({freedom} degrees of freedom).",
    ),
    "composed": ("合成", "composed"),
    "joint": ("联合", "joint"),
    "difference": ("差值", "difference"),
    "half_width_95": ("95 % 半宽", "95 % half width"),
    "h_boards": ("2×2 标定板法（相机）", "Camera by 2×2 boards"),
    "boards_intro": (
        "{images} 张影像中 {observations} 个标定板中心，残差平均 {mean} px（各影像位姿自由时 {free} px）；单位权中误差 {sigma0}，"
        "多余观测 {redundancy}。",
        "{observations} board centres in {images} images, mean residual {mean} px ({free} px with each image's pose free); "
        "standard deviation of unit weight {sigma0}, redundancy {redundancy}.",
    ),
    "boards_count": (
        "半窗计数（整像素，按专利原文）：{observations} 个观测，与亚像素中心的离散 {spread} px，残差平均 {mean} px。",
        "Half-window count (whole pixels, as the patent has it): {observations} observations, spread against the sub-pixel "
        "centres "
        "{spread} px, mean residual {mean} px.",
    ),
    "by_subpixel": ("亚像素中心", "sub-pixel centres"),
    "by_count": ("半窗计数", "half-window count"),
    "boards_rejected": ("剔除的标定板（{n}）", "Boards left out ({n})"),
    "boards_swapped": ("测量成果中互换的标定板", "Boards swapped in the survey"),
    "boards_not_found": ("没有任何中心的标定板", "Boards without any centre"),
    "boards_count_left_out": ("计数偏离中心而未采用（{n}）", "Counts far from their centre, left out ({n})"),
    "boards_not_in_images": ("影像中未找到的标定板（{n}）", "Boards not found in images ({n})"),
    "h_clocks": ("时钟偏差", "Clocks"),
    "clocks_none": (
        "传感器与导航同步（rig.json 未给出时钟先验），未估计时钟偏差。",
        "The sensors are synchronised with navigation (rig.json gives no clock prior): no clock was estimated.",
    ),
    "clocks_note": (
        "时标减真时；以对向航线和两种速度与杆臂分离。",
        "Stamped minus true time; parted from the lever arm by opposite headings and two speeds.",
    ),
    "h_inseparable": ("难以分离的参数对", "Pairs that this flight can hardly part"),
    "inseparable_note": (
        "同一传感器内 |ρ| > 0.95：飞行不能区分两者；两传感器之间：源于共用的导航。",
        "Beyond |ρ| = 0.95 inside one sensor the flight does not tell the two apart; between the sensors it is the "
        "navigation that "
        "they share.",
    ),
    "between_sensors": ("两传感器之间", "between the sensors"),
    "inside_sensor": ("同一传感器", "inside one sensor"),
    "no_pairs": ("没有 |ρ| > 0.95 的参数对。", "No pair beyond |ρ| = 0.95."),
    # diagnosis
    "diagnosis_intro": (
        "估计值与设计安置、镜头证书、无误差测距和记录增益相比。|z| 超过 {limit} 判为偏差（全部 {n} 行共同的限值）。",
        "Estimates against the drawing, the lens certificate, a range without error and the logged gain. |z| beyond {limit} is a "
        "deviation (limit for all {n} rows together).",
    ),
    "deviating": ("{n} 个参数中 {k} 个有偏差", "{k} of {n} parameters deviate"),
    "nothing_deviates": ("没有参数偏离给定值。", "Nothing deviates from what was stated."),
    "survey_doubt": ("测量坐标存疑的靶标", "surveyed place in doubt"),
    "stated": ("给定值", "stated"),
    "found": ("实测值", "found"),
    "no_diagnosis": ("没有可与给定值比较的参数。", "No parameter could be compared with what was stated."),
    # truth
    "truth_intro": (
        "只有仿真检测才有真值。z = 误差 / 给出的标准差",
        "Only a simulated campaign knows the truth. z = error / stated standard deviation",
    ),
    "greatest_z": ("；最大 |z|：{z}", "; greatest |z|: {z}"),
    "quantity": ("量", "quantity"),
    "truth": ("真值", "truth"),
    "error": ("误差", "error"),
    # benches
    "lens_title": ("相机内方位元素与畸变参数", "Camera: interior orientation and distortion"),
    "lens_note": (
        "{n} 张影像，未用 {out} 张；影像左上角为 (0, 0)，第一个像素中心为 (0.5, 0.5)。{setting}",
        "{n} images, {out} not used; the image's top left corner is (0, 0), the centre of its first pixel (0.5, 0.5).{setting}",
    ),
    "lens_setting": ("镜头设置：{text}。", " Lens set to {text}."),
    "ranging_title": ("激光雷达测距常数", "LiDAR ranging constants"),
    "ranging_note": ("真值 = 测值 + K₂ + R₂ · 测值。", "true = measured + K₂ + R₂ · measured."),
    "left_out": ("未采用的检测影像与靶标（{n}）", "Images and panels of the benches that were not used ({n})"),
}


@dataclass(frozen=True)
class Texts:
    """The table in one language: `texts("h_summary")`."""

    language: Language

    def __call__(self, key: str, **values: object) -> str:
        """The text of a key with its `{names}` filled in; an unknown key is a KeyError."""
        text = self.pick(*TABLE[key])
        return text.format(**values) if values else text

    def pick(self, zh: str, en: str) -> str:
        """The one of the two."""
        return zh if self.language == "zh" else en
