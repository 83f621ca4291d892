"""Cheap responses for the tests of studies, imported by workers from beside the study file (tests copy this file there)."""

import math
import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path

HERE = Path(__file__).resolve().parent


def additive(factors: Mapping[str, float], seed: int) -> float:
    """3 a + b^2 plus noise of the seed, uniform on +-0.5; notes that it ran."""
    _note(factors, seed)
    return 3.0 * factors["a"] + factors["b"] ** 2 + (seed % 1000) / 999.0 - 0.5


def slow(factors: Mapping[str, float], seed: int) -> float:
    """As `additive`, a fifth of a second long."""
    time.sleep(0.2)
    return additive(factors, seed)


def fails_at_two(factors: Mapping[str, float], seed: int) -> float:
    """Raises at a = 2 unless a file `mended` lies beside it."""
    _note(factors, seed)
    if factors["a"] == 2.0 and not (HERE / "mended").exists():
        raise ZeroDivisionError("a is two\nand that is too much")
    return additive(factors, seed)


def kills_its_worker_once(factors: Mapping[str, float], seed: int) -> float:
    """kill -9 of the process at a = 2, b = 1, the first time."""
    _note(factors, seed)
    mark = HERE / f"killed-{seed}"
    if factors["a"] == 2.0 and factors["b"] == 1.0 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 3.0 * factors["a"] + factors["b"] ** 2 + (seed % 1000) / 999.0 - 0.5


def kills_its_worker(factors: Mapping[str, float], seed: int) -> float:
    """kill -9 of the process at a = 2, b = 1, every time."""
    if factors["a"] == 2.0 and factors["b"] == 1.0:
        with (HERE / "deaths").open("a") as file:
            file.write("x")
        os.kill(os.getpid(), signal.SIGKILL)
    return factors["a"]


def nothing(factors: Mapping[str, float], seed: int) -> object:
    """Neither a number nor a mapping."""
    return None


def not_finite(factors: Mapping[str, float], seed: int) -> Mapping[str, float]:
    """NaN at a = 1, infinity at a = 2."""
    return {"y": {1.0: math.nan, 2.0: math.inf}.get(factors["a"], 1.0)}


def _note(factors: Mapping[str, float], seed: int) -> None:
    with (HERE / "ran").open("a") as file:
        file.write(f"{factors['a']:g} {factors['b']:g} {seed}\n")
