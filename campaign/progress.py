"""What every long job calls while it works: the name of a stage, steps done, steps in all. Displays are the front door's."""

from collections.abc import Callable

Report = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """A progress report that says nothing."""
