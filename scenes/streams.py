"""Named random streams: the same seed gives the same scene, whatever else draws numbers.

The numbers of the streams are the project's (docs/conventions.md); only those that scenes draw from are named here.
"""

import numpy as np

SPECTRA = 3
PANELS = 11
LAYOUT = 12
TERRAIN = 13


def stream(seed: int, stream_id: int) -> np.random.Generator:
    """Generator of one named stream; scenes belong to no sortie, strip or block, so these three are 0."""
    return np.random.default_rng(np.random.SeedSequence([seed, stream_id, 0, 0, 0]))
