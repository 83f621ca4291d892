"""Versions of everything that a result depends on; stands in every row of the table."""

import sys
from functools import cache
from importlib.metadata import version


@cache
def versions() -> dict[str, str]:
    """Of everything that a result depends on."""
    names = ("testrange", "mitsuba", "drjit", "numpy", "scipy", "opencv-python-headless")
    return {name: version(name) for name in names} | {"python": ".".join(map(str, sys.version_info[:3]))}
