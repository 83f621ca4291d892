"""BLAS at one thread where bytes count: with more, sums are split by the number of cores and their last digits follow it."""

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Inside, every BLAS that is loaded uses one thread; afterwards what it used before. Also a decorator.

    The matrices here are small: one thread is no slower, and much faster where cores are shared.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield
