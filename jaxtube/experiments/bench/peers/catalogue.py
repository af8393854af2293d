"""The peers: which there are, which of them are installed, and at what tolerances they are run.

Source: new.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from jaxtube.experiments.bench.peers.active_set import make_cold_daqp, make_quadprog
from jaxtube.experiments.bench.peers.interior import make_clarabel, make_piqp, make_qpax
from jaxtube.experiments.bench.peers.problems import Problems, Solver
from jaxtube.experiments.bench.peers.splitting import make_osqp, make_proxqp


class Peer(NamedTuple):
    """A solver at one setting.

    Attributes:
        name: as in tables; a solver with several settings has one name.
        package: what pip installs.
        module: what is imported.
        settings: in words.
        make: gives it its programs.
        tolerance: that it is given; None for one that is exact.
    """

    name: str
    package: str
    module: str
    settings: str
    make: Callable[[Problems], Solver]
    tolerance: float | None = None

    @property
    def is_installed(self) -> bool:
        """Whether its module is there."""
        return importlib.util.find_spec(self.module) is not None

    @property
    def cure(self) -> str:
        """What to do about a peer that is not installed."""
        return f"not installed: pip install {self.package}"


class Kind(NamedTuple):
    """An iterative solver: tolerances that it is run at, loose to tight, and `meets`, the loosest
    at which its residual is about 1e-9."""

    package: str
    module: str
    words: str
    make: Callable[[Problems, float], Solver]
    tolerances: tuple[float, ...]
    meets: float


EXACT = (
    Peer("DAQP", "daqp", "daqp", "exact, update and solve", make_cold_daqp),
    Peer("quadprog", "quadprog", "quadprog", "exact, P factorised", make_quadprog),
)
KINDS = {
    "OSQP": Kind(
        "osqp",
        "osqp",
        "eps",
        partial(make_osqp, polishing=False),
        (1e-3, 1e-5, 1e-7, 1e-9, 1e-10),
        1e-10,
    ),
    "OSQP polished": Kind(
        "osqp", "osqp", "eps", partial(make_osqp, polishing=True), (1e-3, 1e-5, 1e-7), 1e-7
    ),
    "ProxQP": Kind("proxsuite", "proxsuite", "eps", make_proxqp, (1e-3, 1e-5, 1e-7, 1e-10), 1e-10),
    "PIQP": Kind("piqp", "piqp", "eps, gap", make_piqp, (1e-4, 1e-7, 1e-10, 1e-13), 1e-13),
    "Clarabel": Kind(
        "clarabel", "clarabel", "tol", make_clarabel, (1e-5, 1e-8, 1e-10, 1e-12), 1e-12
    ),
    "qpax": Kind("qpax", "qpax", "mapped, jitted, tol", make_qpax, (1e-3, 1e-5, 1e-7, 1e-9), 1e-9),
}


def at_tolerance(name: str, tolerance: float) -> Peer:
    """Return an iterative peer at one of its tolerances."""
    kind = KINDS[name]

    def make(problems: Problems) -> Solver:
        return kind.make(problems, tolerance)

    return Peer(name, kind.package, kind.module, f"{kind.words} {tolerance:.0e}", make, tolerance)


def tight_peers() -> list[Peer]:
    """Return every peer, the iterative ones at the tolerance whose residual is about 1e-9."""
    return [*EXACT, *(at_tolerance(name, kind.meets) for name, kind in KINDS.items())]


def swept_peers() -> list[Peer]:
    """Return the exact peers, and the iterative ones at all of their tolerances."""
    swept = [at_tolerance(name, each) for name, kind in KINDS.items() for each in kind.tolerances]
    return [*EXACT, *swept]
