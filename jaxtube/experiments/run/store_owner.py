"""The base of logs and records that keep their entries in a store."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Self

from jaxtube.experiments.run.store import Store


class StoreOwner(ABC):
    """The owner of a store, whose folder belongs to it until it is closed."""

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        """Take the folder; arguments and errors as of `Store`."""
        self._store = Store(folder, identity)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the folder to others."""
        self._store.close()

    @property
    def damaged(self) -> list[str]:
        """A line for each damaged file met at opening: those files are gone, and what they held is
        computed again."""
        return self._store.damaged

    @abstractmethod
    def _say_what_is_safe(self) -> str:
        """Return what outlives a failure of the disk."""

    @contextlib.contextmanager
    def _opening(self, what: str) -> Iterator[None]:
        """Read what is there, and leave the folder to others where that fails."""
        try:
            with self._explain_failure(f"opening {what}"):
                yield
        except BaseException:
            self.close()
            raise

    def _explain_failure(self, action: str) -> AbstractContextManager[None]:
        """Turn an error of the disk into one line."""
        return self._store.explain_failure(action, self._say_what_is_safe)
