"""Arrays that reach Dr.Jit."""

import subprocess
import sys

import pytest

GUARDED = """
import ctypes, mmap
import numpy as np
from simulator.render import start
start()
import drjit as dr
import mitsuba as mi
from simulator.render.upload import uploaded

libc = ctypes.CDLL(None)
libc.mmap.restype = ctypes.c_void_p
libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
libc.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
page = mmap.PAGESIZE
base = libc.mmap(None, 2 * page, 3, 0x22, -1, 0)
assert libc.mprotect(base + page, page, 0) == 0
values = np.frombuffer((ctypes.c_uint32 * 37).from_address(base + page - 4 * 37), np.uint32)
values[:] = np.arange(37)
doubled = uploaded(mi.UInt32, values) * 2
dr.eval(doubled)
print(int(np.asarray(doubled).sum()))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="places memory by Linux's mmap")
def test_array_that_ends_at_the_last_page_of_its_memory() -> None:
    """Rationale: 37 numbers end right before a page that must not be touched; handed over as it lies, a kernel reads three vectors
    of 16 and the process dies (seen once in 33 frames of 45 megapixels). Expected: 2 (0 + ... + 36) = 1332, no signal."""
    done = subprocess.run([sys.executable, "-c", GUARDED], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "1332"), done.stderr[-500:]
