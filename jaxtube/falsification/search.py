"""Search for violations: all bounded uncertainties at once, moved by the gradient of the whole
closed loop.

    maximise  n_i (x_k - c) / (h_i - n_i c)    over the start and every deviation

is the usage of facet i of a limit at step k: 1 on the facet, above 1 outside. It is close to
linear in the uncertainties, so each instance of a batch has a cell of its own, a facet at a step,
and climbs by the steps of `ascent`, while every lap played is judged at all facets and steps,
whatever its cell was. Rounds take turns:

(1) explore: cells spread over facets and steps, from vertices at random;
(2) polish: the worst cells of the last round, from the laps that reached them;
(3) enumerate, for plans that are followed: every sequence of vertices in the window of the worst
  one, where few.

Source: Abbas, Winn, Fainekos, Julius, Functional gradient descent method for metric temporal logic
specifications, American Control Conference 2014, for falsification by gradients of a margin.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxtube.falsification.ascent import (
    Attack,
    CellAim,
    ascend,
    draw_vertex_attack,
    find_uncertainties,
    make_mean_attack,
    start_ascent,
)
from jaxtube.falsification.cells import DURING_PERIODS, UsageCells
from jaxtube.falsification.worst import Worst, confirm
from jaxtube.plant.protocol import Uncertainty
from jaxtube.simulation.usage import JudgedLoop

SWEEPS = 8
"""Gradients a round at most."""
PATIENCE = 4
"""Rounds in a row without a worse case after which a search ends."""
ENUMERATED = 1024
"""Sequences of vertices up to which all of them are played."""
CONVERGED = 1e-9
"""Usage: a round ends when no instance expects to gain as much, and a gain below it is none."""


@dataclass(frozen=True, eq=False)
class WorstCaseSearch:
    """What a search found.

    Attributes:
        worst: the worst case by limit.
        reach: greatest usage met by any lap, by limit; of a tube by stage, else by step, and facet.
        laps: played with their gradient.
        seconds: without compilation.
        course: (seconds, limit, usage) of each case that was worse than all before.
    """

    worst: dict[str, Worst]
    reach: dict[str, Float[np.ndarray, "stages facets"]]
    laps: int
    seconds: float
    course: list[tuple[float, str, float]]


class Space(NamedTuple):
    """What a search moves in.

    Attributes:
        loop: that is searched.
        uncertainties: of its plant and its starts, by name.
        aims: names of the limits that are aimed at.
    """

    loop: JudgedLoop
    uncertainties: dict[str, Uncertainty]
    aims: Sequence[str]


class _Round(NamedTuple):
    """What a round begins with."""

    attack: Attack
    cell: Int[np.ndarray, " batch"]  # that each instance aims at
    when: Int[np.ndarray, " batch"]  # step of the plan that each follows


class _Outcome(NamedTuple):
    """One batch of laps."""

    played: _Round
    best: Float[np.ndarray, " cells"]  # greatest usage of every cell
    member: Int[np.ndarray, " cells"]  # the instance that had it


class _Case(NamedTuple):
    """The worst case of a limit so far; attacks are (times, 1, n)."""

    usage: float
    cell: int
    when: int
    attack: dict[str, np.ndarray]


class _Searcher:
    """One search on its way."""

    def __init__(self, space: Space, seed: int, batch: int):
        self.space = space
        self.generator = np.random.default_rng(seed)
        self.batch = batch
        self.vertices = {
            name: jnp.asarray(uncertainty.vertices)
            for name, uncertainty in space.uncertainties.items()
        }
        self.cells = UsageCells(space.loop.limits, len(space.loop.plant.reference_wheels))
        self.plan_steps = space.loop.list_plan_steps()
        self.aims = np.concatenate([self.cells.list_by_facet(name) for name in space.aims])
        self.cases: dict[str, _Case] = {}
        self.reach = {name: np.full(shape, -np.inf) for name, shape in self.cells.shapes.items()}
        self.course: list[tuple[float, str, float]] = []
        self.laps = 0
        self.start = 0.0
        self.last: _Outcome | None = None

    def warm_up(self) -> None:
        """Compile."""
        zeros = np.zeros(self.batch, int)
        attack = make_mean_attack(self.space.uncertainties, self.batch)
        ascent = start_ascent(attack)
        jax.block_until_ready(self._ascend(ascent, _Round(attack, zeros, zeros)))

    def run(self, seconds: float) -> WorstCaseSearch:
        """Search until nothing worse is found or the time is up, and replay the worst cases."""
        self.start = time.perf_counter()
        rounds = self._generate_rounds()
        stale = 0
        while stale < PATIENCE and self._elapsed() < seconds:
            before = {name: case.usage for name, case in self.cases.items()}
            self._play(next(rounds), seconds)
            gains = [case.usage - before.get(name, -np.inf) for name, case in self.cases.items()]
            stale = 0 if max(gains) > CONVERGED else stale + 1
        elapsed = self._elapsed()
        worst = {name: self._confirm(name) for name in self.cases}
        return WorstCaseSearch(worst, self.reach, self.laps, elapsed, self.course)

    def _generate_rounds(self) -> Iterator[_Round]:
        # The first begins without deviations, where the gradient is the fairest.
        attack = make_mean_attack(self.space.uncertainties, self.batch)
        yield _Round(attack, *self._spread())
        while True:
            yield self._polish()
            if "tube" in self.space.loop.limits:
                yield from self._enumerate()
            attack = draw_vertex_attack(self.space.uncertainties, self.batch, self.generator)
            yield _Round(attack, *self._spread())

    def _play(self, begin: _Round, seconds: float) -> None:
        """Climb until no instance expects a gain or the time is up, and judge every lap."""
        ascent = start_ascent(begin.attack)
        for _ in range(SWEEPS):
            played = begin._replace(attack=ascent.candidate)
            sweep = self._ascend(ascent, begin)
            self.last = _Outcome(played, np.asarray(sweep.best), np.asarray(sweep.member))
            self._judge(self.last)
            if float(sweep.gain) <= CONVERGED or self._elapsed() >= seconds:
                break
            ascent = sweep.ascent

    def _ascend(self, ascent, begin: _Round):
        cell = jnp.asarray(begin.cell, jnp.int32)
        when = jnp.asarray(begin.when, jnp.int32)
        return ascend(self.space.loop, self.vertices, ascent, CellAim(cell, when))

    def _judge(self, outcome: _Outcome) -> None:
        """Note what a batch reached, and its cases that are worse than all before."""
        self.laps += self.batch
        for name, cells in self.cells.slices.items():
            reach = self.cells.pick(name, outcome.best)
            self.reach[name] = np.maximum(self.reach[name], reach)
            cell = cells.start + int(np.argmax(reach))
            usage = float(outcome.best[cell])
            if name in self.cases and usage <= self.cases[name].usage:
                continue
            index = int(outcome.member[cell])
            attack = {
                key: np.asarray(values)[:, index : index + 1]
                for key, values in outcome.played.attack.items()
            }
            self.cases[name] = _Case(usage, cell, int(outcome.played.when[index]), attack)
            self.course.append((self._elapsed(), name, usage))

    def _spread(self) -> tuple[Int[np.ndarray, " batch"], Int[np.ndarray, " batch"]]:
        """Return cells spread evenly over facets and steps, and plan steps at random."""
        places = np.arange(self.batch) + self.generator.random(self.batch)
        cell = self.aims[(places * len(self.aims) / self.batch).astype(int)]
        return cell, self.generator.choice(self.plan_steps, self.batch)

    def _polish(self) -> _Round:
        """Return the laps of the last batch that reached the worst cells, aiming at these."""
        assert self.last is not None
        played = self.last.played
        worst_first = self.aims[np.argsort(-self.last.best[self.aims])]
        cell = np.resize(worst_first, self.batch)
        index = self.last.member[cell]
        attack = {name: values[:, index] for name, values in played.attack.items()}
        return _Round(attack, cell, played.when[index])

    def _enumerate(self) -> Iterator[_Round]:
        """Yield all sequences of vertices in the window of the worst plan, a batch at a time, where
        they are few."""
        case = self.cases["tube"]
        horizon = self.cells.shapes["tube"][0]
        names = self._list_sequences()
        plan = slice(case.when, case.when + horizon)
        vertices = {name: self.space.uncertainties[name].by_time[plan] for name in names}
        counts = [vertices[name].shape[1] for name in names for _ in range(horizon)]
        total = math.prod(counts)
        if not names or total > ENUMERATED:
            return
        cell = np.full(self.batch, case.cell)
        when = np.full(self.batch, case.when)
        for first in range(0, total, self.batch):
            numbers = np.arange(first, first + self.batch) % total
            digits = np.stack(np.unravel_index(numbers, counts))
            choices = digits.reshape(len(names), horizon, self.batch)
            attack = {
                name: np.repeat(values, self.batch, axis=1) for name, values in case.attack.items()
            }
            for name, choice in zip(names, choices, strict=True):
                attack[name][plan] = np.take_along_axis(vertices[name], choice[..., None], axis=1)
            on_device = {name: jnp.asarray(values) for name, values in attack.items()}
            yield _Round(on_device, cell, when)

    def _list_sequences(self) -> list[str]:
        """Return the uncertainties that are enumerated: those with a value for every period."""
        return [
            name
            for name, uncertainty in self.space.uncertainties.items()
            if name not in ("start", "noise") and uncertainty.times > 1
        ]

    def _elapsed(self) -> float:
        return time.perf_counter() - self.start

    def _confirm(self, name: str) -> Worst:
        """Return the worst case of a limit as its replay has it.

        Whatever comes later plays no part: it is left at the mean.
        """
        case = self.cases[name]
        stage, facet = self.cells.locate(name, case.cell)
        is_during = name in DURING_PERIODS
        step = case.when + stage + (0 if is_during else 1)
        attack = {key: np.array(values[:, 0]) for key, values in case.attack.items()}
        for key, values in attack.items():
            later = step + int(key == "noise" or is_during)
            values[later:] = self.space.uncertainties[key].by_time.mean(axis=1)[later:]
        unconfirmed = Worst(name, case.usage, np.nan, step, facet, case.when, attack)
        loop = self.space.loop
        return confirm(loop.controller, loop.plant, loop.limits[name], unconfirmed)


def search_worst_cases(
    loop: JudgedLoop,
    starts: Float[np.ndarray, "k 3"],
    *,
    aims: Sequence[str] = (),
    seconds: float = 60.0,
    seed: int = 0,
    batch: int = 256,
) -> WorstCaseSearch:
    """Search for the smallest margins of a closed loop over everything bounded that its plant would
    draw.

    Args:
        loop: the law by which its plant draws gives way to what bounds the draws.
        starts: vertices of the polytope of initial errors, (m, m, rad); a single one fixes the
            start.
        aims: limits that are aimed at, all unless given; every limit is judged.
        seconds: after which the search ends at the latest, compilation not counted.
        seed: of cells and random vertices.
        batch: laps played at once.

    Returns:
        The worst cases, each with the usage and margin of its replay. A positive margin proves
        nothing.

    Raises:
        ValueError: one line, for a slip process that is not searched, or limits that do not go
            together, with the plant, or with the controller.
    """
    limits = loop.limits
    if not limits or ("tube" in limits and len(limits) > 1):
        raise ValueError(
            f"limits = {sorted(limits)}: do not go together; give some of `error`, `input`, "
            "`wheels` and `acceleration`, or `tube` alone"
        )
    if "wheels" in limits and not loop.plant.has_wheels:
        raise ValueError(
            "limits = `wheels`: the linear plant has none; leave it out or give the slipping robot"
        )
    space = Space(
        loop=loop,
        uncertainties=find_uncertainties(loop.plant, starts),
        aims=aims or sorted(limits),
    )
    searcher = _Searcher(space, seed, batch)
    searcher.warm_up()
    return searcher.run(seconds)
