"""How many threads a process uses: BLAS one where bytes count (with more, sums are split by the number of cores and their last
digits follow it), all else every core it may use, or what TESTRANGE_THREADS says.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

THREADS_VARIABLE = "TESTRANGE_THREADS"


def thread_count() -> int:
    """Threads of one process: TESTRANGE_THREADS where it is a positive number, else every core that the process may use.

    A pool of processes sets it to 1 in each: two processes with two Dr.Jit threads each are no faster than one.
    """
    told = os.environ.get(THREADS_VARIABLE, "")
    if told.isdecimal() and int(told) > 0:
        return int(told)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Inside, every BLAS that is loaded uses one thread; afterwards what it used before. Also a decorator.

    The matrices here are small: one thread is no slower, and much faster where cores are shared.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield
