"""Replaceable algorithms: seven slots of the evaluation that a user's own function can take; docs/your_own_algorithm.md.

`slots` says what goes in and comes out, `own` holds what stands there otherwise, `load` imports functions by name, `guard` checks
what they give, `apart` evaluates in a process of its own that can be stopped, `program` runs a whole evaluator of somebody
else's. Names of functions come from the command line or the user's own file, never from a campaign folder.
"""

from evaluator.algorithms.record import SLOTS, Algorithms
from evaluator.algorithms.slots import (
    AlgorithmFailure,
    EchoTask,
    ExtrinsicTask,
    FoundCameraMounting,
    FoundEchoes,
    FoundMark,
    FoundMountings,
    FoundPanel,
    FoundVertex,
    MarkTask,
    MountingTask,
    PanelTask,
    ReflectanceTask,
    VertexTask,
)

__all__ = [
    "SLOTS",
    "AlgorithmFailure",
    "Algorithms",
    "EchoTask",
    "ExtrinsicTask",
    "FoundCameraMounting",
    "FoundEchoes",
    "FoundMark",
    "FoundMountings",
    "FoundPanel",
    "FoundVertex",
    "MarkTask",
    "MountingTask",
    "PanelTask",
    "ReflectanceTask",
    "VertexTask",
]
