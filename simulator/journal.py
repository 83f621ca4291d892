"""Which parts of a campaign folder are finished. A simulation that was stopped goes on from there; several processes share one.

A unit is what is made in one go: one picture, one strip, one scan. It counts as finished when its files are on the disk and its
line is in the journal, in this order, so that a power cut leaves nothing that looks finished and is not.
"""

import json
import os
import threading
from collections.abc import Callable, Iterable
from pathlib import Path

from campaign.writing.atomic import sync_file

MAX_BYTES = 64_000_000


class Journal:
    """Finished units of one folder. Without a file everything is open and nothing is remembered.

    Parameters
    ----------
    root : Path, optional
        The folder that holds the units' files.
    file : Path, optional
        Where finished units are noted, outside `root`; one JSON line each, appended.
    share : (k, n), optional
        This process takes every n-th unit, beginning with the k-th, and writes nothing but units.
    check : callable, optional
        Called before a unit is noted; raises where nobody asks for it any more.
    """

    def __init__(
        self,
        root: Path | None = None,
        file: Path | None = None,
        share: tuple[int, int] | None = None,
        check: Callable[[], object] | None = None,
    ) -> None:
        self._root, self._file, self._share, self._check = root, file, share, check
        self._asked = 0
        self._lock = threading.Lock()
        self._known = {} if root is None or file is None else _read(root, file)

    @property
    def shares(self) -> bool:
        """Whether this process makes units for another one, which writes everything else."""
        return self._share is not None

    def wants(self, unit: str) -> bool:
        """Whether a unit is still to be made, by this process. Every process asks for the same units in the same order."""
        number = self._asked
        self._asked += 1
        if self._share is not None and number % self._share[1] != self._share[0]:
            return False
        return unit not in self._known

    def finish(self, unit: str, files: Iterable[Path]) -> None:
        """Note that a unit's files are complete. May be called from a writer's thread."""
        if self._root is None or self._file is None:
            return
        sizes = {}
        for path in files:
            sync_file(path)
            sizes[path.relative_to(self._root).as_posix()] = path.stat().st_size
        line = json.dumps({"unit": unit, "files": sizes}) + "\n"
        if self._check is not None:
            self._check()
        with self._lock, self._file.open("ab") as journal:
            journal.write(line.encode())
            journal.flush()
            os.fsync(journal.fileno())


def finished_units(root: Path, file: Path) -> int:
    """How many units are finished, for a display."""
    return len(_read(root, file))


def _read(root: Path, file: Path) -> dict[str, dict[str, int]]:
    """Units whose files are there in full. A line that was cut is no unit."""
    if not file.is_file() or file.stat().st_size > MAX_BYTES:
        return {}
    known: dict[str, dict[str, int]] = {}
    for line in file.read_bytes().splitlines():
        try:
            entry = json.loads(line)
            unit, sizes = str(entry["unit"]), {str(k): int(v) for k, v in entry["files"].items()}
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            continue
        if all((root / name).is_file() and (root / name).stat().st_size == size for name, size in sizes.items()):
            known[unit] = sizes
    return known
