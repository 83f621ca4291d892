"""Errors that a user reads: one line that says what, where, got, expected and the remedy. No traceback is shown for them."""

from collections.abc import Sequence


class TestrangeError(Exception):
    """Base of every error that is the input's fault; the command line prints it as one line and exits with 1.

    Parameters
    ----------
    what : str
        What is wrong, a short clause.
    where : str, optional
        The file, key or record.
    got, expected : object, optional
        The value found, and what would be right.
    remedy : str, optional
        What the user can do.
    problems : sequence of str, optional
        Every problem, one line each, where one reading found several; the text names the first and counts the rest.
    """

    __test__ = False  # the name starts with "Test"; pytest must not collect it

    def __init__(
        self,
        what: str,
        *,
        where: str | None = None,
        got: object = None,
        expected: object = None,
        remedy: str | None = None,
        problems: Sequence[str] = (),
    ) -> None:
        parts = [f"{where}: {what}" if where else what]
        if got is not None:
            parts.append(f"got {got}")
        if expected is not None:
            parts.append(f"expected {expected}")
        if remedy:
            parts.append(remedy)
        super().__init__(" ".join("; ".join(parts).split()))
        self.what = what
        self.where = where
        self.problems = tuple(problems) or (str(self),)


class ConfigError(TestrangeError):
    """A configuration file or a --set value is wrong."""


class CampaignError(TestrangeError):
    """A campaign folder, or one of its files, is missing something or is not what it says."""


class WriteError(CampaignError):
    """The disk is full or does not let us write: nothing is wrong with the input, and the same command may succeed later."""
