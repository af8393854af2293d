"""Tuning of a linear system's weights by gradients through laps of its tube-MPC.

    minimise  mean over laps and periods of  aim(x, u)     over Q and R

Q and R are moved as lower triangles (`tuning.parameters`). The gains of tube and terminal set stay
what they are at the start, and with them every set; the terminal cost follows the weights. So the
constraints of the plans are those of the start, and no weights can lose recursive feasibility.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int, Key

from jaxtube.control.laws import TubeMpc
from jaxtube.control.protocol import DirectInputs
from jaxtube.plant.protocol import Plant
from jaxtube.qp.regions import AnyArray
from jaxtube.simulation.choices import choose_plant, choose_starts, find_plant
from jaxtube.simulation.rollout import PeriodOutcome, realisation_keys
from jaxtube.simulation.usage import add_up_periods
from jaxtube.synthesis.condense import Cost, Gains, RowBounds, row_bounds, weigh, widths
from jaxtube.synthesis.linear_design import design_linear
from jaxtube.synthesis.parts import LinearDesign
from jaxtube.synthesis.prediction import Prediction, predict
from jaxtube.systems.system import LinearSystem
from jaxtube.tuning.descent import adam, lbfgs
from jaxtube.tuning.gains import differentiate_terminal_cost
from jaxtube.tuning.parameters import Point, factor_weight, square_weight
from jaxtube.tuning.watch import Outcome
from sets.certificate import decrease_margin
from sets.lyapunov import cost_of_gains

PeriodCost = Callable[[Float[Array, "laps n"], Float[Array, "laps m"]], Float[Array, " laps"]]
"""Cost of a period from the states at its end and the inputs during it, in jax.numpy."""

HELD_OUT = 1_000_000
"""Number of the first lap that judges iterates: no lap of an evaluation comes so late."""


class LinearJudgement(NamedTuple):
    """What held-out laps say of weights."""

    held_out: float  # mean cost of a period
    certified: bool  # the terminal cost decreases, and every other condition is that of the start
    Q: Float[np.ndarray, "n n"]
    R: Float[np.ndarray, "m m"]


@dataclass(frozen=True, eq=False, repr=False)
class LinearTuned:
    """The result of tuning a linear system.

    Attributes:
        start: the start, judged on held-out laps.
        best: the iterate that is returned, on the same laps.
        judged: every iterate.
        system: with the weights of the best iterate, and the gains of the start.
        design: of this system.
        outcome: what stopped the descent.
    """

    start: LinearJudgement
    best: LinearJudgement
    judged: list[LinearJudgement]
    system: LinearSystem
    design: LinearDesign
    outcome: Outcome

    @property
    def is_certified(self) -> bool:
        """Whether every condition of the model holds of the returned design."""
        return self.design.certificate.holds_for_model

    def __repr__(self) -> str:
        share = 1 - self.best.held_out / self.start.held_out
        return (
            f"<LinearTuned: {self.design.certificate.verdict}; cost of a period on held-out laps "
            f"{self.start.held_out:.4g} -> {self.best.held_out:.4g} ({share:.1%} less); "
            f"{self.outcome.evaluations} evaluations, stopped: {self.outcome.stop}>"
        )


class _Constants(NamedTuple):
    """What a design holds fixed while weights move."""

    ahead: Prediction
    bounds: RowBounds
    gains: Gains
    loops: Float[AnyArray, "w n n"]
    loop_gains: Float[AnyArray, "w m n"]
    widths: Float[AnyArray, " n"]
    index: Int[AnyArray, " steps"]
    plant: Plant


class _LinearTuner:
    """Objective, gradient and judgement of weights."""

    def __init__(self, system: LinearSystem, aim: PeriodCost, laps: int, held_out: int, seed: int):
        self.design = design_linear(system)
        self.system = replace(system, K=self.design.tube_gain.vertices)
        self.constants = _make_constants(self.design)
        self.aim = aim
        self.laps = laps
        self.held_out = held_out
        self.seed = seed
        self.starts = choose_starts(self.design, "edge")
        self.of_states = len(system.Q) * (len(system.Q) + 1) // 2
        self.judged: list[LinearJudgement] = []

    @property
    def start(self) -> Point:
        """The weights of the system as a vector."""
        return np.concatenate([factor_weight(self.system.Q), factor_weight(self.system.R)])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its entries."""
        parts = (("Q", self.system.states), ("R", self.system.inputs))
        return tuple(
            f"{letter}{i + 1}{j + 1}"
            for letter, size in parts
            for i, j in zip(*np.tril_indices(size), strict=True)
        )

    def read(self, point: Point) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "m m"]]:
        """Return Q and R of a point."""
        Q, R = self._split(jnp.asarray(point))
        return np.asarray(Q), np.asarray(R)

    def _split(self, point: Float[Array, " k"]) -> tuple[Array, Array]:
        return (
            square_weight(point[: self.of_states], self.system.states),
            square_weight(point[self.of_states :], self.system.inputs),
        )

    def evaluate(self, point: Point, draws: int) -> tuple[float, Point]:
        """Return the mean cost over the laps of a draw, and its gradient."""
        keys = realisation_keys(self.seed, draws * self.laps, self.laps)
        value, gradient = _differentiate(
            self._split,
            self.aim,
            jnp.asarray(point),
            self._cost(point),
            self.constants,
            keys,
            self.starts.draw(keys),
        )
        return float(value), np.asarray(gradient)

    def inspect(self, iteration: int, point: Point) -> LinearJudgement:
        """Return the judgement of an iterate on held-out laps."""
        Q, R = self.read(point)
        keys = realisation_keys(self.seed, HELD_OUT, self.held_out)
        P = self._cost(point)
        value = _compute_cost(
            self._split,
            self.aim,
            jnp.asarray(point),
            P,
            self.constants,
            keys,
            self.starts.draw(keys),
        )
        loops, gains = self.design.tube_gain.pairs
        certified = decrease_margin(loops, gains, P, Q, R) >= 0
        judgement = LinearJudgement(float(value), bool(certified), Q, R)
        self.judged.append(judgement)
        return judgement

    def _cost(self, point: Point) -> Float[np.ndarray, "n n"]:
        """Return the terminal cost of a point's weights."""
        return cost_of_gains(*self.design.tube_gain.pairs, *self.read(point))


def tune_linear(
    system: LinearSystem,
    aim: PeriodCost | None,
    *,
    method: str,
    evaluations: int,
    laps: int,
    held_out: int,
    learning_rate: float,
    patience: int,
    seed: int,
) -> LinearTuned:
    """Tune the weights of a linear system, see `tune`."""
    tuner = _LinearTuner(system, aim or _aim_of_weights(system), laps, held_out, seed)
    descend = lbfgs if method == "lbfgs" else partial(adam, learning_rate=learning_rate)
    outcome = descend(
        tuner.evaluate,
        tuner.inspect,
        tuner.start,
        tuner.names,
        budget=evaluations,
        patience=patience,
    )
    found = outcome.best_certified
    best = tuner.judged[found.iteration if found else 0]
    tuned = replace(tuner.system, Q=best.Q, R=best.R)
    return LinearTuned(tuner.judged[0], best, tuner.judged, tuned, design_linear(tuned), outcome)


def _aim_of_weights(system: LinearSystem) -> PeriodCost:
    """Return the stage cost of a system's own weights."""
    Q = jnp.asarray(system.Q)
    R = jnp.asarray(system.R)

    def cost(x: Float[Array, "laps n"], u: Float[Array, "laps m"]) -> Float[Array, " laps"]:
        return jnp.sum((x @ Q) * x, axis=1) + jnp.sum((u @ R) * u, axis=1)

    return cost


def _make_constants(design: LinearDesign) -> _Constants:
    problem = design.problem
    windows = design.windows
    ahead = predict(problem, windows, design.bounds.terminal_normals)
    gains = windows.gains[:, 0]
    loops, loop_gains = design.tube_gain.pairs
    numbers = (ahead, row_bounds(design.bounds, ahead, np), Gains(gains, gains), loops, loop_gains)
    plant = choose_plant(design, find_plant(design, None))
    return _Constants(
        *jax.tree.map(jnp.asarray, numbers),
        widths=jnp.asarray(widths(problem)),
        index=jnp.asarray(windows.index),
        plant=plant,
    )


def _compute_total(split, aim: PeriodCost, point, P, constants: _Constants, keys, starts):
    """Return the mean cost of a period; differentiable in the point."""
    Q, R = split(point)
    cost = differentiate_terminal_cost(P, constants.loops, constants.loop_gains, Q, R)
    qps = weigh(
        constants.ahead, constants.bounds, constants.gains, Cost(Q, R, cost), constants.widths
    )
    controller = TubeMpc(qps, constants.index, DirectInputs())

    def observe(step, states: Float[Array, "laps n"], happened: PeriodOutcome):
        return {"cost": aim(states, happened.inputs)}

    plant = constants.plant
    summed = add_up_periods(controller, plant, keys, starts, observe)
    return jnp.mean(summed["cost"]) / len(plant.reference_wheels)


@partial(jax.jit, static_argnums=(0, 1))
def _compute_cost(
    split, aim: PeriodCost, point, P, constants: _Constants, keys: Key[Array, " laps"], starts
) -> Float[Array, ""]:
    return _compute_total(split, aim, point, P, constants, keys, starts)


@partial(jax.jit, static_argnums=(0, 1))
def _differentiate(
    split, aim: PeriodCost, point, P, constants: _Constants, keys: Key[Array, " laps"], starts
) -> tuple[Float[Array, ""], Float[Array, " k"]]:
    def total(point):
        return _compute_total(split, aim, point, P, constants, keys, starts)

    return jax.value_and_grad(total)(point)
