"""Chinese letters for a page that an archive keeps: cut from the packaged Noto Sans SC, so that any machine shows them."""

import base64
import io
from functools import lru_cache

import pylopdf_fonts_zh_cn
from fontTools import subset  # type: ignore[import-untyped]
from fontTools.ttLib import TTFont  # type: ignore[import-untyped]

_FIRST_CJK = 0x2E80  # radicals, punctuation and letters of Chinese stand from here


def font_face(text: str, family: str) -> str:
    """A CSS rule that holds a font with the Chinese letters of `text`; the same letters give the same bytes."""
    coded = _cut(frozenset(ord(c) for c in text if ord(c) >= _FIRST_CJK))
    source = f"url(data:font/woff;base64,{coded}) format('woff')"
    return f"@font-face{{font-family:'{family}';unicode-range:U+{_FIRST_CJK:X}-10FFFF;src:{source}}}"


@lru_cache(maxsize=8)
def _cut(letters: frozenset[int]) -> str:
    """A WOFF file in base 64."""
    unused = ["GSUB", "GPOS", "GDEF", "BASE", "VORG", "vhea", "vmtx", "DSIG"]  # of vertical text and fine typography
    options = subset.Options(layout_features=[], notdef_outline=True, hinting=False, drop_tables=unused)
    cutter = subset.Subsetter(options)
    cutter.populate(unicodes=sorted(letters))
    buffer = io.BytesIO()
    with TTFont(str(pylopdf_fonts_zh_cn.sans_path()), lazy=True, recalcTimestamp=False) as font:
        cutter.subset(font)
        font.flavor = "woff"
        font.save(buffer)
    return base64.b64encode(buffer.getvalue()).decode()
