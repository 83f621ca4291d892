"""Returns near targets of all strips, a part of them in a temporary file: memory does not grow with the number of strips."""

import contextlib
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import IO

import numpy as np

from campaign.flight.las import Returns
from evaluator.georeference import TargetReturns

Key = tuple[int, int, str]  # sortie, strip, target
IN_MEMORY_BYTES = 32_000_000


@dataclass(frozen=True, kw_only=True)
class _Place:
    """Where one array lies in the file."""

    name: str
    at: int
    dtype: np.dtype
    shape: tuple[int, ...]


class ReturnsStore(Mapping[Key, TargetReturns]):
    """As a dict of `TargetReturns` that is filled by `add`. What is taken out twice is read twice, the last one apart.

    Where no file can be written everything stays in memory.
    """

    def __init__(self, in_memory_bytes: int = IN_MEMORY_BYTES) -> None:
        self._left = in_memory_bytes
        self._held: dict[Key, TargetReturns] = {}  # in the file: with empty arrays
        self._places: dict[Key, tuple[_Place, ...]] = {}
        self._file: IO[bytes] | None = None
        self._last: tuple[Key, TargetReturns] | None = None

    def add(self, found: Mapping[Key, TargetReturns]) -> None:
        """Takes over the returns of one strip; of a key that is there already the later ones stand."""
        for key, part in found.items():
            arrays = {"record": part.record} | {f.name: getattr(part.returns, f.name) for f in fields(Returns)}
            size = sum(values.nbytes for values in arrays.values())
            self._places.pop(key, None)
            self._last = None
            self._held[key] = part
            if size <= self._left:
                self._left -= size
                continue
            with contextlib.suppress(OSError):  # a full disk
                self._places[key] = self._written(arrays)
                none = {name: values[:0] for name, values in arrays.items() if name != "record"}
                none = {name: values.copy() for name, values in none.items()}  # a view would hold the whole
                self._held[key] = replace(part, record=part.record[:0].copy(), returns=Returns(**none))

    def _written(self, arrays: Mapping[str, np.ndarray]) -> tuple[_Place, ...]:
        if self._file is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the store
            weakref.finalize(self, self._file.close)
        places = []
        self._file.seek(0, 2)
        for name, values in arrays.items():
            places.append(_Place(name=name, at=self._file.tell(), dtype=values.dtype, shape=values.shape))
            self._file.write(np.ascontiguousarray(values).data)
        self._file.flush()
        return tuple(places)

    def __getitem__(self, key: Key) -> TargetReturns:
        places = self._places.get(key)
        if places is None or self._file is None:
            return self._held[key]
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        arrays = {}
        for place in places:
            values = np.empty(place.shape, place.dtype)
            self._file.seek(place.at)
            if values.nbytes:
                self._file.readinto(values.data.cast("B"))  # type: ignore[attr-defined]
            arrays[place.name] = values
        record = arrays.pop("record")
        found = replace(self._held[key], record=record, returns=Returns(**arrays))
        self._last = (key, found)
        return found

    def __iter__(self) -> Iterator[Key]:
        return iter(self._held)

    def __len__(self) -> int:
        return len(self._held)
