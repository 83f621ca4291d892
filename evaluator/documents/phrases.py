"""Words that the evaluator writes in English, in the language of a document; dates; what stands where nothing was recorded."""

import datetime
import re
from functools import cache

from evaluator.documents.model import Language, say
from evaluator.documents.phrase_table import PHRASES

STATUS: dict[str, tuple[str, str]] = {
    "pass": ("符合", "pass"),
    "warning": ("注意", "warning"),
    "fail": ("不符合", "fail"),
    "not_recorded": ("未记录", "not recorded"),
    "not_applicable": ("不适用", "not applicable"),
}


def not_stated(language: Language) -> str:
    """Where the campaign records nothing."""
    return say(language, "未记录", "not recorded")


def day_in_words(date: str, language: Language) -> str:
    """2026年9月25日, 25 September 2026; a date that cannot be read stands as it is."""
    try:
        day = datetime.date.fromisoformat(date[:10])
    except ValueError:
        return date
    return say(language, f"{day.year}年{day.month}月{day.day}日", f"{day.day} {day.strftime('%B')} {day.year}")


def time_in_words(time: str, language: Language) -> str:
    """An ISO time as Beijing time, to the minute, or to the second that is stated; one that cannot be read stands as it is."""
    try:
        at = datetime.datetime.fromisoformat(time)
    except ValueError:
        return time
    if at.tzinfo is not None:
        at = at.astimezone(datetime.timezone(datetime.timedelta(hours=8)))
    clock = f"{at:%H:%M:%S}" if at.second else f"{at:%H:%M}"
    return say(
        language,
        f"{at.year}年{at.month}月{at.day}日 {clock}（北京时间）",
        f"{at.day} {at.strftime('%B')} {at.year}, {clock} Beijing time",
    )


_BETWEEN = re.compile("(?<=[\u4e00-\u9fff]) (?=[\u4e00-\u9fff])")  # a blank that a part in Chinese made needless
_LONGEST = 400  # characters of a text that is looked up
_DEPTH = 3  # phrases within phrases


@cache
def _phrases() -> tuple[dict[str, str], tuple[tuple[re.Pattern[str], str], ...]]:
    """Whole phrases, and those with places to fill."""
    whole: dict[str, str] = {}
    filled: list[tuple[int, re.Pattern[str], str]] = []
    for line in PHRASES.splitlines():
        if not line or line.startswith("#"):
            continue
        english, chinese = line.split(" => ")
        parts = re.split(r"%(\d)", english)
        if len(parts) == 1:
            whole[english] = chinese
            continue
        pattern = "".join(re.escape(p) if k % 2 == 0 else f"(?P<p{p}>[^;]+?)" for k, p in enumerate(parts))
        literal = len("".join(parts[::2]))  # what says most is tried first
        filled.append((-literal, re.compile(pattern), re.sub(r"%(\d)", r"{p\1}", chinese)))
    return whole, tuple((pattern, words) for _, pattern, words in sorted(filled, key=lambda f: f[0]))


def _chinese(text: str, depth: int) -> str:
    """One phrase; itself where it is not known."""
    whole, filled = _phrases()
    if text in whole or not depth:
        return whole.get(text, text)
    for pattern, words in filled:
        found = pattern.fullmatch(text)
        if found:
            return words.format(**{k: _chinese(v, depth - 1) for k, v in found.groupdict().items()})
    if "; " in text:
        return "；".join(_chinese(part, depth) for part in text.split("; "))
    return text


def translated(text: str, language: Language) -> str:
    """A text of the evaluator in the document's language; one that is not known stays as it is."""
    if language == "en" or len(text) > _LONGEST or not text.isprintable():
        return text
    return _BETWEEN.sub("", _chinese(text, _DEPTH))
