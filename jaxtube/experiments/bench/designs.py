"""`bench design`: the seconds of a design by stage, and of its maximal invariant set beside those
of the package `polytope`.

Seconds are those of the process that designs, after its imports.

Source: new.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.experiments.bench.peers import invariant_sets
from jaxtube.experiments.bench.peers.invariant_sets import PeerSet
from jaxtube.experiments.bench.rounds import time_rounds
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.certificate.exact import check_in_rationals
from jaxtube.synthesis.design import Clock, finish, prepare
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.terminal import Terminal
from sets.invariant import maximal_rpi
from sets.polytope import Polytope

RATIONALS = "of which rationals"


class Extent(NamedTuple):
    """How much is measured: repeated calls, and the seconds after which `polytope` is stopped."""

    rounds: int
    longest_s: float


FULL = Extent(rounds=3, longest_s=20.0)
QUICK = Extent(rounds=1, longest_s=2.0)


class SetResult(NamedTuple):
    """A maximal invariant set, found twice.

    Attributes:
        facets: of it.
        seconds: of `sets`, by rounds.
        peer: of `polytope`; None where that is not installed.
        difference: by which one set has to grow, as a share of it, to contain the other; NaN where
            `polytope` did not end.
    """

    facets: int
    seconds: Float[np.ndarray, " rounds"]
    peer: PeerSet | None
    difference: float


class DesignResult(NamedTuple):
    """What was measured of one scenario.

    Attributes:
        certified: what its certificate says.
        first: seconds of the first call by stage; rationals are part of the certificate, and were
            asked again alone.
        repeated: seconds of all stages of the calls that follow, by rounds.
        invariant: its maximal invariant set; None where there is none.
    """

    certified: str
    first: dict[str, float]
    repeated: Float[np.ndarray, " rounds"]
    invariant: SetResult | None

    @property
    def first_s(self) -> float:
        """Seconds of the first call."""
        return sum(seconds for stage, seconds in self.first.items() if stage != RATIONALS)


class ProcessorClock(Clock):
    """Seconds by part, of this process alone."""

    def __init__(self):
        super().__init__()
        self._last = time.process_time()

    def lap(self, part: str) -> None:
        """Book the time since the last call under `part`."""
        now = time.process_time()
        self.seconds[part] = now - self._last
        self._last = now


def measure(scenario: Scenario, extent: Extent) -> DesignResult:
    """Measure one scenario, in a process that has designed nothing before."""
    design = make_design(scenario)
    first = dict(design.seconds)
    first[RATIONALS] = time_once(lambda: check_in_rationals(design))
    again = [time_once(lambda: make_design(scenario)) for _ in range(extent.rounds)]
    return DesignResult(
        design.certificate.verdict, first, np.array(again), measure_set(design.terminal, extent)
    )


def make_design(scenario: Scenario) -> Design:
    """Return a design with the processor's seconds by stage."""
    clock = ProcessorClock()
    problem = complete_problem(scenario)
    clock.lap("problem")
    return finish(prepare(problem, clock), clock)


def measure_set(terminal: Terminal, extent: Extent) -> SetResult | None:
    """Measure the maximal invariant set of the terminal gains; None where there is none."""
    problem = (terminal.loops, terminal.admissible, terminal.disturbances[0])
    found = maximal_rpi(*problem).polytope
    if found is None:
        return None
    work = {"sets": lambda: maximal_rpi(*problem)}
    seconds = time_rounds(work, max(extent.rounds, 3), lambda: None)["sets"]
    peer = None
    difference = np.nan
    if invariant_sets.is_installed():
        peer = invariant_sets.find_maximal_rpi(*problem, extent.longest_s)
        if peer.polytope is not None:
            difference = compare(found, peer.polytope)
    return SetResult(len(found.offsets), seconds, peer, difference)


def compare(one: Polytope, other: Polytope) -> float:
    """Return the share by which the one or the other has to grow to contain the other one; both
    hold the origin inside."""
    outside = [
        np.max(inner.support(outer.normals) / outer.offsets) - 1
        for inner, outer in ((one, other), (other, one))
    ]
    return float(max(0.0, *outside))


def time_once(act: Callable[[], object]) -> float:
    """Return the seconds of a call."""
    start = time.process_time()
    act()
    return time.process_time() - start
