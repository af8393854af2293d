"""What a check of the installation found."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Literal, NamedTuple


class Finding(NamedTuple):
    """The outcome of one check.

    Attributes:
        name: of what was checked, such as "numpy".
        state: "ok"; "missing", not found; "wrong", found and not as it has to be.
        words: what was found.
        cure: what mends it; empty where it is ok.
        is_needed: whether jaxtube works without it.
    """

    name: str
    state: Literal["ok", "missing", "wrong"]
    words: str
    cure: str = ""
    is_needed: bool = True

    @property
    def is_fault(self) -> bool:
        """Whether jaxtube does not work because of it."""
        return self.is_needed and self.state != "ok"


class Check(NamedTuple):
    """A check that may fail in ways of its own, with the cure for all of them.

    Attributes:
        name: of what is checked.
        find: returns what was found, in words; raises where it does not work.
        cure: what mends it.
    """

    name: str
    find: Callable[[], str]
    cure: str


def run_checks(checks: Iterable[Check]) -> list[Finding]:
    """Return what each check found; one that raises is wrong, and the others still run."""
    return [_run(check) for check in checks]


def _run(check: Check) -> Finding:
    try:
        return Finding(check.name, "ok", check.find())
    # A broken installation raises whatever it likes: ImportError, OSError, RuntimeError of XLA.
    except Exception as error:
        words = " ".join(f"{type(error).__name__}: {error}".split())
        return Finding(check.name, "wrong", words, check.cure)
