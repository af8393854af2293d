"""Search for violations: all bounded uncertainties at once, moved by the gradient of the whole
closed loop.

    maximise  n_i (x_k - c) / (h_i - n_i c)   over the start and every deviation, for one facet i and one step k

is the usage of a limit: 1 on its facet, above 1 outside. For one facet at one step it is close to
linear in the uncertainties, so each instance of a batch has a target of its own and climbs by the
steps of `attack`, while every lap played is judged at all facets and steps, whatever its target
was. Rounds take turns:

(1) explore: targets spread over facets and steps, from vertices at random;
(2) polish: the worst facets and steps of the last round, from the laps that reached them;
(3) enumerate, for plans that are followed: every sequence of vertices in the window of the worst
  one, where few.

Source: Abbas, Winn, Fainekos, Julius, Functional gradient descent method for metric temporal logic
specifications, American Control Conference 2014, for falsification by gradients of a margin.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxtube.control.follow import PlanFollower
from jaxtube.control.protocol import Controller
from jaxtube.falsification.climb import (
    Attack,
    Uncertainty,
    begun,
    climb,
    find_uncertainties,
    mean_attack,
    vertex_attack,
)
from jaxtube.plant.protocol import SearchablePlant
from jaxtube.simulation.usage import Limit, Limits, replay, values_of

SWEEPS = 8
"""Gradients a round at most."""
PATIENCE = 4
"""Rounds in a row without a worse case after which a search ends."""
ENUMERATED = 1024
"""Sequences of vertices up to which all of them are played."""
CONVERGED = 1e-9
"""Usage: a round ends when no instance expects to gain as much, and a gain below it is none."""


@dataclass(frozen=True, eq=False)
class Worst:
    """The worst case found of one limit.

    Attributes:
        usage: 1 on the facet, above 1 outside.
        margin: offset - normal x in the unit of the facet; negative outside.
        step: of errors and tubes the number of periods after which it is met, of inputs and wheels
            the period itself.
        facet: row of the limit; of a tube, of stage step - when, counted from 1.
        when: step of the plan that is followed; 0 for the other limits.
        attack: by name, time first: `start` (1, 3), and the entries of a script.
    """

    usage: float
    margin: float
    step: int
    facet: int
    when: int
    attack: dict[str, np.ndarray]


@dataclass(eq=False)
class Search:
    """What a search came to.

    Attributes:
        worst: the worst case by limit.
        reach: greatest usage met by any lap, by limit; of a tube by stage, else by step, and facet.
        laps: played with their gradient.
        seconds: without compilation.
        course: (seconds, limit, usage) of each case that was worse than all before.
    """

    worst: dict[str, Worst]
    reach: dict[str, Float[np.ndarray, "stages facets"]]
    laps: int = 0
    seconds: float = 0.0
    course: list[tuple[float, str, float]] = field(default_factory=list)


class _Round(NamedTuple):
    """What a round begins with: attacks, the cell each aims at, and the step of the plan each
    follows."""

    attack: Attack
    cell: Int[np.ndarray, " batch"]
    when: Int[np.ndarray, " batch"]


class _Found(NamedTuple):
    """The worst case of a limit so far; attacks are (times, 1, n)."""

    usage: float
    cell: int
    when: int
    attack: dict[str, np.ndarray]


class _Searcher:
    """One search on its way."""

    def __init__(
        self,
        controller,
        plant,
        limits: Limits,
        sets: dict[str, Uncertainty],
        aims,
        windows,
        seed,
        batch,
    ):
        self.controller, self.plant, self.limits, self.sets = controller, plant, limits, sets
        self.vertices = {name: jnp.asarray(each.vertices) for name, each in sets.items()}
        self.windows, self.generator, self.batch = windows, np.random.default_rng(seed), batch
        steps = len(plant.reference_wheels)
        self.shapes = {
            name: (
                len(limits[name].offsets) if name == "tube" else steps,
                limits[name].offsets.shape[1],
            )
            for name in sorted(limits)
        }
        ends = np.cumsum([stages * facets for stages, facets in self.shapes.values()])
        self.slices = {
            name: slice(a, b) for name, a, b in zip(self.shapes, [0, *ends[:-1]], ends, strict=True)
        }
        # One facet after the other, so that a grid over the cells covers facets and steps.
        cells = {
            name: np.arange(s.start, s.stop).reshape(self.shapes[name]).T.ravel()
            for name, s in self.slices.items()
        }
        self.aims = np.concatenate([cells[name] for name in aims])
        self.found: dict[str, _Found] = {}
        self.search = Search(
            {}, {name: np.full(shape, -np.inf) for name, shape in self.shapes.items()}
        )

    def warm_up(self) -> None:
        """Compile."""
        now, cell = begun(mean_attack(self.sets, self.batch)), jnp.zeros(self.batch, jnp.int32)
        loop = self._loop(np.zeros(self.batch))
        jax.block_until_ready(climb(loop, self.plant, self.limits, self.vertices, now, cell))

    def run(self, seconds: float) -> Search:
        """Search until nothing worse is found or the time is up, and replay what was found."""
        self.start = time.perf_counter()
        stale, rounds = 0, self._rounds()
        while stale < PATIENCE and self._elapsed() < seconds:
            before = {name: found.usage for name, found in self.found.items()}
            self._play(next(rounds), lambda: self._elapsed() >= seconds)
            gains = [found.usage - before.get(name, -np.inf) for name, found in self.found.items()]
            stale = 0 if max(gains) > CONVERGED else stale + 1
        self.search.seconds = self._elapsed()
        self.search.worst = {name: self._confirmed(name) for name in self.found}
        return self.search

    def _rounds(self) -> Iterator[_Round]:
        # The first begins without deviations, where the gradient is the fairest.
        yield _Round(mean_attack(self.sets, self.batch), *self._grid())
        while True:
            yield self.polished()
            if "tube" in self.limits:
                yield from self._enumerated()
            yield _Round(vertex_attack(self.sets, self.batch, self.generator), *self._grid())

    def _play(self, given: _Round, stop: Callable[[], bool]) -> None:
        """Climb until no instance expects a gain, and judge every lap on the way."""
        loop, cell = self._loop(given.when), jnp.asarray(given.cell, jnp.int32)
        now = begun(given.attack)
        for _ in range(SWEEPS):
            played = given._replace(attack=now.candidate)
            now, best, member, gain = climb(loop, self.plant, self.limits, self.vertices, now, cell)
            best, member = np.asarray(best), np.asarray(member)
            self._judge(best, member, played)
            if float(gain) <= CONVERGED or stop():
                break
        self.polished = lambda: self._worst_cells(best, member, played)

    def _loop(self, when):
        return (
            PlanFollower(self.controller, jnp.asarray(when, jnp.int32))
            if "tube" in self.limits
            else self.controller
        )

    def _judge(self, best, member, played: _Round) -> None:
        self.search.laps += self.batch
        for name, cells in self.slices.items():
            reach = best[cells].reshape(self.shapes[name])
            self.search.reach[name] = np.maximum(self.search.reach[name], reach)
            cell = cells.start + int(np.argmax(best[cells]))
            if name not in self.found or best[cell] > self.found[name].usage:
                index = int(member[cell])
                attack = {
                    key: np.asarray(values)[:, index : index + 1]
                    for key, values in played.attack.items()
                }
                self.found[name] = _Found(float(best[cell]), cell, int(played.when[index]), attack)
                self.search.course.append((self._elapsed(), name, float(best[cell])))

    def _grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Return cells spread evenly over facets and steps, and windows at random."""
        places = (
            (np.arange(self.batch) + self.generator.random(self.batch))
            * len(self.aims)
            / self.batch
        )
        return self.aims[places.astype(int)], self.generator.choice(self.windows, self.batch)

    def _worst_cells(self, best, member, played: _Round) -> _Round:
        """Return the laps that reached the worst cells, each with its cell as its target."""
        cell = np.resize(self.aims[np.argsort(-best[self.aims])], self.batch)
        index = member[cell]
        return _Round(
            {name: values[:, index] for name, values in played.attack.items()},
            cell,
            played.when[index],
        )

    def _enumerated(self) -> Iterator[_Round]:
        """Yield all sequences of vertices in the window of the worst plan, a batch at a time, where
        they are few."""
        found, horizon = self.found["tube"], self.shapes["tube"][0]
        names = [
            name
            for name, each in self.sets.items()
            if name not in ("start", "noise") and each.times > 1
        ]
        counts = [len(self.sets[name].vertices) for name in names for _ in range(horizon)]
        total = int(np.prod(counts))
        if not names or total > ENUMERATED:
            return
        for first in range(0, total, self.batch):
            picks = np.stack(np.unravel_index(np.arange(first, first + self.batch) % total, counts))
            attack = {
                name: np.repeat(values, self.batch, axis=1) for name, values in found.attack.items()
            }
            for name, pick in zip(
                names, picks.reshape(len(names), horizon, self.batch), strict=True
            ):
                attack[name][found.when : found.when + horizon] = self.sets[name].vertices[pick]
            alike = (np.full(self.batch, number) for number in (found.cell, found.when))
            yield _Round({name: jnp.asarray(values) for name, values in attack.items()}, *alike)

    def _elapsed(self) -> float:
        return time.perf_counter() - self.start

    def _confirmed(self, name: str) -> Worst:
        found = self.found[name]
        stage, facet = divmod(found.cell - self.slices[name].start, self.shapes[name][1])
        step = (
            stage
            + (0 if name in ("input", "wheels") else 1)
            + (found.when if name == "tube" else 0)
        )
        # What comes later plays no part: it is left at the mean.
        attack = {key: np.array(values[:, 0]) for key, values in found.attack.items()}
        for key, values in attack.items():
            later = step + (key == "noise" or name in ("input", "wheels"))
            values[later:] = self.sets[key].vertices.mean(axis=0)
        unconfirmed = Worst(found.usage, np.nan, step, facet, found.when, attack)
        return replayed(self.controller, self.plant, self.limits[name], name, unconfirmed)


def falsify(
    controller: Controller,
    plant: SearchablePlant,
    limits: Limits,
    starts: Float[np.ndarray, "k 3"],
    *,
    aims: Sequence[str] = (),
    windows: Int[np.ndarray, " windows"] | None = None,
    seconds: float = 60.0,
    seed: int = 0,
    batch: int = 256,
) -> Search:
    """Search for the smallest margins of a closed loop over everything bounded that its plant would
    draw.

    Args:
        controller: any; for the limit `tube` a TubeMpc whose plans restart at the measured error.
        plant: the slipping robot or the linear plant; its law of drawing gives way to its bounds.
        limits: by name (module `usage`): some of `error`, `input` and `wheels`, or `tube` alone,
            since following a plan is another closed loop.
        starts: vertices of the polytope of initial errors, (m, m, rad); a single one fixes the
            start.
        aims: limits that are aimed at, all unless given; every limit is judged.
        windows: steps at which the plan that is followed may begin; all unless given.
        seconds: after which the search ends at the latest, compilation not counted.
        seed: of targets and random vertices.
        batch: laps played at once.

    Returns:
        The worst cases, each with the usage and margin of its replay. A positive margin proves
        nothing.

    Raises:
        ValueError: one line, for a slip process that is not searched or limits that do not go
            together or with the plant.
    """
    if not limits or ("tube" in limits and len(limits) > 1):
        raise ValueError(
            f"limits = {sorted(limits)}: give some of `error`, `input` and `wheels`, or `tube` alone"
        )
    if "wheels" in limits and not plant.has_wheels:
        raise ValueError(
            "limits = `wheels`: the linear plant has none; leave it out or give the slipping robot"
        )
    sets = find_uncertainties(plant, starts)
    if "tube" not in limits:
        windows = np.zeros(1, int)
    elif windows is None:
        windows = np.arange(len(plant.reference_wheels) - len(limits["tube"].offsets) + 1)
    searcher = _Searcher(
        controller, plant, limits, sets, aims or sorted(limits), windows, seed, batch
    )
    searcher.warm_up()
    return searcher.run(seconds)


def replayed(controller, plant, limit: Limit, name: str, worst: Worst) -> Worst:
    """Return a worst case with the usage and margin of its replay."""
    values = values_of(name, replay(controller, plant, worst.attack, name, worst.when))[
        worst.step - worst.when
    ]
    stage = worst.step - worst.when - 1 if name == "tube" else 0
    normal, offset = (
        np.asarray(limit.normals[stage, worst.facet]),
        float(limit.offsets[stage, worst.facet]),
    )
    margin = float(offset - normal @ values)
    usage = 1 - margin / (offset - float(normal @ np.asarray(limit.centre)))
    return Worst(usage, margin, worst.step, worst.facet, worst.when, worst.attack)
