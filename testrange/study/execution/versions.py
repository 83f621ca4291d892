"""Versions of everything that a result depends on; stands in every row of the table."""

import sys
from functools import cache
from importlib.metadata import version

from simulator.release import SIMULATION, sources


@cache
def versions() -> dict[str, str]:
    """Of everything that a result depends on."""
    names = ("testrange", "mitsuba", "drjit", "numpy", "scipy", "opencv-python-headless")
    python, code = ".".join(map(str, sys.version_info[:3])), sources((*SIMULATION, "evaluator"))
    return {name: version(name) for name in names} | {"python": python, "code": code}
