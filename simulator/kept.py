"""Arrays that are kept in a folder between runs, by what they were made of: renders that several campaigns share."""

import hashlib
import os
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel


def kept_array(folder: str | None, made_of: object, make: Callable[[], np.ndarray]) -> np.ndarray:
    """What `make` gives, or what it gave for the same `made_of`; without a folder nothing is kept.

    Parameters
    ----------
    folder : str, optional
        Made where it does not exist (`render.cache`).
    made_of : object
        Everything that the array depends on: numbers, texts, arrays, models and data classes, in tuples.
    """
    if folder is None:
        return make()
    digest = hashlib.sha256()
    _add(digest, made_of)
    kept = Path(folder) / f"{digest.hexdigest()[:40]}.npy"
    if kept.is_file():
        return np.asarray(np.load(kept, allow_pickle=False))
    array = make()
    kept.parent.mkdir(parents=True, exist_ok=True)
    part = kept.with_suffix(f".{os.getpid()}.part")
    with part.open("wb") as file:
        np.save(file, array)
    part.replace(kept)
    return array


def _add(digest: "hashlib._Hash", value: object) -> None:
    if isinstance(value, np.ndarray):
        digest.update(repr((value.dtype.str, value.shape)).encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, BaseModel):
        digest.update(value.model_dump_json().encode())
    elif is_dataclass(value):
        for field in fields(value):
            digest.update(field.name.encode())
            _add(digest, getattr(value, field.name))
    elif isinstance(value, tuple | list):
        digest.update(f"{len(value)}:".encode())
        for each in value:
            _add(digest, each)
    else:
        digest.update(f"{value!r};".encode())
