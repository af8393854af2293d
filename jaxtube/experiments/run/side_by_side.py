"""Closed loops that a command runs two at a time: while one is compiled, which most of its time
goes to, so is another, or it runs.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Key = TypeVar("Key")
Result = TypeVar("Result")

AT_ONCE = 2
"""A second loop keeps a second processor busy; each further one takes memory first of all."""


def run_side_by_side(tasks: Mapping[Key, Callable[[], Result]]) -> dict[Key, Result]:
    """Return the results of tasks that do not depend on each other, by their names."""
    with ThreadPoolExecutor(AT_ONCE) as pool:
        started = {name: pool.submit(task) for name, task in tasks.items()}
        try:
            return {name: future.result() for name, future in started.items()}
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
