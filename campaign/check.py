"""Every problem of a campaign folder at once."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One line: severity "error" stops an evaluation of that part, "warning" does not."""

    severity: str
    where: str
    message: str


def check_campaign(root: Path, *, checksums: bool = True) -> list[Problem]:
    """Validates layout, every file's format and cross references (images named in exposures exist and have the sheet's size,
    packets lie inside .wdp, spectra cover the panels ...). An empty list: sound."""
    raise NotImplementedError
