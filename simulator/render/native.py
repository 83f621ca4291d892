"""Native libraries that Mitsuba and Dr.Jit need: found and preloaded before their first import, or one clear line.

Dr.Jit picks a system LLVM by itself and aborts the process with versions 15 and 16; the wheel in the lock file carries a
usable one, and the path is set here so that the system's is never reached.
"""

import ctypes
import os
import sys
from pathlib import Path

from campaign.errors import TestrangeError

MIN_LLVM = 17


class NativeLibraryError(TestrangeError):
    """A system library is missing or too old."""


def _load(path: str | Path) -> bool:
    try:
        ctypes.CDLL(str(path))
    except OSError:
        return False
    return True


def _llvm_version(path: str | Path) -> tuple[int, ...] | None:
    """LLVM's version, or None where the file is no LLVM or older than 16 (which lacks the symbol)."""
    try:
        function = ctypes.CDLL(str(path)).LLVMGetVersion
    except (OSError, AttributeError):
        return None
    numbers = [ctypes.c_uint() for _ in range(3)]
    function(*map(ctypes.byref, numbers))
    return tuple(number.value for number in numbers)


def prepare() -> None:
    """Make `import drjit` and `import mitsuba` safe.

    Raises
    ------
    NativeLibraryError
        libatomic is missing, or no LLVM of version 17 or newer is found.
    """
    if sys.platform != "linux":
        return
    if not _load("libatomic.so.1"):
        raise NativeLibraryError(
            "Mitsuba needs libatomic.so.1", got="not found", remedy="install the system package libatomic1"
        )
    preset = os.environ.get("DRJIT_LIBLLVM_PATH")
    if preset is not None:
        version = _llvm_version(preset)
        if version is None or version[0] < MIN_LLVM:
            found = "not a loadable LLVM" if version is None else ".".join(map(str, version))
            raise NativeLibraryError(
                "this LLVM cannot be used",
                where=f"DRJIT_LIBLLVM_PATH={preset}",
                got=found,
                expected=f"version {MIN_LLVM} or newer",
                remedy="unset the variable to use the one that was installed with testrange",
            )
        return
    lib = Path(sys.prefix) / "lib"
    for name in ("libunwind.so.1.0", "libc++abi.so.1.0", "libc++.so.1.0"):
        candidate = lib / "x86_64-unknown-linux-gnu" / name
        if candidate.exists():
            _load(candidate)
    for candidate in sorted(lib.glob("libLLVM.so.*")):
        version = _llvm_version(candidate)
        if version is not None and version[0] >= MIN_LLVM:
            os.environ["DRJIT_LIBLLVM_PATH"] = str(candidate)
            return
    raise NativeLibraryError(
        "no usable LLVM library",
        where=str(lib),
        expected=f"libLLVM {MIN_LLVM} or newer from the package karellen-llvm-core",
        remedy="run make install, or point DRJIT_LIBLLVM_PATH at a libLLVM.so",
    )
