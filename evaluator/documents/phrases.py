"""Words that the evaluator writes in English, in the language of a document; dates; what stands where nothing was recorded."""

import datetime

from evaluator.documents.model import Language, say

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
    """An ISO time as Beijing time, to the minute; one that cannot be read stands as it is."""
    try:
        at = datetime.datetime.fromisoformat(time)
    except ValueError:
        return time
    if at.tzinfo is not None:
        at = at.astimezone(datetime.timezone(datetime.timedelta(hours=8)))
    return say(
        language,
        f"{at.year}年{at.month}月{at.day}日 {at:%H:%M}（北京时间）",
        f"{at.day} {at.strftime('%B')} {at.year}, {at:%H:%M} Beijing time",
    )


def translated(text: str, language: Language) -> str:
    """A text of the evaluator in the document's language; one that is not known stays as it is."""
    return text
