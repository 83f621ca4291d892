"""Returns near targets in a temporary file: the same as in memory."""

import gc
import tempfile
import tracemalloc
from dataclasses import fields

import numpy as np
import pytest

from campaign.flight.las import Returns
from evaluator.georeference import TargetReturns
from evaluator.returns_store import ReturnsStore

COLUMNS = {
    "xyz_m": (np.float64, 3),
    "gps_time_s": (np.float64, 0),
    "intensity": (np.uint16, 0),
    "return_number": (np.uint8, 0),
    "number_of_returns": (np.uint8, 0),
    "scan_angle_deg": (np.float32, 0),
    "encoder_angle_deg": (np.float32, 0),
    "channel": (np.uint8, 0),
    "amplitude": (np.float32, 0),
    "pulse_width_ns": (np.float32, 0),
    "reflectance_db": (np.float32, 0),
    "strip": (np.uint16, 0),
    "packet": (np.int64, 0),
    "return_location_ps": (np.float32, 0),
    "wave_direction_m_ps": (np.float32, 3),
}


def part(strip: int, target: str, count: int) -> TargetReturns:
    rng = np.random.default_rng([strip, count])
    columns = {n: rng.integers(0, 200, (count, w) if w else count).astype(t) for n, (t, w) in COLUMNS.items()}
    record = np.sort(rng.integers(0, 10**6, count))
    return TargetReturns(
        target=target, sortie=1, strip=strip, record=record, returns=Returns(**columns), picked_by="person"
    )


def equal(a: TargetReturns, b: TargetReturns) -> bool:
    same = (a.target, a.sortie, a.strip, a.picked_by) == (b.target, b.sortie, b.strip, b.picked_by)
    pairs = [(a.record, b.record), *((getattr(a.returns, f.name), getattr(b.returns, f.name)) for f in fields(Returns))]
    return same and all(u.dtype == v.dtype and np.array_equal(u, v) for u, v in pairs)


@pytest.mark.parametrize("in_memory_bytes", [0, 20_000, 10**9])
def test_what_comes_out_is_what_went_in(in_memory_bytes: int) -> None:
    """Rationale: where returns lie must not matter. Expected: every column with its type and values, an empty part included, in
    any order and twice, whether all, some or none fit into memory; a key added again has the later returns."""
    parts = {(1, s, f"P{k:02d}"): part(s, f"P{k:02d}", 37 * k) for s in (1, 2) for k in range(5)}
    store = ReturnsStore(in_memory_bytes)
    store.add({k: v for k, v in parts.items() if k[1] == 1})
    store.add({k: v for k, v in parts.items() if k[1] == 2})
    assert sorted(store) == sorted(parts) and len(store) == 10
    for key in [*parts, *reversed(parts)]:
        assert equal(store[key], parts[key])
    later = part(1, "P01", 11)
    store.add({(1, 1, "P01"): later})
    assert equal(store[1, 1, "P01"], later)
    with pytest.raises(KeyError):
        store[1, 3, "P01"]


def test_memory_does_not_grow_with_the_strips() -> None:
    """Rationale: forty strips over the same targets. Expected: after 40 parts of 1 MB as much memory as the limit, and one part;
    reading them one after the other takes no more. Tolerance: 1 MB for what Python keeps."""
    gc.collect()
    tracemalloc.start()
    try:
        store = ReturnsStore(2_000_000)
        for strip in range(40):
            store.add({(1, strip, "P01"): part(strip, "P01", 11_000)})
        gc.collect()
        held = tracemalloc.get_traced_memory()[0]
        total = sum(len(rows.record) for rows in store.values())
        after = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert total == 40 * 11_000
    assert held < 3_000_000 and after < 4_100_000


def test_without_a_place_for_files_all_stays_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a full or missing folder for temporary files is no reason to stop. Expected: the same returns."""

    def none() -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", none)
    store, mine = ReturnsStore(0), part(1, "P01", 50)
    store.add({(1, 1, "P01"): mine})
    assert equal(store[1, 1, "P01"], mine)
