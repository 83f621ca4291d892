"""The order of tasks and what a lost worker means; the place of execution is `workers` or `cluster`, and tells `Places`.

Points that share a geometry share their renders: the first of a group runs alone, the others are ready when it has ended, so
that no frame is rendered twice at one time. A point whose worker died is tried again, three times in all.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

ATTEMPTS = 3
LOST = f"the worker that ran it was lost {ATTEMPTS} times (killed, or out of memory)"

Task = Mapping[str, Any]
Outcome = dict[str, Any]


def not_run(point_id: str, reason: str) -> Outcome:
    """The outcome of a point that was never run to its end."""
    return {"id": point_id, "status": "failed", "reason": reason, "values": {}, "run_time_s": 0.0, "versions": {}}


class Places(Protocol):
    """Somewhere to run tasks."""

    def room(self) -> bool:
        """Whether another task may be given now."""

    def give(self, task: Task) -> None:
        """Starts a task."""

    def next(self) -> list[tuple[str, Outcome | None]]:
        """Waits until tasks have ended: id and outcome, None where the worker was lost."""


class Queue:
    """Which tasks are ready, in the order of their groups."""

    def __init__(self, tasks: Sequence[tuple[str, Task]]) -> None:
        self._group_of = {task["id"]: group for group, task in tasks}
        self._waiting: dict[str, deque[Task]] = {}
        for group, task in tasks:
            self._waiting.setdefault(group, deque()).append(task)
        self._ready: deque[Task] = deque(members.popleft() for members in self._waiting.values())
        self._tasks = {task["id"]: task for _, task in tasks}
        self._attempts: dict[str, int] = dict.fromkeys(self._tasks, 0)

    def take(self) -> Task | None:
        """The next task, or None while all that is left waits for its group's first."""
        if not self._ready:
            return None
        task = self._ready.popleft()
        self._attempts[task["id"]] += 1
        return task

    def done(self, point_id: str) -> None:
        """The others of the point's group are ready, before groups that have not begun: the renders are warm."""
        others = self._waiting.pop(self._group_of[point_id], deque())
        self._ready.extendleft(reversed(others))

    def lost(self, point_id: str) -> bool:
        """Ready once more; False after the last attempt."""
        if self._attempts[point_id] >= ATTEMPTS:
            return False
        self._ready.appendleft(self._tasks[point_id])
        return True


def run_all(
    tasks: Sequence[tuple[str, Task]],
    places: Places,
    finished: Callable[[Outcome], None],
    lost: Callable[[str], Outcome],
) -> None:
    """Run every task, given as (geometry group, task).

    Parameters
    ----------
    finished : callable
        Takes every outcome as it comes.
    lost : callable
        The outcome of a point that no worker survived, by its id.
    """
    queue, running = Queue(tasks), 0
    while True:
        while places.room() and (task := queue.take()) is not None:
            places.give(task)
            running += 1
        if not running:
            return
        for point_id, outcome in places.next():
            running -= 1
            if outcome is None and queue.lost(point_id):
                continue
            queue.done(point_id)
            finished(lost(point_id) if outcome is None else outcome)
