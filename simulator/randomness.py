"""Named random streams: the same seed gives the same numbers however the work is cut into chunks, tiles or workers."""

from enum import IntEnum

import numpy as np

from campaign.config import Config


class Stream(IntEnum):
    SURVEY = 1
    CALIBRATION = 2
    SPECTRA = 3
    FLIGHT = 4
    NAVIGATION = 5
    CAMERA_NOISE = 6
    CAMERA_FIXED_PATTERN = 7
    LIDAR = 8
    RENDER = 9
    ENVIRONMENT = 10
    # 11-13 are the scene's own (scenes.streams)
    SPHERE = 14
    CHESSBOARD = 15
    RANGING = 16
    RESPONSE = 17


def scene_seed(config: Config) -> int:
    """Of everything that stands, flies or is sampled for a picture: what a change of `seed` alone leaves as it is."""
    return config.seed if config.scene_seed is None else config.scene_seed


def generator(seed: int, stream: Stream, *key: int) -> np.random.Generator:
    """One independent generator for each (seed, stream, key), key for example (sortie, strip, block)."""
    return np.random.default_rng(np.random.SeedSequence([seed, int(stream), *key]))


def key(seed: int, stream: Stream, *number: int) -> int:
    """64 bits for a stream of which any number can be drawn by its place alone."""
    return int(np.random.SeedSequence([seed, int(stream), *number]).generate_state(1, np.uint64)[0])
