"""`bench gradient`: value and gradient of the tuning objective beside its value alone.

The objective runs whole laps: from the scenario's start hardly a row is active, from the edge of
the feasible set many are.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.experiments.bench.rounds import time_rounds
from jaxtube.plant.estimating import EstimatingRobot
from jaxtube.plant.lagging import BareRobot
from jaxtube.plant.reference import settled_step
from jaxtube.progress import progress
from jaxtube.scenario.tree import Scenario
from jaxtube.simulation.components import slipping_robot
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.synthesis.design import design as make_design
from jaxtube.synthesis.feasible import boundary, spread_starts
from jaxtube.synthesis.parts import Design
from jaxtube.tuning.objective import LapInputs, make_aim, objective
from jaxtube.tuning.parameters import make_parameters
from jaxtube.tuning.tuner import make_evaluation_constants

BOUNDARY = 100
"""Rays by which the edge of the feasible set is found."""


class Extent(NamedTuple):
    """How much is measured: laps of the objective, and rounds."""

    laps: int
    rounds: int


FULL = Extent(laps=1024, rounds=3)
QUICK = Extent(laps=32, rounds=2)


class GradientResult(NamedTuple):
    """What was measured of the objective of one scenario.

    Attributes:
        scenario: its name.
        laps: of the objective.
        parameters: in which the gradient is taken.
        value, both: seconds of the value, and of value and gradient, by starts and rounds.
        memory: bytes that the programs of "value" and "both" take beside their arguments.
    """

    scenario: str
    laps: int
    parameters: int
    value: dict[str, Float[np.ndarray, " rounds"]]
    both: dict[str, Float[np.ndarray, " rounds"]]
    memory: dict[str, int]


def measure(
    scenarios: Sequence[tuple[str, Scenario]], seed: int, extent: Extent
) -> list[GradientResult]:
    """Measure the objectives of (name, scenario) each."""
    total = len(scenarios) * extent.rounds
    results = []
    with progress(total, "differentiating", "rounds") as bar:
        for name, scenario in scenarios:
            results.append(measure_objective(name, scenario, seed, extent, bar.update))
    return results


def measure_objective(
    name: str, scenario: Scenario, seed: int, extent: Extent, tick: Callable[[], object]
) -> GradientResult:
    """Measure one objective, `tick` being called after every round."""
    design = make_design(scenario)
    value = make_objective(design, seed, extent.laps)
    vector = jnp.asarray(make_parameters(design.problem).vector)
    starts = make_starts(design, seed, extent.laps)
    programs = {
        "value": _compile(value, vector, starts["edge"]),
        "both": _compile(jax.value_and_grad(value), vector, starts["edge"]),
    }
    work = {}
    for start, errors in starts.items():
        for kind, program in programs.items():
            work[f"{kind} {start}"] = partial(_run, program, vector, errors)
    seconds = time_rounds(work, extent.rounds, tick)
    memory = {kind: _count_bytes(program) for kind, program in programs.items()}
    return GradientResult(
        name,
        extent.laps,
        len(vector),
        {start: seconds[f"value {start}"] for start in starts},
        {start: seconds[f"both {start}"] for start in starts},
        memory,
    )


def make_objective(design: Design, seed: int, laps: int) -> Callable[..., Array]:
    """Return the tuning objective of a design as a function of parameters and starts."""
    problem = design.problem
    parameters = make_parameters(problem)
    constants = make_evaluation_constants(design)
    assert constants is not None, "the tube of a design is bounded"
    # No slip is learnt here: gains that could be tuned are those of designs without it.
    plant = cast("BareRobot | EstimatingRobot[BareRobot]", slipping_robot(design))
    aim = make_aim(problem.scenario, settled_step(problem.reference))
    keys = realisation_keys(seed, 0, laps)

    def value(vector, starts):
        lap_inputs = LapInputs(plant, keys, starts)
        return objective(parameters.weights(vector), constants, lap_inputs, aim)

    return value


def make_starts(design: Design, seed: int, laps: int) -> dict[str, Float[Array, "laps 3"]]:
    """Return the scenario's start for all laps, and starts on the edge of the feasible set."""
    problem = design.problem
    points = boundary(design.tube_qps, design.first_window, problem.operating_set, BOUNDARY)
    return {
        "scenario": jnp.tile(jnp.asarray(problem.initial_error), (laps, 1)),
        "edge": jnp.asarray(spread_starts(points, laps, seed, edge_share=1.0)),
    }


def _compile(function: Callable[..., Any], *arguments) -> jax.stages.Compiled:
    return jax.jit(function).lower(*arguments).compile()


def _run(program: jax.stages.Compiled, *arguments) -> None:
    jax.block_until_ready(program(*arguments))


def _count_bytes(program: jax.stages.Compiled) -> int:
    analysis = program.memory_analysis()
    assert analysis is not None, "the processor's compiler tells memory"
    return int(analysis.temp_size_in_bytes)
