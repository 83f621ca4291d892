"""6.3: the room of the indoor benches, the integrating sphere's class, the chessboard's size and images."""

import re

from evaluator.benches.bench_model import ChessboardResult
from evaluator.conformity.model import ConformityInputs, Row, Status, missing, passed, row
from evaluator.model import CampaignData

_SPHERE_CLASS = 3
_IMAGES = 20
_BOARD_M = (0.20, 0.25)
_WORDS = {
    "first": 1,
    "second": 2,
    "third": 3,
    "fourth": 4,
    "fifth": 5,
    "一级": 1,
    "二级": 2,
    "三级": 3,
    "四级": 4,
    "五级": 5,
    "primary": 0,
    "national": 0,
    "基准": 0,
}
_NUMBERED = re.compile(r"(?:class|level|grade)\s*(\d)|(\d)(?:st|nd|rd|th|\s*级)", re.IGNORECASE)


def has_sphere(data: CampaignData) -> bool:
    """Whether the campaign holds a series at the integrating sphere, readable or not."""
    bench, folder = data.bench, data.folder
    return bool(
        bench.stability
        or bench.repeatability
        or folder.sphere_stability.is_dir()
        or folder.sphere_repeatability.is_dir()
    )


def has_chessboard(data: CampaignData) -> bool:
    """Whether the campaign holds a chessboard series, readable or not."""
    return bool(data.bench.board_log or data.bench.board or data.folder.chessboard.is_dir())


def traceability_class(statement: str) -> int | None:
    """Class of an integrating sphere from the words of its statement; None where they name none. 0: a primary standard.

    The lowest class that is named counts: "third class, compared with a first class standard" is 3.
    """
    text = statement.lower()
    found = [number for word, number in _WORDS.items() if word in text]
    found += [int(a or b) for a, b in _NUMBERED.findall(text)]
    return max(found) if found else None


def sphere_row(clause: str, data: CampaignData) -> Row:
    """The sphere's class: by bench/room.json, else by the plan's instruments."""
    requirement, limit = "integrating sphere", "traceable, third class or better"
    stated = data.bench.room.sphere_traceability if data.bench.room else None
    if not stated and data.plan:
        stated = data.plan.instruments.get("integrating_sphere")
    if not stated:
        return missing(clause, requirement, limit, "sphere_traceability in bench/room.json")
    number = traceability_class(stated)
    if number is None:
        return row(clause, requirement, f"{stated} (names no class)", limit, "warning")
    return row(clause, requirement, stated, limit, passed(number <= _SPHERE_CLASS))


def _yes(clause: str, requirement: str, stated: bool | None, key: str) -> Row:
    if stated is None:
        return missing(clause, requirement, "required", f"{key} in bench/room.json")
    return row(clause, requirement, "yes" if stated else "no", "required", passed(stated))


def _room(prefix: str, data: CampaignData) -> list[Row]:
    """a to e, the same for both benches."""
    room = data.bench.room
    air = (
        ("c", "temperature", "temperature_c", 15.0, 25.0, "°C", "20 °C ± 5 °C", 1.0),
        ("d", "relative humidity", "relative_humidity_percent", 50.0, 70.0, "%", "50 % to 70 %", 1.0),
        ("e", "air pressure", "pressure_hpa", 86.0, 106.0, "kPa", "86 kPa to 106 kPa", 0.1),
    )
    rows = [
        _yes(f"{prefix} a", "indoors, free of dust", room.dust_free if room else None, "dust_free"),
        _yes(
            f"{prefix} b",
            "a single light source, no stray light",
            room.single_light_source if room else None,
            "single_light_source",
        ),
    ]
    for letter, name, key, low, high, unit, limit, scale in air:
        value = getattr(room, key) if room else None
        if value is None:
            rows.append(missing(f"{prefix} {letter}", name, limit, f"{key} in bench/room.json"))
            continue
        shown = value * scale
        rows.append(row(f"{prefix} {letter}", name, f"{shown:.1f} {unit}", limit, passed(low <= shown <= high)))
    return rows


def _boards_found(result: ChessboardResult) -> int:
    """Images with the board in them, whether or not the calibration could be made or accepted them."""
    named = result.indicator.companions.get("boards_found")
    return len(named) if isinstance(named, list) else len(result.images)


def _board(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    board, result = data.bench.board, measured.chessboard
    taken = len(data.bench.board_log)
    found = _boards_found(result) if result else None
    sharp, size = "board's material gives sharp images", "size of the chessboard"
    limit = "at least 20 cm × 25 cm"
    rows = []
    material = board.material if board else ""
    if found is None or not taken:
        rows.append(
            missing("6.3.2 f", sharp, "board found in most images", "image of the chessboard that was searched")
        )
    else:
        text = f"{material or 'material not stated'}; board found in {found} of {taken} images"
        status: Status = passed(found > 0) if found == 0 or 2 * found >= taken else "warning"
        rows.append(row("6.3.2 f", sharp, text, "board found in most images", status))
    if board is None:
        rows.append(missing("6.3.2 g", size, limit, "bench/chessboard/board.json"))
    else:
        pattern = (board.inner_columns + 1) * board.square_m, (board.inner_rows + 1) * board.square_m
        whole = board.width_m or pattern[0], board.height_m or pattern[1]
        short, long = sorted(whole)
        text = f"{whole[0] * 100:.1f} cm × {whole[1] * 100:.1f} cm"
        text += "" if board.width_m and board.height_m else " (squares only)"
        rows.append(row("6.3.2 g", size, text, limit, passed(short >= _BOARD_M[0] and long >= _BOARD_M[1])))
    return [*rows, board_images("6.3.2 h", data, measured)]


def board_images(clause: str, data: CampaignData, measured: ConformityInputs) -> Row:
    """How many images the geometric calibration is made of: the accepted ones where it was made, else those in the log."""
    requirement, limit = "images for the lens' distortion", "≥ 20"
    taken, result = len(data.bench.board_log), measured.chessboard
    if result is None and not taken:
        return missing(clause, requirement, limit, "bench/chessboard/log.csv")
    if result is None:
        return row(clause, requirement, f"{taken} taken", limit, passed(taken >= _IMAGES))
    used = len(result.images)
    return row(clause, requirement, f"{used} used of {max(taken, used)} taken", limit, passed(used >= _IMAGES))


def clause_6_3(data: CampaignData, measured: ConformityInputs) -> list[Row]:
    """Rows of 6.3; one row for each bench that the campaign does not have."""
    rows: list[Row] = []
    requirement, limit = "room and facilities of the radiometric bench", "6.3.1 a to f"
    if has_sphere(data):
        rows += [*_room("6.3.1", data), sphere_row("6.3.1 f", data)]
    else:
        rows.append(row("6.3.1", requirement, "no integrating sphere in this campaign", limit, "not_applicable"))
    requirement, limit = "room and facilities of the geometric bench", "6.3.2 a to h"
    if has_chessboard(data):
        rows += [*_room("6.3.2", data), *_board(data, measured)]
    else:
        rows.append(row("6.3.2", requirement, "no chessboard in this campaign", limit, "not_applicable"))
    return rows
