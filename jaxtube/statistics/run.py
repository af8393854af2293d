"""Monte Carlo of closed loops: laps by the million, every period checked, and nothing kept but
counts and extremes.

    block   BLOCK laps, the unit of records and of identity: block i holds the laps i BLOCK ..
            (i + 1) BLOCK - 1
    tile    TILE laps that run side by side; few enough for a processor's cache
    chunk   blocks that a device works through in one dispatch; any number, it changes no bit of
            the statistics

Every draw is a function of seed, lap, step and purpose. A block is run by one program of fixed
shape, and by another one with the whole solver where a QP of it needs that; the devices run blocks
independently, so their statistics do not depend on chunk, devices or processes either.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Bool, Int, Key, UInt32

from jaxtube.columns import loop_by_columns
from jaxtube.control import planning
from jaxtube.control.laws import TubeMpc, planner_of, without_rounds
from jaxtube.control.protocol import Controller
from jaxtube.plant.protocol import Plant
from jaxtube.plant.slip import realisation_key
from jaxtube.simulation.rollout import LoopState, begin, follow_plan, run_period
from jaxtube.simulation.starts import Starts
from jaxtube.statistics import tally
from jaxtube.statistics.checks import Checks

BLOCK = 4096
"""Laps of a block."""
TILE = 512
"""Laps of a tile."""
PLANS_SHARE = 0.01
"""Share of the states along a lap at which a plan is made and followed to its end."""
WORST = 16
"""Laps kept by index, for each of the three sets ranked by."""

UNSOLVED = ("laps_unsolved", "plans_unsolved")
"""Counts that tell whether a block needs the whole solver; no part of its statistics."""
RANKED = ("error", "disturbance", "tube")
"""Sets by whose usage laps are ranked."""
_JOIN = {"i": np.add, "f": np.maximum}
"""How statistics of two ranges join, by the kind of their numbers: counts add up, extremes win."""

Statistics = dict[str, np.ndarray]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Task:
    """What every block needs: the closed loop, where it starts, what it is measured against, and
    the seed's key."""

    controller: Controller
    plant: Plant
    starts: Starts
    checks: Checks
    seed_key: Key[Array, ""]


@dataclass(frozen=True)
class Run:
    """A Monte Carlo run on the devices of this process.

    Attributes:
        task: its arrays.
        realisations: laps wanted in all.
        chunk: blocks that each device works through in one dispatch.
        devices: the devices, all of one kind.
    """

    task: Task
    realisations: int
    chunk: int
    devices: tuple

    @cached_property
    def short_task(self) -> Task:
        """The task of the program by which blocks are run first (see `laws.without_rounds`)."""
        return dataclasses.replace(self.task, controller=without_rounds(self.task.controller))

    @property
    def at_once(self) -> int:
        """Blocks that one dispatch takes."""
        return self.chunk * len(self.devices)

    def compute(self, blocks: Iterable[int]) -> Iterator[tuple[int, Statistics]]:
        """Yield the statistics of blocks; while one dispatch is collected the next one is under
        way."""
        source = iter(blocks)
        pending = None
        while group := list(itertools.islice(source, self.at_once)):
            started = (group, self.dispatch(group))
            if pending:
                yield from self.collect(*pending)
            pending = started
        if pending:
            yield from self.collect(*pending)

    def dispatch(self, blocks: list[int], task: Task | None = None) -> dict[str, Array]:
        """Start the computation of up to `at_once` blocks, of the short task unless told; the
        arrays, blocks first, are ready later."""
        without_laps = -(-self.realisations // BLOCK)
        padded = [*blocks, *[without_laps] * (self.at_once - len(blocks))]
        mesh = Mesh(np.array(self.devices), ("devices",))
        words, counts, numbers = _labels(padded, self.realisations)
        return _simulate(mesh, task or self.short_task, words, counts, numbers)

    def collect(
        self, blocks: list[int], dispatched: dict[str, Array]
    ) -> list[tuple[int, Statistics]]:
        """Wait for a dispatch and return the statistics of its blocks; of those with a QP that the
        short program leaves unsolved by the whole one."""
        found = _statistics_of(blocks, dispatched)
        unsolved = [block for block in blocks if _has_unsolved(found[block])]
        if unsolved and self.short_task.controller is not self.task.controller:
            found |= _statistics_of(unsolved, self.dispatch(unsolved, self.task))
        for statistics in found.values():
            for name in UNSOLVED:
                del statistics[name]
        return list(found.items())

    def laps(self, block: int) -> int:
        """Return how many laps of a block belong to the run."""
        return min(BLOCK, self.realisations - block * BLOCK)


def merge(one: Statistics, other: Statistics) -> Statistics:
    """Join the statistics of two ranges of blocks; associative and commutative to the bit.

    Counts add up, extremes are maxima, and of the worst laps the worst remain, the earlier one
    first among equals.
    """
    joined = {
        name: _JOIN[value.dtype.kind](value, other[name])
        for name, value in one.items()
        if "worst" not in name
    }
    for name in RANKED:
        usage = np.concatenate([part[f"worst_usage/{name}"] for part in (one, other)])
        laps = np.concatenate([part[f"worst_lap/{name}"] for part in (one, other)])
        order = np.lexsort((laps, -usage))[:WORST]
        joined[f"worst_usage/{name}"] = usage[order]
        joined[f"worst_lap/{name}"] = laps[order]
    return joined


def plan_steps(steps: int, horizon: int) -> tuple[int, int]:
    """Return (plans in a lap, distance between them): about PLANS_SHARE of the states, all with a
    horizon ahead."""
    room = max(steps - horizon, 0)
    plans = min(max(round(PLANS_SHARE * steps), 1), room)
    return plans, room // max(plans, 1)


def first_plan(tile: Int[Array, ""], distance: int) -> Int[Array, ""]:
    """Return the step of a tile's first plan, 0 .. distance - 1, so that few tiles are spread over
    all of them."""
    golden = max(round(0.618 * distance), 1)
    stride = next(s for s in range(golden, distance + 2) if math.gcd(s, distance) == 1)
    return tile % distance * stride % distance


def _labels(
    blocks: list[int], realisations: int
) -> tuple[UInt32[np.ndarray, "blocks 2"], Int[np.ndarray, " blocks"], Int[np.ndarray, " blocks"]]:
    """Return the first lap of each block as two words, how many laps count, and the block's number
    for its plans."""
    first = [block * BLOCK for block in blocks]
    words = np.array([[lap >> 32, lap & 0xFFFFFFFF] for lap in first], np.uint32)
    counts = np.array([max(0, min(BLOCK, realisations - lap)) for lap in first], np.int32)
    return words, counts, np.array([block % 2**31 for block in blocks], np.int32)


def _statistics_of(blocks: list[int], dispatched: dict[str, Array]) -> dict[int, Statistics]:
    """Return the statistics of the blocks of a dispatch."""
    arrays = jax.tree.map(np.asarray, dispatched)
    return {block: _statistics(block, arrays, place) for place, block in enumerate(blocks)}


def _has_unsolved(statistics: Statistics) -> bool:
    """Return whether a QP of a block is neither solved nor refuted; laps that are not finite, from
    whatever period on, ask for nothing."""
    return any(statistics[name] > 0 for name in UNSOLVED)


def _statistics(block: int, arrays: dict[str, np.ndarray], place: int) -> Statistics:
    """Return the statistics of the block at a place of a dispatch, counts in 64 bits."""
    statistics = {name: value[place] for name, value in arrays.items()}
    for name, value in statistics.items():
        if value.dtype.kind == "i":
            statistics[name] = value.astype(np.int64)
    for name in RANKED:
        usage = statistics[f"worst_usage/{name}"]
        laps = block * BLOCK + statistics[f"worst_lap/{name}"]
        counted = usage > -np.inf
        statistics[f"worst_usage/{name}"] = usage[counted]
        statistics[f"worst_lap/{name}"] = laps[counted]
    return statistics


@partial(jax.jit, static_argnums=0)
def _simulate(mesh: Mesh, task: Task, words, counts, numbers) -> dict[str, Array]:
    """Run blocks, spread over the devices; each device works through its own in turn."""
    spread = PartitionSpec("devices")
    same = PartitionSpec()

    on_devices = jax.shard_map(
        _simulate_in_turn,
        mesh=mesh,
        in_specs=(same, spread, spread, spread),
        out_specs=spread,
        check_vma=False,
    )
    return on_devices(task, words, counts, numbers)


def _simulate_in_turn(task: Task, words, counts, numbers) -> dict[str, Array]:
    """Run the blocks of one device, one after the other."""

    size = BlockSize(BLOCK, TILE)

    def simulate(block):
        first, count, number = block
        return simulate_block(task, first, count, number, size)

    return jax.lax.map(simulate, (words, counts, numbers))


class BlockSize(NamedTuple):
    """How many laps make a block, and how many of them run side by side: a tile."""

    block: int
    tile: int


def simulate_block(
    task: Task,
    words: UInt32[Array, "2"],
    count: Int[Array, ""],
    number: Int[Array, ""],
    size: BlockSize,
) -> dict[str, Array]:
    """Return the statistics of one block, its laps numbered from 0 in the lists of the worst; tiles
    without laps that count are not worked through.

    Args:
        task: what every block needs.
        words: high and low 32 bits of the number of its first lap.
        count: its first laps that count.
        number: of the block, modulo 2^31: it shifts the steps at which plans are followed, as the
            tile does.
        size: of the block, and of the tiles that it is worked through in.
    """
    simulate = partial(_simulate_tile, task, words, count, number, size)
    with_laps = (count + size.tile - 1) // size.tile
    sums, largest, usage = _map_first(simulate, with_laps, size.block // size.tile)
    sums = jax.tree.map(lambda array: jnp.sum(array, axis=0, dtype=jnp.int32), sums)
    largest = jax.tree.map(lambda array: jnp.max(array, axis=0), largest)
    worst, laps = jax.lax.top_k(jnp.moveaxis(usage, 1, 0).reshape(len(RANKED), size.block), WORST)
    ranked = {f"worst_usage/{name}": worst[i] for i, name in enumerate(RANKED)}
    numbers = {f"worst_lap/{name}": laps[i] for i, name in enumerate(RANKED)}
    return sums | largest | ranked | numbers


def _map_first(function: Callable, count: Int[Array, ""], most: int) -> Any:
    """Return what a function makes of 0 .. count - 1, stacked to a length of `most`; beyond it
    whole numbers are 0, the others -inf."""
    traced_once = jax.jit(function)

    def begin_stack(shape):
        nothing = 0 if jnp.issubdtype(shape.dtype, jnp.integer) else -jnp.inf
        return jnp.full((most, *shape.shape), nothing, shape.dtype)

    def put(place, stacks):
        made = traced_once(place)
        return jax.tree.map(lambda stack, array: stack.at[place].set(array), stacks, made)

    stacks = jax.tree.map(begin_stack, jax.eval_shape(traced_once, jnp.int32(0)))
    return jax.lax.fori_loop(0, count, put, stacks)


def _simulate_tile(
    task: Task, words, count, number, size: BlockSize, place: Int[Array, ""]
) -> tuple[dict[str, Array], dict[str, Array], Array]:
    """Run the tile at a place of a block, with plans at steps that depend on the place."""
    first = place * size.tile
    low = words[1] + first.astype(jnp.uint32) + jnp.arange(size.tile, dtype=jnp.uint32)
    keys = jax.vmap(lambda word: realisation_key(task.seed_key, words[0], word))(low)
    counted = first + jnp.arange(size.tile, dtype=jnp.int32) < count
    plans, distance = plan_steps(len(task.checks.transitions), task.checks.horizon)
    tiles = size.block // size.tile
    shift = first_plan(number % max(distance, 1) * tiles + place, max(distance, 1))
    stops = shift + distance * jnp.arange(plans, dtype=jnp.int32)
    return run_tile(task, keys, counted, stops)


def run_tile(
    task: Task, keys: Key[Array, " batch"], counted, stops: Int[Array, " plans"]
) -> tuple[dict[str, Array], dict[str, Array], Array]:
    """Run a tile of laps from start to end; return (sums, largest, by lap the usage of the sets
    ranked by).

    At `stops` plans are made and followed to their end, by a tube-MPC whose plans start at the
    measured error.
    """
    checks = task.checks
    steps = len(checks.transitions)
    plans = len(stops)
    errors = task.starts.draw(keys)
    bounds = jnp.concatenate([jnp.zeros(1, jnp.int32), stops, jnp.full(1, steps, jnp.int32)])
    state = begin(task.controller, task.plant, keys, errors)
    counts = tally.empty(checks, checks.horizon, len(errors), errors.dtype)
    parts = (bounds[:-1], bounds[1:], jnp.arange(plans + 1) < plans)
    run_stretch = partial(_run_stretch, task, keys, counted)
    (_, counts), _ = jax.lax.scan(run_stretch, (state, counts), parts)
    usage = jnp.where(counted, tally.find_usages(checks, counts.laps), -jnp.inf)
    sums, largest = tally.close(checks, errors, plans, counted, counts)
    return sums, largest, usage


def _run_stretch(
    task: Task, keys: Key[Array, " batch"], counted, carry, part
) -> tuple[tuple[LoopState, tally.Tally], None]:
    """Run the periods from one stop to the next, and follow the plans made there."""
    first, last, has_plan = part

    def run_and_observe(step, carry):
        state, counts = carry
        after, happened = run_period(task.controller, task.plant, keys, step, state)
        counts = tally.observe(task.checks, step, state, happened, after, counted, counts)
        return after, counts

    state, counts = loop_by_columns(first, last, run_and_observe, carry)
    planner = planner_of(task.controller)
    if planner is not None:
        observe = partial(follow_and_observe, task, planner, keys, last, counted, state)
        counts = jax.lax.cond(has_plan, observe, _keep, counts)
    return (state, counts), None


def _keep(counts: tally.Tally) -> tally.Tally:
    return counts


def follow_and_observe(
    task: Task,
    controller: TubeMpc,
    keys: Key[Array, " batch"],
    step: Int[Array, ""],
    counted: Bool[Array, " batch"],
    state: LoopState,
    counts: tally.Tally,
) -> tally.Tally:
    """Plan, follow the plan, plan once more where the first one expects to be a step later, and
    count what is seen."""

    def make_plan(errors, at):
        plan = planning.plan(controller.condensed_qp(at), errors)
        return tally.expected_error(controller, at, errors, plan), plan

    # One program for both plans: what solves a QP takes long to compile.
    _, plans = jax.lax.scan(make_plan, state.measured, jnp.stack([step, step + 1]))
    first = jax.tree.map(lambda array: array[0], plans)
    second = jax.tree.map(lambda array: array[1], plans)
    deviations = follow_plan(controller, task.plant, keys, state, step, first)
    followed = tally.FollowedPlans(state, first, deviations, second)
    return tally.observe_plans(task.checks, controller, step, followed, counted, counts)
