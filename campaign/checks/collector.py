"""What a check collects: problems with the file they concern. What is checked stands in `check` and `check_bench`."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from campaign.errors import TestrangeError
from campaign.folder import CampaignFolder

T = TypeVar("T")
NOT_MEASURED = "missing; what needs it is reported as not measured"


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One line: severity "error" stops an evaluation of that part, "warning" does not."""

    severity: str
    where: str
    message: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}: {self.message}"


@dataclass(kw_only=False)
class Collector:
    """Collects problems; paths are shown relative to the campaign folder."""

    folder: CampaignFolder
    problems: list[Problem] = field(default_factory=list)

    def name(self, path: Path) -> str:
        return path.relative_to(self.folder.root).as_posix() if path.is_relative_to(self.folder.root) else str(path)

    def add(self, severity: str, path: Path, message: str) -> None:
        self.problems.append(Problem(severity=severity, where=self.name(path), message=message))

    @contextlib.contextmanager
    def catching(self, path: Path) -> Iterator[None]:
        try:
            yield
        except TestrangeError as error:
            for line in error.problems:
                other, _, rest = line.removeprefix(f"{self.folder.root}/").partition(": ")
                if rest and line.startswith(f"{self.folder.root}/") and not line.startswith(str(path)):
                    self.problems.append(Problem(severity="error", where=other, message=rest))
                    continue
                message = line.removeprefix(str(path)).lstrip(": ").replace(f"{self.folder.root}/", "")
                message = message.removeprefix(f"{self.folder.root}: ")
                self.add("error", path, message)

    def read(self, path: Path, reader: Callable[[Path], T]) -> T | None:
        with self.catching(path):
            return reader(path)
        return None

    def read_part(self, path: Path, reader: Callable[[Path], T], *, expected: bool = True) -> T | None:
        """A part that a campaign may lack; its absence is a warning where the campaign has others that go with it."""
        if not path.exists():
            if expected:
                self.add("warning", path, NOT_MEASURED)
            return None
        if path.is_dir() and not path.is_symlink():
            self.add("error", path, "is a folder; expected a file")
            return None
        if not path.is_file() or not self.folder.holds(path):
            return None  # named by `plain_files`
        return self.read(path, reader)
