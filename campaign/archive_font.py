"""Chinese letters for a page that an archive keeps: cut from the packaged Noto Sans SC, so that any machine shows them."""

import base64
import io

import pylopdf_fonts_zh_cn
from fontTools import subset  # type: ignore[import-untyped]
from fontTools.ttLib import TTFont  # type: ignore[import-untyped]

_FIRST_CJK = 0x2E80  # radicals, punctuation and letters of Chinese stand from here


def font_face(text: str, family: str) -> str:
    """A CSS rule that holds a font with the Chinese letters of `text`; the same letters give the same bytes."""
    letters = sorted({ord(c) for c in text if ord(c) >= _FIRST_CJK})
    font = TTFont(str(pylopdf_fonts_zh_cn.sans_path()), recalcTimestamp=False)
    cutter = subset.Subsetter(subset.Options(layout_features=[], notdef_outline=True, hinting=False))
    cutter.populate(unicodes=letters)
    cutter.subset(font)
    font.flavor = "woff"
    buffer = io.BytesIO()
    font.save(buffer)
    coded = base64.b64encode(buffer.getvalue()).decode()
    source = f"url(data:font/woff;base64,{coded}) format('woff')"
    return f"@font-face{{font-family:'{family}';unicode-range:U+{_FIRST_CJK:X}-10FFFF;src:{source}}}"
