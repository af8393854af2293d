"""One scenario's tuning: designs, values, gradients and judgements of points.

A point is designed on the host (sets, certificate) and then played on the device. Draws i are the
realisations i n .. (i + 1) n - 1 of the seed; those held out, and those of the final comparison,
begin where no draw reaches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Key

from jaxtube.control.laws import TubeMpc
from jaxtube.control.protocol import Controller
from jaxtube.plant.estimating import EstimatingRobot
from jaxtube.plant.lagging import BareRobot
from jaxtube.plant.reference import settled_step
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario
from jaxtube.simulation import components
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.synthesis.design import finish, prepare, refuse_infeasible_start
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem, with_controller
from jaxtube.tuning.caps import find_active_caps, make_limits
from jaxtube.tuning.judgement import HeldOutJudgement, judge_laps, judge_without_laps
from jaxtube.tuning.loop import make_design_constants
from jaxtube.tuning.objective import (
    Aim,
    EvaluationConstants,
    LapInputs,
    LapMeasures,
    make_aim,
    measure_laps,
    objective,
    run_tube_mpc,
    total_cost,
)
from jaxtube.tuning.parameters import Parameters, Point, Variables, make_parameters

HELD_OUT = 2**40
"""First realisation of the laps that decide when to stop."""
COMPARED = 2**41
"""First realisation of the laps that results are reported for."""
NO_DESIGN = 1e6
"""Objective where there is no design to play: finite, so that a line search turns back."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A point with its prepared design and what an evaluation holds fixed; `reason` says why there
    are none."""

    point: Point
    prepared: Design | None
    constants: EvaluationConstants | None
    reason: str = ""


@jax.jit
def _run_laps(
    vector, constants: EvaluationConstants, lap_inputs: LapInputs, parameters: Parameters, aim: Aim
) -> LapMeasures:
    return run_tube_mpc(parameters.weights(vector), constants, lap_inputs, aim)


@jax.jit
def _value_and_gradient(
    vector, constants: EvaluationConstants, lap_inputs: LapInputs, parameters: Parameters, aim: Aim
) -> tuple[Float[Array, ""], Float[Array, " n"]]:
    def value(vector):
        return objective(parameters.weights(vector), constants, lap_inputs, aim)

    return jax.value_and_grad(value)(vector)


_tube_shares = jax.jit(EvaluationConstants.tube_shares)
_controller = jax.jit(EvaluationConstants.controller)
_run_controller = jax.jit(measure_laps)


@dataclass(eq=False)
class Tuner:
    """Values, gradients and judgements of points of one scenario."""

    problem: Problem
    plant: BareRobot | EstimatingRobot[BareRobot]
    parameters: Parameters
    aim: Aim
    laps: int = 128
    held_out: int = 256
    seed: int = 0
    _last: Candidate | None = field(default=None, init=False, repr=False)

    def candidate(self, point: Point) -> Candidate:
        """Return the prepared design of a point; the last one is kept."""
        if self._last is None or not np.array_equal(self._last.point, point):
            self._last = self._prepare(np.array(point, float))
        return self._last

    # Far from a feasible design, numbers overflow; the resulting errors are caught below.
    @np.errstate(all="ignore")
    def _prepare(self, point: Point) -> Candidate:
        try:
            scenario = self.parameters.scenario(self.problem.scenario, point)
            prepared = prepare(with_controller(self.problem, scenario))
            constants = make_evaluation_constants(prepared)
        # Refused scenarios, empty sets and linear algebra raise ValueErrors, hulls and solvers the
        # others.
        except (ArithmeticError, RuntimeError, ValueError) as error:
            return Candidate(point, None, None, str(error).splitlines()[0])
        reason = "" if constants else "the tube of the gains is not bounded"
        return Candidate(point, prepared, constants, reason)

    def keys(self, first: int, count: int) -> Key[Array, " count"]:
        """Return the keys of `count` realisations."""
        return realisation_keys(self.seed, first, count)

    def starts(self, count: int) -> Float[Array, "count 3"]:
        """Return the scenario's start, once a lap."""
        return jnp.tile(jnp.asarray(self.problem.initial_error), (count, 1))

    def lap_inputs(self, first: int, count: int) -> LapInputs:
        """Return the inputs of the laps of `count` realisations."""
        return LapInputs(self.plant, self.keys(first, count), self.starts(count))

    def evaluate(self, point: Point, draws: int) -> tuple[float, Point]:
        """Return objective and gradient over the draws of an index; NO_DESIGN and 0 where there is
        nothing to play."""
        constants = self.candidate(point).constants
        if constants is None:
            return NO_DESIGN, np.zeros_like(point)
        lap_inputs = self.lap_inputs(draws * self.laps, self.laps)
        vector = jnp.asarray(point)
        value, gradient = _value_and_gradient(
            vector, constants, lap_inputs, self.parameters, self.aim
        )
        return float(value), np.asarray(gradient)

    def value(self, point: Point, draws: int) -> float:
        """Return the objective alone; NO_DESIGN where there is nothing to play."""
        played = self.play(point, draws * self.laps, self.laps)
        if played is None:
            return NO_DESIGN
        laps, shares = played
        return float(total_cost(laps, jnp.asarray(shares), self.aim))

    def play(
        self, point: Point, first: int, count: int
    ) -> tuple[LapMeasures, Float[np.ndarray, " caps"]] | None:
        """Return laps over given draws and the tube's shares of the caps, None without a closed
        loop."""
        constants = self.candidate(point).constants
        if constants is None:
            return None
        vector = jnp.asarray(point)

        def run(lap_inputs: LapInputs) -> LapMeasures:
            return _run_laps(vector, constants, lap_inputs, self.parameters, self.aim)

        shares = _tube_shares(constants, self.parameters.weights(vector).kappa)
        return self._run_batches(run, first, count), np.asarray(shares)

    def inspect(self, point: Point) -> HeldOutJudgement:
        """Return the judgement of a point on the held-out laps."""
        return self._judge(point, HELD_OUT, self.held_out)

    def compare(self, point: Point, laps: int) -> HeldOutJudgement:
        """Return the judgement of a point over laps that nothing before has seen."""
        return self._judge(point, COMPARED, laps)

    def _judge(self, point: Point, first: int, count: int) -> HeldOutJudgement:
        candidate = self.candidate(point)
        played = self.play(point, first, count)
        if candidate.prepared is None or played is None:
            return judge_without_laps(point, candidate.reason)
        laps, shares = played
        return judge_laps(point, laps, shares, self.aim, find_failing(candidate.prepared))

    def controller(self, point: Point) -> TubeMpc:
        """Return the tube-MPC of a point.

        Raises:
            ValueError: where there is none.
        """
        candidate = self.candidate(point)
        if candidate.constants is None:
            raise ValueError(f"point: has no closed loop ({candidate.reason}); choose another")
        return _controller(candidate.constants, self.parameters.weights(jnp.asarray(point)))

    def drive(self, controller: Controller, first: int, count: int) -> LapMeasures:
        """Return laps of any controller over given draws."""
        limits = make_limits(self.problem)

        def run(lap_inputs: LapInputs) -> LapMeasures:
            return _run_controller(controller, lap_inputs, limits, self.aim)

        return self._run_batches(run, first, count)

    def _run_batches(
        self, run: Callable[[LapInputs], LapMeasures], first: int, count: int
    ) -> LapMeasures:
        """Return `count` laps, run in batches of one shape, so that they compile once."""
        batches = []
        for start in range(first, first + count, self.laps):
            laps = run(self.lap_inputs(start, self.laps))
            batches.append(jax.tree.map(np.asarray, laps))
        return jax.tree.map(lambda *arrays: np.concatenate(arrays)[:count], *batches)


def make_tuner(
    scenario: Scenario,
    *,
    variables: Variables = "both",
    laps: int = 128,
    held_out: int = 256,
    seed: int = 0,
) -> Tuner:
    """Return the tuner of a scenario.

    Args:
        scenario: where tuning starts; its [tuning] says what it aims at.
        variables: what moves.
        laps: in each evaluation.
        held_out: laps, others than those, that judge every iterate.
        seed: of every draw.

    Raises:
        ScenarioError: where the scenario gives no gains, or gains without a bounded tube, so that
            there is nothing to descend on; or has slips learnt.
    """
    refuse_untunable(scenario)
    problem = complete_problem(scenario)
    try:
        parameters = make_parameters(problem, variables)
    except ValueError as error:
        raise ScenarioError(f"scenario: {error}") from None
    aim = make_aim(scenario, settled_step(problem.reference))
    # No slip is learnt here, as was refused above.
    plant = cast("BareRobot | EstimatingRobot[BareRobot]", components.robot_of(problem))
    tuner = Tuner(problem, plant, parameters, aim, laps, held_out, seed)
    start = tuner.candidate(parameters.vector)
    if start.constants is None:
        gains = scenario.controller.tracking_gains or scenario.controller.vertex_gains
        raise ScenarioError(
            f"scenario: controller gains = {list(gains)}: tuning cannot start ({start.reason}); "
            "start from firmer gains, such as those of `certified`, or lower slip.relative_error"
        )
    return tuner


def refuse_untunable(scenario: Scenario) -> None:
    """Refuse a scenario that has more than one gain or disturbance set, or another cost.

    Raises:
        ScenarioError: one line.
    """
    if scenario.slip.is_learnt:
        raise ScenarioError(
            f"scenario: slip.change_per_s = {scenario.slip.change_per_s:g}: tuning knows one "
            "disturbance set for all periods, and slips that are learnt have several; leave it "
            "out, and give slip.measurement_error"
        )
    if scenario.operating.bands:
        raise ScenarioError(
            "scenario: operating.bands: tuning knows one gain, not several by speed; leave them out"
        )
    if scenario.controller.cost != "tracking":
        raise ScenarioError(
            f'scenario: controller.cost = "{scenario.controller.cost}": weights of tracking are '
            'what is tuned; set controller.cost = "tracking"'
        )


def make_evaluation_constants(prepared: Design) -> EvaluationConstants | None:
    """Return what an evaluation holds of a design, None where the tube of its gains is not bounded.

    Raises:
        ValueError: as `make_design_constants`.
    """
    problem = prepared.problem
    design_constants = make_design_constants(prepared)
    kappa = jnp.asarray(problem.given_gains)
    loops = design_constants.maps.vertex_loops.at(kappa)
    gains = design_constants.maps.corner_gains.at(kappa)
    active = find_active_caps(
        design_constants.limits, loops, jnp.asarray(design_constants.generators), gains
    )
    if active is None:
        return None
    return EvaluationConstants(
        design=jax.device_put(design_constants),
        active=active,
        wheel_map=components.make_wheel_map(problem),
        restart=problem.scenario.controller.restart,
    )


def find_failing(prepared: Design) -> tuple[str, ...]:
    """Return the conditions that the certificate of a prepared design lacks: all of it where it
    cannot be computed."""
    try:
        return failing_conditions(finish(prepared))
    except (ArithmeticError, RuntimeError, ValueError) as error:
        return (f"certificate_computed ({error})",)


def failing_conditions(design: Design) -> tuple[str, ...]:
    """Return the names of the conditions that a design lacks, the start's plan among them.

    Where W is assumed they are those of the linear model with w in W.
    """
    certificate = design.certificate
    is_assumed = not design.problem.has_computed_bound
    failing = tuple(certificate.failing_for_model if is_assumed else certificate.failing)
    try:
        refuse_infeasible_start(design)
    except ScenarioError:
        return (*failing, "start_has_a_plan")
    return failing
