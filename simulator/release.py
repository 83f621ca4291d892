"""Which code writes. What an earlier run has begun or kept is gone on with by the very same code only."""

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

SIMULATION = ("campaign", "scenes", "simulator")
_LIBRARIES = ("numpy", "scipy", "numba", "mitsuba", "drjit")  # whose numbers reach the files


def release() -> str:
    """The version, a digest of every source and data file that a simulation uses, and the versions of its libraries.

    The version alone stays the same between two releases while the code, and with it a picture, changes.
    """
    libraries = " ".join(f"{name} {version(name)}" for name in _LIBRARIES)
    return f"{version('testrange')} {sources(SIMULATION)} {libraries}"


@cache
def sources(packages: tuple[str, ...]) -> str:
    """Digest of the sources and data files of packages beside this one."""
    digest, root = hashlib.sha256(), Path(__file__).parents[1]
    for package in packages:
        for path in sorted((root / package).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
