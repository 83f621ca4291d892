"""Numbers of the national 1:10 000 map sheets, and what each covers. Northern and eastern hemisphere, where those sheets are."""

import math
import re
from dataclasses import dataclass

_ROW_DEG, _COLUMN_DEG = 2.5 / 60.0, 3.75 / 60.0  # 2'30" of latitude, 3'45" of longitude
_MILLION_ROW_DEG, _MILLION_COLUMN_DEG = 4.0, 6.0
_SIDE = 96  # sheets along each side of a 1:1 000 000 sheet
_LAST_LATITUDE_DEG = 60.0  # beyond, 1:1 000 000 sheets are wider
_NUMBER = re.compile(r"([A-O])(\d{2})G(\d{3})(\d{3})")


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """One 1:10 000 sheet: its number and its edges. [deg]"""

    number: str
    south_deg: float
    west_deg: float

    @property
    def north_deg(self) -> float:
        return self.south_deg + _ROW_DEG

    @property
    def east_deg(self) -> float:
        return self.west_deg + _COLUMN_DEG


def sheet_at(latitude_deg: float, longitude_deg: float) -> Sheet | None:
    """The 1:10 000 sheet that holds a place; None where there is no such sheet. A place on an edge: the north-eastern one.

    Parameters
    ----------
    latitude_deg : float
        0 up to 60, CGCS2000. [deg]
    longitude_deg : float
        0 up to 180. [deg]

    References
    ----------
    GB/T 13989-2012: a 1:1 000 000 sheet is a row of 4 degrees, lettered from the equator, and a column of 6 degrees, numbered
    from 180 degrees west; 96 by 96 sheets of 1:10 000 (code G) divide it, rows counted from its north, columns from its west.
    """
    inside = 0.0 <= latitude_deg < _LAST_LATITUDE_DEG and 0.0 <= longitude_deg < 180.0
    if not inside:
        return None
    # Counted in whole sheets: 39.375 / (2.5 / 60) must be 945, not 944.99999.
    row = math.floor(round(latitude_deg / _ROW_DEG, 9))
    column = math.floor(round(longitude_deg / _COLUMN_DEG, 9))
    letter = chr(ord("A") + row // _SIDE)
    return Sheet(
        number=f"{letter}{column // _SIDE + 31:02d}G{_SIDE - row % _SIDE:03d}{column % _SIDE + 1:03d}",
        south_deg=row * _ROW_DEG,
        west_deg=column * _COLUMN_DEG,
    )


def sheet_of(number: str) -> Sheet | None:
    """The sheet of a number; None where it is no number of a 1:10 000 sheet."""
    found = _NUMBER.fullmatch(number.strip())
    if not found:
        return None
    letter, million, row, column = found[1], int(found[2]), int(found[3]), int(found[4])
    if not (31 <= million <= 60 and 1 <= row <= _SIDE and 1 <= column <= _SIDE):
        return None
    south = (ord(letter) - ord("A")) * _MILLION_ROW_DEG + (_SIDE - row) * _ROW_DEG
    west = (million - 31) * _MILLION_COLUMN_DEG + (column - 1) * _COLUMN_DEG
    return Sheet(number=number.strip(), south_deg=south, west_deg=west)


def degrees_minutes_seconds(angle_deg: float, decimals: int = 2) -> str:
    """31.283 as 31°16′58.80″; seconds that round to 60 carry over."""
    total = round(abs(angle_deg) * 3600.0, decimals)
    minutes, seconds = divmod(total, 60.0)
    degrees, minutes = divmod(int(minutes), 60)
    width = decimals + 3 if decimals else 2
    sign = "−" if angle_deg < 0.0 else ""
    return f"{sign}{degrees}°{minutes:02d}′{seconds:0{width}.{decimals}f}″"
