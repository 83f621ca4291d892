"""NumPy arrays handed to Dr.Jit."""

from typing import Any

import numpy as np

VECTOR_BYTES = 64  # the widest vector register


def uploaded(kind: Any, values: np.ndarray) -> Any:
    """`kind` (mi.Float, mi.UInt32, ...) with the contents of an array, flattened.

    Dr.Jit reads NumPy memory where it lies, whole vectors at a time, and so up to 60 bytes past an array's end; where the array
    ends with the last page of its block that is a segmentation fault (seen in the 33rd frame of 45 megapixels). Embree, too,
    reads the last vertex as four numbers. Hence a copy with room behind it.
    """
    flat = np.ascontiguousarray(values).ravel()
    room = np.zeros(flat.size + VECTOR_BYTES // flat.itemsize, flat.dtype)
    room[: flat.size] = flat
    return kind(room[: flat.size])
